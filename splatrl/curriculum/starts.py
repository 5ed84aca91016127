"""Start states, drawn according to the curriculum's level."""

import math
from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor, nn

from splatrl.curriculum.planner import Plan
from splatrl.curriculum.schedule import Schedule
from splatrl.values import require_number


class Starts(nn.Module):
    """The start sets of one or several scenes, ordered by distance to the goal.

    Level l draws uniformly among the starts whose shortest path has at most ``first + l · stride`` steps; the highest
    level is all of them that an episode is long enough for (``Plan.in_reach``). In a scene that has no path this short,
    a level draws among the scene's shortest.

    Args:
        plan: states and distances of one scene or of several.
        first: longest path at level 0, steps; None makes the whole set, whatever is in reach, the only level.
        stride: steps that each level adds.

    Attributes:
        limits: the longest path at each level, steps.
    """

    ordered: Tensor  # [N, D] states, ordered by scene, then by distance
    begins: Tensor  # [S] int64, the first state of each scene
    counts: Tensor  # [S, levels] int64, number of a scene's states that a level uses

    def __init__(self, plan: Plan | Sequence[Plan], first: int | None = 2, stride: int = 1):
        super().__init__()
        for name, steps in (("first", 1 if first is None else first), ("stride", stride)):
            require_number(f"curriculum.{name}", steps, 1, whole=True)
        plans = [plan] if isinstance(plan, Plan) else list(plan)
        plans = plans if first is None else [own.in_reach for own in plans]
        sets = [(own, *own.distance[own.start_rows].sort(stable=True)) for own in plans]
        ordered = [own.states[own.start_rows[order]] for own, _, order in sets]
        self.register_buffer("ordered", torch.cat(ordered), persistent=False)
        ends = torch.tensor([len(states) for states in ordered], device=self.ordered.device).cumsum(0)
        self.register_buffer("begins", ends - ends.diff(prepend=ends.new_zeros(1)), persistent=False)
        farthest = max(int(distance[-1]) for _, distance, _ in sets)
        self.limits = self._limits(farthest, first, stride)
        limits = torch.tensor(self.limits, device=ends.device)
        counts = [
            torch.searchsorted(distance, limits.clamp_min(int(distance[0])), right=True) for _, distance, _ in sets
        ]
        self.register_buffer("counts", torch.stack(counts), persistent=False)

    @staticmethod
    def _limits(farthest: int, first: int | None, stride: int) -> Sequence[int]:
        if first is None or first >= farthest:
            return [farthest]
        return [first + stride * level for level in range(math.ceil((farthest - first) / stride) + 1)]

    @property
    def levels(self) -> int:
        """Number of levels."""
        return self.counts.shape[1]

    @property
    def scenes(self) -> int:
        """Number of scenes."""
        return len(self.counts)

    def share(self, level: int) -> float:
        """Return the fraction of all starts from which a level draws."""
        return int(self.counts[:, level].sum()) / int(self.counts[:, -1].sum())

    def sample(self, level: Tensor, count: int, generator: torch.Generator, scene: Tensor | None = None) -> Tensor:
        """Draw start states, which consumes ``count`` numbers of the generator.

        Args:
            level: [] int64, the level from which to draw.
            count: number of states to draw.
            generator: source of randomness.
            scene: [count] int64, the scene of each state; None takes the first scene.

        Returns:
            [count, D].
        """
        uniform = torch.rand(count, generator=generator, device=self.ordered.device, dtype=torch.float64)
        available = self.counts.index_select(1, level.reshape(1)).squeeze(1)  # indexing with a scalar would synchronise
        available = available[:1] if scene is None else available.index_select(0, scene)
        rows = (uniform * available).long().clamp_max(available - 1)
        return self.ordered[rows if scene is None else rows + self.begins.index_select(0, scene)]


class Curriculum(nn.Module):
    """Starts that move away from the goal as long as the success rate holds.

    Progress and cohort are buffers that are updated in place, so a resumed run continues at its level, and a step
    captured in a CUDA graph continues the count of the step before. The rows are those of one env.

    All scenes share one level, and each robot's scene is drawn uniformly at random.

    Args:
        plan: states and distances of one scene or of several.
        first: see ``Starts``.
        stride: see ``Starts``.
        threshold: see ``Schedule``.
        window: see ``Schedule``.
    """

    progress: Tensor  # [3] int64
    cohort: Tensor  # [B] bool, the members of ``Schedule``

    def __init__(
        self,
        plan: Plan | Sequence[Plan],
        first: int | None = 2,
        stride: int = 1,
        threshold: float = 0.7,
        window: int = 100,
    ):
        super().__init__()
        self.starts = Starts(plan, first, stride)
        self.schedule = Schedule(self.starts.levels, threshold, window)
        self.register_buffer("progress", self.schedule.start())
        self.register_buffer("cohort", torch.zeros(0, dtype=torch.bool))

    @property
    def level(self) -> Tensor:
        """The current level: [] int64."""
        return self.progress[0]

    def scenes(self, count: int, generator: torch.Generator) -> Tensor | None:
        """Draw the scene of each robot, [count] int64; with only one scene, draw nothing and return None."""
        if self.starts.scenes == 1:
            return None
        return torch.randint(self.starts.scenes, (count,), generator=generator, device=self.starts.counts.device)

    def sample(self, count: int, generator: torch.Generator, scene: Tensor | None = None) -> Tensor:
        """Draw start states of the current level, in given scenes [count] int64: [count, D]."""
        return self.starts.sample(self.level, count, generator, scene)

    def anywhere(self, count: int, generator: torch.Generator, scene: Tensor | None = None) -> Tensor:
        """Draw states of the highest level, whatever the current one: [count, D]."""
        highest = torch.full_like(self.level, self.starts.levels - 1)
        return self.starts.sample(highest, count, generator, scene)

    def seat(self, rows: int) -> None:
        """Make room for the episodes of a number of robots; if that changes, the cohort begins anew."""
        if len(self.cohort) != rows:
            self.progress[1:] = 0
            self.cohort = self.cohort.new_zeros(rows)

    def begin(self, begun: Tensor) -> None:
        """Note in which rows episodes of the current level have begun, [B] bool; see ``Schedule.begin``."""
        self.seat(len(begun))
        self._note(*self.schedule.begin(self.progress, self.cohort, begun))

    def record(self, level: Tensor, finished: Tensor, success: Tensor) -> None:
        """Record ended episodes; see ``Schedule.advance``.

        Args:
            level: [B] int64, the level at which each episode began; only episodes of the current level count.
            finished: [B] bool, which episodes have ended.
            success: [B] bool, which episodes succeeded.
        """
        self.seat(len(finished))
        finished = finished & (level == self.level)
        self._note(*self.schedule.advance(self.progress, self.cohort, finished, success))

    def cut_off(self, rows: Tensor) -> None:
        """Note in which rows the episode will not be continued, [B] bool: a member there has failed."""
        self.record(self.level, rows, torch.zeros_like(rows))

    def _note(self, progress: Tensor, members: Tensor) -> None:
        self.progress.copy_(progress)
        self.cohort.copy_(members)

    def _load_from_state_dict(self, state_dict: dict[str, Any], prefix: str, *rest: Any) -> None:
        if (saved := state_dict.get(f"{prefix}cohort")) is not None:
            self.seat(len(saved))  # an env of another number of robots keeps the level, and begins another cohort
        super()._load_from_state_dict(state_dict, prefix, *rest)
        self.cut_off(torch.zeros_like(self.cohort))  # other levels, or a lower threshold, may decide it already
