"""Hand-made steps for tasks to judge."""

import torch
from torch import Tensor

from splatrl.envs.tasks import Step, Task, Verdict
from splatrl.motions import Move


def judged(task: Task, ahead: Tensor, hit: Tensor) -> Verdict:
    """Return a task's verdict on robots whose actions lead to the given states.

    Args:
        task: a task that remembers nothing and ignores the image.
        ahead: [B, ...] states, which may lie outside the bounds.
        hit: [B] bool, whether something is touched on the way.
    """
    motion = task.motion
    free = torch.where(hit, 0.5, 1.0)
    move = Move(ahead, torch.eye(4).expand(len(ahead), 4, 4), free, motion.inside(ahead))
    action = motion.action_spec.zero((len(ahead),))
    return task.judge(Step(ahead, action, move, {}), nowhere)


def nowhere() -> Tensor:
    """Fail, because the task must not draw states."""
    raise AssertionError("expected a task that draws no states")
