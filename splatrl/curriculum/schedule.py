"""The curriculum's level as a function of success: a pure state machine."""

from dataclasses import dataclass

import torch
from torch import Tensor

from splatrl.values import require_number


@dataclass(frozen=True)
class Schedule:
    """Promotes to the next level when enough episodes at the current one succeed.

    Progress is a [3] int64 tensor: the level, and the episodes and successes counted at that level. Episodes are
    counted in blocks: when ``window`` of them have ended, a success rate of at least ``threshold`` promotes, and either
    way the count starts over. No tensor's value is read on the host.

    Attributes:
        levels: number of levels.
        threshold: success rate required for promotion, in (0, 1].
        window: number of episodes in a block.
    """

    levels: int
    threshold: float = 0.7
    window: int = 100

    def __post_init__(self) -> None:
        require_number("levels", self.levels, 1, whole=True)
        if not 0 < self.threshold <= 1:
            raise ValueError(f"curriculum.threshold: expected a success rate in (0, 1], got {self.threshold}")
        require_number("curriculum.window", self.window, 1, whole=True)

    def start(self) -> Tensor:
        """Return the progress before the first episode: [3] int64."""
        return torch.zeros(3, dtype=torch.int64)

    def advance(self, progress: Tensor, level: Tensor, finished: Tensor, success: Tensor) -> Tensor:
        """Return the progress after some episodes have ended.

        Args:
            progress: [3] int64, the progress before.
            level: [B] int64, the level at which each episode began; only episodes of the current level count.
            finished: [B] bool, which episodes have ended.
            success: [B] bool, which episodes succeeded.

        Returns:
            [3] int64.
        """
        now, episodes, successes = progress.unbind()
        counted = finished & (level == now)
        episodes = episodes + counted.sum()
        successes = successes + (counted & success).sum()
        full = episodes >= self.window
        promoted = full & (successes >= self.threshold * episodes.double() - 1e-9)  # equality is enough
        now = (now + promoted).clamp_max(self.levels - 1)
        return torch.stack([now, episodes * ~full, successes * ~full])
