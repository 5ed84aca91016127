"""Entry points of the console scripts: they check the command line and answer ``--help`` at once.

Only then is the command itself imported, with PyTorch, TorchRL and matplotlib, which takes seconds.
"""

import os
import sys
from collections.abc import Sequence
from contextlib import suppress
from functools import partial
from importlib import import_module

from splatrl.commands import parsers
from splatrl.commands.outputs import open_outputs
from splatrl.commands.stopping import INTERRUPTED, tidy
from splatrl.files import cache_dir, expanded

USERS = (ImportError, OSError, ValueError)
"""Errors that a user can fix; commands end with one line for them."""
TYPED: list[str] = []
"""The words of the command that this process runs, as they were typed; none in processes that a launcher starts."""
PARSERS = {"capture": parsers.capture, "compare": parsers.compare, "gait": parsers.gait, "scene": parsers.scene}
"""Parsers of the commands that take options; all other commands have a config."""


def start(name: str, arguments: Sequence[str] | None = None) -> None:
    """Run a command, unless its arguments are invalid or ask for help.

    Args:
        name: name of the command's module, and of its root config if it has one.
        arguments: the command's arguments; None takes them from the command line.
    """
    open_outputs()
    keep_fonts()
    try:
        if "--version" in (sys.argv[1:] if arguments is None else arguments):
            print(f"splatrl {import_module('importlib.metadata').version('splatrl')}")
            return
        with tidy():
            _start(name, sys.argv[1:] if arguments is None else arguments)
    except KeyboardInterrupt:  # resumable commands catch it themselves and say so
        print(f"\nsplatrl-{name}: interrupted", file=sys.stderr)
        sys.exit(INTERRUPTED)


def _start(name: str, typed: Sequence[str]) -> None:
    if name in PARSERS:
        options = PARSERS[name](typed)
        import_module(f"splatrl.commands.{name}").run(options)
        return
    from splatrl.configuration import command_line  # imports Hydra

    TYPED[:] = typed
    sys.argv[1:] = command_line(name, typed)
    import_module(f"splatrl.commands.{name}").run()


def keep_fonts() -> None:
    """Let matplotlib keep its list of fonts in our cache where the home folder is read-only, as in many containers."""
    if not os.access(expanded("~"), os.W_OK):
        with suppress(ValueError):  # no folder for caches, either; matplotlib makes a temporary one
            os.environ.setdefault("MPLCONFIGDIR", str(cache_dir().absolute() / "matplotlib"))


capture = partial(start, "capture")
clips = partial(start, "clips")
compare = partial(start, "compare")
evaluate = partial(start, "evaluate")
experiment = partial(start, "experiment")
export = partial(start, "export")
gait = partial(start, "gait")
record = partial(start, "record")
replay = partial(start, "replay")
scene = partial(start, "scene")
train = partial(start, "train")
view = partial(start, "view")
