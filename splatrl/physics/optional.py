"""What the extra ``physics`` installs."""

import importlib
from typing import Any


def needed(name: str = "mujoco") -> Any:
    """Import a module of the extra ``physics``.

    Raises:
        ImportError: says how to install it.
    """
    try:
        module = importlib.import_module(name)
    except ImportError as error:
        raise ImportError("mujoco is missing: pip install 'splatrl[physics]'") from error
    if name == "mujoco":
        module.set_mju_user_warning(_quiet)  # it would write a file MUJOCO_LOG.TXT wherever a program runs
    return module


def _quiet(message: str) -> None:
    """Pass over what MuJoCo warns of: ``read_mjcf`` refuses odd numbers, ``Stepped.sound`` tells lost rows."""
