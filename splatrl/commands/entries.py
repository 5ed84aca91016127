"""What the scripts of the commands start: what was typed is checked, and ``--help`` answered, at once.

A command itself imports the library, with PyTorch, TorchRL and matplotlib, which takes seconds.
"""

import sys
from collections.abc import Sequence
from functools import partial
from importlib import import_module

from splatrl.commands import parsers

INTERRUPTED = 130
"""Exit code of a command that Ctrl-C ended."""
PARSERS = {"capture": parsers.capture, "scene": parsers.scene, "gait": parsers.gait}
"""Commands that take options; the others have a config."""


def start(name: str, arguments: Sequence[str] | None = None) -> None:
    """Run a command, unless what was typed is wrong or asks for help.

    Args:
        name: of its module, and of its root config where it has one.
        arguments: what was typed; None takes the command line.
    """
    try:
        _start(name, sys.argv[1:] if arguments is None else arguments)
    except KeyboardInterrupt:  # commands that can go on say so themselves
        print(f"\nsplatrl-{name}: interrupted", file=sys.stderr)
        sys.exit(INTERRUPTED)


def _start(name: str, typed: Sequence[str]) -> None:
    if name in PARSERS:
        options = PARSERS[name](typed)
        import_module(f"splatrl.commands.{name}").run(options)
        return
    from splatrl.configuration import command_line  # which brings Hydra

    sys.argv[1:] = command_line(name, typed)
    import_module(f"splatrl.commands.{name}").run()


capture = partial(start, "capture")
clips = partial(start, "clips")
evaluate = partial(start, "evaluate")
experiment = partial(start, "experiment")
export = partial(start, "export")
gait = partial(start, "gait")
record = partial(start, "record")
replay = partial(start, "replay")
scene = partial(start, "scene")
train = partial(start, "train")
view = partial(start, "view")
