"""Errors and warnings for the people who type a command, in one line each; errors of ours keep their traceback."""

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

USERS = (ValueError, OSError, ImportError, HydraException, OmegaConfBaseException)
FULL = "HYDRA_FULL_ERROR"
"""Set in the environment, it shows where an error came from."""

UNKNOWN = re.compile(r"(\w+)(?:\.__init__)?\(\) got an unexpected keyword argument '(\w+)'")
"""What Python says of an argument that a constructor does not take."""

P = ParamSpec("P")
R = TypeVar("R")


def in_one_line(command: str) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Decorate what a command does, so that it ends with one line for what the user can mend, and warns in one line.

    In a sweep the other jobs still run, and Hydra prints the line at the end.

    Args:
        command: its name, which begins the line.
    """

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        @functools.wraps(function)
        def guarded(*args: P.args, **kwargs: P.kwargs) -> R:
            try:
                with _warnings_in_one_line(command):
                    return function(*args, **kwargs)
            except USERS as error:
                if os.environ.get(FULL):
                    raise
                text = f"{command}: {line(error)}"
            if HydraConfig.initialized() and HydraConfig.get().mode == RunMode.MULTIRUN:
                raise CompactHydraException(text)  # without the error, which would keep scenes alive to the end
            sys.exit(text)

        return guarded

    return decorate


@contextmanager
def _warnings_in_one_line(command: str) -> Iterator[None]:
    """Warn without the place in the code, which says nothing to who typed the command."""
    usual = warnings.formatwarning

    def told(
        message: Warning | str, category: type[Warning], filename: str, lineno: int, line: str | None = None
    ) -> str:
        if category is not UserWarning:  # not one of ours
            return usual(message, category, filename, lineno, line)
        return f"{command}: {' '.join(str(message).split())}\n"

    warnings.formatwarning = told
    try:
        yield
    finally:
        warnings.formatwarning = usual


def line(error: BaseException) -> str:
    """What an error says, in one line, with the key of the config that it comes from.

    Args:
        error: one of ``USERS``; Hydra's wrapping of what a constructor raised is taken off.
    """
    key = ""
    if isinstance(error, InstantiationException):
        _, _, key = str(error).rpartition("full_key: ")
        error = error.__cause__ or error
    text = " ".join(str(error).split()) or type(error).__name__
    if isinstance(error, TypeError) and (unknown := UNKNOWN.fullmatch(text)):
        return f"{key.strip()}.{unknown[2]}: no such key of {unknown[1]}"
    if not isinstance(error, USERS):
        text = f"{type(error).__name__}: {text}"
    key = key.strip()
    return text if not key or text.startswith(key.partition(".")[0]) else f"{key}: {text}"
