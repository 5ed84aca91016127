"""What the scripts of Hydra's commands start: what was typed is checked, and ``--help`` answered, at once.

A command itself imports the library, with PyTorch, TorchRL and matplotlib, which takes seconds.
"""

import sys
from functools import partial
from importlib import import_module

from splatrl.configuration import command_line


def start(name: str) -> None:
    """Run a command, unless what was typed is wrong or asks for help.

    Args:
        name: of its module and of its root config.
    """
    sys.argv[1:] = command_line(name, sys.argv[1:])
    import_module(f"splatrl.commands.{name}").run()


train = partial(start, "train")
evaluate = partial(start, "evaluate")
experiment = partial(start, "experiment")
clips = partial(start, "clips")
record = partial(start, "record")
replay = partial(start, "replay")
view = partial(start, "view")
export = partial(start, "export")
