"""Imports the modules that the extra ``physics`` installs."""

import importlib
from typing import Any


def needed(name: str = "mujoco") -> Any:
    """Import a module of the extra ``physics``.

    Raises:
        ImportError: if it is missing; says how to install it.
    """
    try:
        module = importlib.import_module(name)
    except ImportError as error:
        raise ImportError("mujoco is missing: pip install 'splatrl[physics]'") from error
    if name == "mujoco":
        module.set_mju_user_warning(_quiet)  # the default writes MUJOCO_LOG.TXT into the working directory
    return module


def _quiet(message: str) -> None:
    """Ignore MuJoCo's warnings: ``read_mjcf`` refuses non-finite numbers, and ``Stepped.sound`` marks failed rows."""
