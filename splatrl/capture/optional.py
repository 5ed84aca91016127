"""Packages that the extra ``capture`` installs."""

import importlib
from types import ModuleType


def needed(name: str) -> ModuleType:
    """Import a package of the extra ``capture``.

    Args:
        name: name of the module.

    Raises:
        ImportError: where it is missing; says how to install it.
    """
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise ImportError(f"{name} is missing: pip install 'splatrl[capture]'") from error
