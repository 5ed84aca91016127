"""The curriculum's level as a function of success: a pure state machine."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from splatrl.values import require_number


@dataclass(frozen=True)
class Schedule:
    """Promotes to the next level when enough episodes of a cohort succeed.

    A cohort is the next ``window`` episodes that begin, in the order of their rows. Which episodes count is thus known
    before anything is known about them: counting those that end first would favour quick successes over slow failures.
    As soon as a fraction ``threshold`` of the cohort has succeeded, the next level begins; as soon as too many have
    failed for that, the level stays. Either way the next cohort begins with the next episodes. While a member neither
    ends nor begins anew, such as a robot that TorchRL's ``_step`` never lets step, its cohort may stay undecided.

    Progress is a [3] int64 tensor: the level, and how many of the cohort's episodes have ended and succeeded. Members
    is a [B] bool tensor: whether the episode that runs in a row is one of the cohort. No tensor's value is read on the
    host.

    Attributes:
        levels: number of levels.
        threshold: success rate required for promotion, in (0, 1].
        window: number of episodes in a cohort.
    """

    levels: int
    threshold: float = 0.7
    window: int = 100

    def __post_init__(self) -> None:
        require_number("levels", self.levels, 1, whole=True)
        if not 0 < self.threshold <= 1:
            raise ValueError(f"curriculum.threshold: expected a success rate in (0, 1], got {self.threshold}")
        require_number("curriculum.window", self.window, 1, whole=True)

    @property
    def enough(self) -> int:
        """Number of successes in a cohort that promotes."""
        return max(math.ceil(self.threshold * self.window - 1e-9), 1)  # 0.07 * 100 is a little more than 7

    def start(self) -> Tensor:
        """Return the progress before the first episode: [3] int64."""
        return torch.zeros(3, dtype=torch.int64)

    def begin(self, progress: Tensor, members: Tensor, begun: Tensor) -> tuple[Tensor, Tensor]:
        """Return progress and members after episodes have begun in some rows.

        A member that still ran there was cut off, for instance by a time limit around the env, and has failed.

        Args:
            progress: [3] int64, the progress before.
            members: [B] bool, the members before.
            begun: [B] bool, rows in which episodes have begun.

        Returns:
            [3] int64 and [B] bool.
        """
        progress, members = self.advance(progress, members, begun, torch.zeros_like(begun))
        room = self.window - progress[1] - members.sum()
        return progress, members | (begun & (begun.cumsum(0) <= room))

    def advance(self, progress: Tensor, members: Tensor, ended: Tensor, success: Tensor) -> tuple[Tensor, Tensor]:
        """Return progress and members after some episodes have ended; only those of the cohort count.

        Args:
            progress: [3] int64, the progress before.
            members: [B] bool, the members before.
            ended: [B] bool, which episodes have ended.
            success: [B] bool, which episodes succeeded.

        Returns:
            [3] int64 and [B] bool.
        """
        level, episodes, successes = progress.unbind()
        counted = members & ended
        episodes, successes = episodes + counted.sum(), successes + (counted & success).sum()
        promoted = successes >= self.enough
        undecided = ~promoted & (episodes - successes <= self.window - self.enough)
        level = (level + promoted).clamp_max(self.levels - 1)
        return torch.stack([level, episodes * undecided, successes * undecided]), members & ~ended & undecided
