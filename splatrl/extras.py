"""Imports of optional packages, which the extras of splatrl install."""

from importlib import import_module
from types import ModuleType


def require(module: str, extra: str, problem: str = "", advice: str = "") -> ModuleType:
    """Import a module that an extra installs.

    Args:
        module: full name of the module.
        extra: name of the extra.
        problem: what the error says before the command that installs the extra; ``<module> is missing`` by default.
        advice: what the error says after the command.

    Raises:
        ImportError: if the module, or one that it imports, is missing or broken; one line says how to install it.
    """
    try:
        return import_module(module)
    except ImportError as error:
        reason = "" if isinstance(error, ModuleNotFoundError) else f" ({error})"
        raise ImportError(install_hint(extra, problem or f"{module} is missing", advice) + reason) from error


def install_hint(extra: str, problem: str, advice: str = "") -> str:
    """Return the line that says what is missing and which extra to install; see ``require``."""
    return f"{problem}: pip install 'splatrl[{extra}]'{advice}"
