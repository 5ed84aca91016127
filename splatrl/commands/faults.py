"""One-line errors and warnings for faults that the user can fix; our own bugs keep their traceback."""

import functools
import os
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import ParamSpec, TypeVar

from hydra.core.hydra_config import HydraConfig
from hydra.errors import CompactHydraException, HydraException
from hydra.types import RunMode
from omegaconf.errors import OmegaConfBaseException

from splatrl.commands.entries import USERS
from splatrl.values import one_line

CONFIGURED = (*USERS, HydraException, OmegaConfBaseException)
FULL = "HYDRA_FULL_ERROR"
"""Environment variable that, when it is 1, as for Hydra, shows the full traceback of an error."""

P = ParamSpec("P")
R = TypeVar("R")


def in_one_line(command: str) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Decorate a command so that errors which the user can fix end it with one line, and warnings take one line too.

    In a sweep the remaining jobs still run. Each job that fails prints its line at once, with the number under which
    Hydra listed its overrides, and Hydra repeats the first of these lines at the end.

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
                if os.environ.get(FULL) == "1":
                    raise
                text = one_line(error)
            if HydraConfig.initialized() and HydraConfig.get().mode == RunMode.MULTIRUN:
                text = f"{command}: job #{HydraConfig.get().job.num}: {text}"
                print(text, file=sys.stderr, flush=True)
                raise CompactHydraException(text)  # unchained: a cause would keep its scenes alive
            sys.exit(f"{command}: {text}")

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
        return f"{command}: {one_line(message)}\n"

    warnings.formatwarning = told
    try:
        yield
    finally:
        warnings.formatwarning = usual
