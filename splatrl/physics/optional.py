"""MuJoCo, which the extra ``physics`` installs."""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType

from splatrl.extras import require


def needed() -> ModuleType:
    """Import MuJoCo, and keep it from writing a log file.

    Raises:
        ImportError: without the extra ``physics``; see ``require``.
    """
    mujoco = require("mujoco", "physics")
    mujoco.set_mju_user_warning(_quiet)  # the default writes MUJOCO_LOG.TXT into the working directory
    return mujoco


@contextmanager
def without_warnings() -> Iterator[None]:
    """Drop what MuJoCo warns of while it reads, joins and compiles models.

    It warns of outdated attributes, whose removal an error would announce, and of settings such as those of its own
    viewer that a world does not take from its parts.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def _quiet(message: str) -> None:
    """Ignore MuJoCo's warnings: ``read_mjcf`` refuses non-finite numbers, and ``Stepped.sound`` marks failed rows."""
