"""Tasks: what a robot is rewarded for."""

from splatrl.envs.tasks.base import Motion, Outcome, Task, Verdict
from splatrl.envs.tasks.grid import Grid

__all__ = ["Grid", "Motion", "Outcome", "Task", "Verdict"]
