"""MuJoCo, which the extra ``physics`` installs."""

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


def _quiet(message: str) -> None:
    """Ignore MuJoCo's warnings: ``read_mjcf`` refuses non-finite numbers, and ``Stepped.sound`` marks failed rows."""
