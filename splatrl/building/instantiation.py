"""Building objects from config nodes, with errors that name the key in one line."""

import re
from typing import Any

import hydra.utils
from hydra.errors import HydraException, InstantiationException
from omegaconf.errors import OmegaConfBaseException

from splatrl.configuration.search_path import group_node, options
from splatrl.values import one_line

KINDS = (FileNotFoundError, OSError, ImportError, ValueError)
"""Kinds of errors that stay what they are; any other becomes a ``ValueError``."""

MOTION = "task.motion"
"""The node of a task's motion, whose keys a task may set although another motion was typed."""

UNKNOWN = re.compile(r"(\w+)(?:\.__init__)?\(\) got an unexpected keyword argument '(\w+)'(\. Did you mean .*)?")
"""Python's message about an argument that a constructor does not take; from 3.13 on it may end with a guess."""


def instantiate(node: Any, *args: Any, **kwargs: Any) -> Any:
    """Build what a config node describes, as Hydra does.

    Raises:
        FileNotFoundError, OSError, ImportError, ValueError: what a constructor raises, without Hydra's wrapper, as one
            line that begins with the key from which it comes; a ``ValueError`` in place of any other kind.
    """
    try:
        return hydra.utils.instantiate(node, *args, **kwargs)
    except InstantiationException as error:
        cause = error.__cause__ or error
        kind = next((kind for kind in KINDS if isinstance(cause, kind)), ValueError)
        raise kind(line(error)) from cause


def line(error: InstantiationException) -> str:
    """Format Hydra's wrapper around an exception from a constructor as one line, which begins with the key."""
    key = str(error).rpartition("full_key: ")[2].strip()
    cause = error.__cause__ or error
    text = one_line(cause)
    if isinstance(cause, TypeError) and (unknown := UNKNOWN.fullmatch(text)):
        return f"{key}.{unknown[2]}: no such key in {unknown[1]}{_motion_with(key, unknown[2])}"
    if not isinstance(cause, (*KINDS, HydraException, OmegaConfBaseException)):
        text = f"{type(cause).__name__}: {text}"
    return text if not key or text.startswith(key.partition(".")[0]) else f"{key}: {text}"


def _motion_with(place: str, key: str) -> str:
    """Return what to type for a motion that has a key; empty if there is none, or the key is not one of a motion."""
    fitting = [name for name in options("motion") if key in group_node("motion", name)] if place == MOTION else []
    return f"; type {' or '.join(f'motion@{MOTION}={name}' for name in fitting)}" if fitting else ""
