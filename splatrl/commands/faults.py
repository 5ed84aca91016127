"""One-line errors and warnings for faults that the user can fix; our own bugs keep their traceback."""

import functools
import os
import re
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import ParamSpec, TypeVar

from hydra.core.hydra_config import HydraConfig
from hydra.errors import CompactHydraException, HydraException, InstantiationException
from hydra.types import RunMode
from omegaconf.errors import OmegaConfBaseException

from splatrl.commands.entries import USERS
from splatrl.configuration.search_path import group_node, options

CONFIGURED = (*USERS, HydraException, OmegaConfBaseException)
FULL = "HYDRA_FULL_ERROR"
"""Environment variable that, when set, shows the full traceback of an error."""

MOTION = "task.motion"
"""The node of a task's motion, whose keys a task may set although another motion was typed."""

UNKNOWN = re.compile(r"(\w+)(?:\.__init__)?\(\) got an unexpected keyword argument '(\w+)'(\. Did you mean .*)?")
"""Python's message about an argument that a constructor does not take; from 3.13 on it may end with a guess."""

P = ParamSpec("P")
R = TypeVar("R")


def in_one_line(command: str) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Decorate a command so that errors which the user can fix end it with one line, and warnings take one line too.

    In a sweep the remaining jobs still run, and Hydra prints the line at the end.

    Args:
        command: the command's name, with which each line begins.
    """

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        @functools.wraps(function)
        def guarded(*args: P.args, **kwargs: P.kwargs) -> R:
            try:
                with _warnings_in_one_line(command):
                    return function(*args, **kwargs)
            except CONFIGURED as error:
                if os.environ.get(FULL):
                    raise
                text = f"{command}: {line(error)}"
            if HydraConfig.initialized() and HydraConfig.get().mode == RunMode.MULTIRUN:
                raise CompactHydraException(text)  # unchained: a cause would keep its scenes alive
            sys.exit(text)

        return guarded

    return decorate


@contextmanager
def _warnings_in_one_line(command: str) -> Iterator[None]:
    """Show warnings without their source location, which means nothing to whoever typed the command."""
    usual = warnings.formatwarning

    def told(
        message: Warning | str, category: type[Warning], filename: str, lineno: int, line: str | None = None
    ) -> str:
        if category is not UserWarning:  # our own warnings are plain UserWarnings
            return usual(message, category, filename, lineno, line)
        return f"{command}: {' '.join(str(message).split())}\n"

    warnings.formatwarning = told
    try:
        yield
    finally:
        warnings.formatwarning = usual


def line(error: BaseException) -> str:
    """Format an error as one line that begins with the config key from which it comes, if there is one.

    Args:
        error: one of ``USERS``; Hydra's wrapper around an exception from a constructor is removed.
    """
    key = ""
    if isinstance(error, InstantiationException):
        _, _, key = str(error).rpartition("full_key: ")
        error = error.__cause__ or error
    text = " ".join(str(error).split()) or type(error).__name__
    if isinstance(error, TypeError) and (unknown := UNKNOWN.fullmatch(text)):
        return f"{key.strip()}.{unknown[2]}: no such key in {unknown[1]}{_motion_with(key.strip(), unknown[2])}"
    if not isinstance(error, USERS):
        text = f"{type(error).__name__}: {text}"
    key = key.strip()
    return text if not key or text.startswith(key.partition(".")[0]) else f"{key}: {text}"


def _motion_with(place: str, key: str) -> str:
    """Return what to type for a motion that has a key; empty if there is none, or the key is not one of a motion."""
    fitting = [name for name in options("motion") if key in group_node("motion", name)] if place == MOTION else []
    return f"; type {' or '.join(f'motion@{MOTION}={name}' for name in fitting)}" if fitting else ""
