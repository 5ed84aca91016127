"""What the extra ``physics`` installs."""

import importlib
from typing import Any


def needed(name: str = "mujoco") -> Any:
    """Import a module of the extra ``physics``.

    Raises:
        ImportError: says how to install it.
    """
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise ImportError("mujoco is missing: pip install 'splatrl[physics]'") from error
