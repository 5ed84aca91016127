"""Start states, drawn according to the curriculum's level."""

import math
from collections.abc import Sequence

import torch
from torch import Tensor, nn

from splatrl.curriculum.planner import Plan
from splatrl.curriculum.schedule import Schedule
from splatrl.values import require_number


class Starts(nn.Module):
    """The start set of a plan, ordered by distance to the goal.

    Level l draws uniformly among the starts whose shortest path has at most ``first + l · stride`` steps; the highest
    level is the whole set.

    Args:
        plan: states and distances.
        first: longest path at level 0, steps; None makes the whole set the only level.
        stride: steps that each level adds.
    """

    ordered: Tensor  # [N, D] states by distance
    counts: Tensor  # [levels] int64, how many of them a level uses

    def __init__(self, plan: Plan, first: int | None = 2, stride: int = 1):
        super().__init__()
        for name, steps in (("first", 1 if first is None else first), ("stride", stride)):
            require_number(f"curriculum.{name}", steps, 1, whole=True)
        rows = plan.start_rows
        distance, order = plan.distance[rows].sort(stable=True)
        self.register_buffer("ordered", plan.states[rows[order]], persistent=False)
        farthest = int(distance[-1])
        limits = torch.tensor(self._limits(farthest, first, stride), device=distance.device)
        self.register_buffer("counts", torch.searchsorted(distance, limits, right=True), persistent=False)

    @staticmethod
    def _limits(farthest: int, first: int | None, stride: int) -> Sequence[int]:
        if first is None or first >= farthest:
            return [farthest]
        return [first + stride * level for level in range(math.ceil((farthest - first) / stride) + 1)]

    @property
    def levels(self) -> int:
        """Number of levels."""
        return len(self.counts)

    def sample(self, level: Tensor, count: int, generator: torch.Generator) -> Tensor:
        """Draw start states: level [] int64 -> [count, D]; consumes ``count`` numbers of the generator."""
        uniform = torch.rand(count, generator=generator, device=self.ordered.device, dtype=torch.float64)
        available = self.counts.index_select(0, level.reshape(1))  # indexing with a scalar would synchronise
        return self.ordered[(uniform * available).long().clamp_max(available - 1)]


class Curriculum(nn.Module):
    """Starts that move away from the goal as long as the success rate holds.

    Its progress is a buffer that is changed in place, so a resumed run continues at its level, and a captured step
    continues the count of the one before.

    Args:
        plan: states and distances.
        first: see ``Starts``.
        stride: see ``Starts``.
        threshold: see ``Schedule``.
        window: see ``Schedule``.
    """

    progress: Tensor  # [3] int64

    def __init__(self, plan: Plan, first: int | None = 2, stride: int = 1, threshold: float = 0.7, window: int = 100):
        super().__init__()
        self.starts = Starts(plan, first, stride)
        self.schedule = Schedule(self.starts.levels, threshold, window)
        self.register_buffer("progress", self.schedule.start())

    @property
    def level(self) -> Tensor:
        """The current level: [] int64."""
        return self.progress[0]

    def sample(self, count: int, generator: torch.Generator) -> Tensor:
        """Draw start states of the current level: [count, D]."""
        return self.starts.sample(self.level, count, generator)

    def anywhere(self, count: int, generator: torch.Generator) -> Tensor:
        """Draw states from the whole start set, whatever the level: [count, D]."""
        highest = torch.full_like(self.level, self.starts.levels - 1)
        return self.starts.sample(highest, count, generator)

    def record(self, level: Tensor, finished: Tensor, success: Tensor) -> None:
        """Record ended episodes; see ``Schedule.advance``."""
        self.progress.copy_(self.schedule.advance(self.progress, level, finished, success))
