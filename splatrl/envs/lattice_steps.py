"""Precomputed steps on a lattice: each is carried out and judged once, then looked up; so are episode starts."""

import math
from collections.abc import Mapping
from typing import NamedTuple

import torch
from tensordict import TensorDictBase
from torch import Tensor

from splatrl.collision.base import Checker
from splatrl.curriculum import Curriculum
from splatrl.envs.rules import COUNTED
from splatrl.envs.tasks.base import NOTHING, Anywhere, Step, Task
from splatrl.envs.tasks.rewards import OutcomeTask
from splatrl.motions.finite import FiniteMotion
from splatrl.motions.module import SweptMotion
from splatrl.native import _core

MOST = 2**17
"""Maximum number of steps to precompute; this many take about a tenth of a second."""


class Taken(NamedTuple):
    """Result of a step of B robots, without their images.

    Attributes:
        values: everything that the env returns except what is drawn, by key.
        body_to_world: [B, 4, 4] float32, poses after the step, metres.
    """

    values: dict[str, Tensor]
    body_to_world: Tensor


class LatticeSteps:
    """Lookup table for the steps of B robots on a lattice, on the CPU; the constructor computes every step once.

    Results are bit-identical to those of ``SplatEnv``, both for steps and for episodes that begin.

    Args:
        task: a task that ``suits``.
        checker: finds what the body touches.
        curriculum: draws starts and records episodes that end.
        count: number of robots, B.
        anywhere: see ``Task.judge``.
    """

    def __init__(self, task: Task, checker: Checker, curriculum: Curriculum, count: int, anywhere: Anywhere):
        motion = task.motion
        assert isinstance(motion, FiniteMotion)
        self.task, self.curriculum = task, curriculum
        states, actions = motion.states(), motion.actions()
        before, action = states.repeat_interleave(len(actions), 0), actions.repeat(len(states))
        move = motion.move(before, action, checker)
        reward, terminated, outcome, _ = task.judge(Step(before, action, move, NOTHING), anywhere)
        self._table = _core.StepTable(
            shape=motion.shape,
            next=motion.index(move.state).view(len(states), -1),
            free_fraction=move.free_fraction.view(len(states), -1),
            reward=reward.view(len(states), -1),
            terminated=terminated.view(len(states), -1),
            outcome=outcome.view(len(states), -1),
            poses=motion.body_to_world(states),
        )
        number, share, flag = (torch.empty(count, 1, dtype=dtype) for dtype in (torch.int64, torch.float32, torch.bool))
        like = {"state": states[:1].repeat(count, 1), "step_count": number, "episode_return": share, "level": number}
        like |= {"goals": number, "outcome": number, "free_fraction": share, "reward": share}
        self._like = like | dict.fromkeys(("success", "done", "terminated", "truncated"), flag)
        self._begun = {key: one for key, one in self._like.items() if key != "reward"}
        self._count, self._poses = count, torch.empty(count, 4, 4)
        read = (like["state"], actions[:1].expand(count), *(like[key] for key in COUNTED))
        self._read = [_kind(values) for values in read]

    def step(self, given: Mapping[str, Tensor] | TensorDictBase, rows: Tensor | None = None) -> Taken | None:
        """Carry out a step.

        Args:
            given: input of the env's step, [N] with N ≤ B.
            rows: [N] int64, the rows of the batch that step; None for all.

        Returns:
            The result; None, with nothing changed, for states or actions that are not on the lattice.
        """
        held = dict(given.items())
        read, count = [held["state"], held["action"], *(held[key] for key in COUNTED)], len(held["state"])
        like, poses_like, kinds = self._like, self._poses, self._read
        if count < self._count:
            like, poses_like = {key: one[:count] for key, one in like.items()}, poses_like[:count]
            kinds = [(dtype, size // self._count * count, here) for dtype, size, here in kinds]
        if [_kind(values) for values in read] != kinds:
            return None
        read = [each.contiguous() for each in read]  # keeps copies alive while C++ reads them
        values = {key: torch.empty_like(one) for key, one in like.items()}
        poses = torch.empty_like(poses_like)
        known = self._table.step(
            [each.data_ptr() for each in read],
            [each.data_ptr() for each in (*values.values(), poses)],
            count,
            0 if rows is None else rows.data_ptr(),
            self.task.max_steps,
            self.task.goals_for_success or 1,
            self._counts(),
        )
        return Taken(values, poses) if known else None

    def begin(self, after: Mapping[str, Tensor], rows: Tensor, generator: torch.Generator) -> Taken | None:
        """Begin episodes in some rows.

        Args:
            after: [B, ...] by key, the result of a step.
            rows: [N] int64, rows in which episodes begin, ascending.
            generator: draws starts for all B rows.

        Returns:
            All entries except what is drawn, [B, ...], and the poses of the new rows, [N, 4, 4]; None, with nothing
            changed, for entries whose dtype, size or device differs from a step's.
        """
        old = [after[key] for key in self._begun]
        if [_kind(values) for values in old] != [_kind(values) for values in self._begun.values()]:
            return None
        old = [each.contiguous() for each in old]
        values = {key: torch.empty_like(one) for key, one in self._begun.items()}
        count, starts, level = len(rows), self.curriculum.starts, int(self.curriculum.progress[0])
        poses = torch.empty(count, 4, 4)
        uniform = torch.rand(self._count, generator=generator, dtype=torch.float64)
        self._table.begin(
            [each.data_ptr() for each in old],
            [each.data_ptr() for each in (*values.values(), poses)],
            self._count,
            rows.data_ptr(),
            count,
            uniform.data_ptr(),
            starts.ordered.data_ptr(),
            int(starts.counts[0, level]),
            self._counts(),
        )
        return Taken(values, poses)

    def _counts(self) -> tuple[int, int, int, int, int, int]:
        """Return where the curriculum counts, and by which rules, as the table takes it."""
        curriculum, schedule, count = self.curriculum, self.curriculum.schedule, self._count
        curriculum.seat(count)
        addresses = curriculum.progress.data_ptr(), curriculum.cohort.data_ptr()
        return *addresses, count, schedule.levels, schedule.window, schedule.enough


def _kind(values: Tensor) -> tuple[torch.dtype, int, bool]:
    return values.dtype, values.numel(), values.is_cpu


def suits(task: Task, curriculum: Curriculum) -> bool:
    """Return whether steps depend only on state and action, with few of both, and the task leaves starts as drawn."""
    motion = task.motion
    if not isinstance(motion, FiniteMotion) or not isinstance(task, OutcomeTask) or task.memory_spec:
        return False
    return (
        _does_as(task, OutcomeTask, "judge", "start", "begin")
        and _does_as(motion, SweptMotion, "move")
        and _does_as(curriculum, Curriculum, "begin", "record", "scenes", "sample")
        and len(motion.moves) * math.prod(motion.shape) <= MOST
    )


def _does_as(one: object, base: type, *methods: str) -> bool:
    """Return whether an object inherits these methods of a class without overriding them."""
    return all(getattr(type(one), name) is getattr(base, name) for name in methods)
