"""Shortest paths over the free poses of a motion, and where episodes may begin."""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from splatrl.collision.base import Checker
from splatrl.curriculum.field import FAR, WAYS_OUT, Field, Reached, cost_field
from splatrl.motions.base import PlannedMotion

UNREACHABLE = -1
ALIKE = 0.1
"""Two actions count as equally good where the steps left after them differ by no more than this."""
NO_GOAL = "task: expected one with goal states, to which shortest paths can be planned"


@dataclass(frozen=True)
class Plan:
    """The states in which episodes may begin, and how far the goal is from any state.

    Attributes:
        states: [S, D], all candidate start states.
        free: [S] bool, where an episode could begin: the body touches nothing.
        distance: [S] int64, fewest steps to the goal; 0 at it, UNREACHABLE where there is no path. Without a goal it is
            0 where the body fits.
        actions: [A, ...], the actions from which paths are made.
        motion: moves between the states.
        checker: tells which moves are free.
        start_rows: [N] int64, rows of the start set: the free states, other than goal states, from which a goal state
            can be reached; without a goal all free states.
        reached: tells which states are at the goal.
        field: steps to the goal from any state inside the bounds; None without a goal.
    """

    states: Tensor
    free: Tensor
    distance: Tensor
    actions: Tensor
    motion: PlannedMotion
    checker: Checker
    start_rows: Tensor
    reached: Reached
    field: Field | None = None

    @property
    def starts(self) -> Tensor:
        """The start set: [N, D] states."""
        return self.states[self.start_rows]

    def cost_to_go(self, state: Tensor) -> Tensor:
        """Fewest steps to the goal; whole numbers if the motion has finitely many states.

        Args:
            state: [N, D], anywhere inside the bounds.

        Returns:
            [N] float32, FAR where there is no path.

        Raises:
            ValueError: for a plan without a goal.
        """
        if self.field is None:
            raise ValueError(f"{NO_GOAL}, got one without")
        return self.field(state)

    def at_goal(self, state: Tensor) -> Tensor:
        """Whether states are at the goal; all false without one: [N, D] -> [N] bool."""
        reached = self.reached(state)
        return torch.zeros(len(state), dtype=torch.bool, device=state.device) if reached is None else reached

    def optimal(self, state: Tensor) -> Tensor:
        """Which actions begin a shortest path.

        Args:
            state: [N, D], anywhere inside the bounds.

        Returns:
            [N, A] bool; no action at the goal, or where no path leads to it.

        Raises:
            ValueError: for a plan without a goal.
        """
        after = torch.stack([self._after(state, action) for action in self.actions], 1)
        best = after.amin(1, keepdim=True)
        return (after <= best + ALIKE) & (best < FAR) & ~self.at_goal(state).unsqueeze(1)

    def _after(self, state: Tensor, action: Tensor) -> Tensor:
        """Steps left after an action: 0 where it reaches the goal, FAR where it is blocked; [N] float32."""
        ahead = self.motion.advance(state, action.expand(len(state), *action.shape))
        start, end = self.motion.body_to_world(state), self.motion.body_to_world(ahead)
        left = torch.full((len(state),), FAR, device=state.device)
        rows = (self.motion.inside(ahead) & ~self.checker.sweeps(start, end)).nonzero().squeeze(1)
        left[rows] = torch.where(self.at_goal(ahead[rows]), 0.0, self.cost_to_go(ahead[rows]))
        return left


def plan(
    motion: PlannedMotion,
    checker: Checker,
    reached: Reached,
    farthest: int | None = None,
    fits: Callable[[Tensor], Tensor] | None = None,
    find_field: Callable[[PlannedMotion, Checker, Reached], Field] = cost_field,
) -> Plan:
    """Find the shortest path from every state to the goal.

    A move counts as open if the swept body touches nothing, according to the checker. With finitely many states the
    paths are exact; for poses anywhere on a plane (``cost_field``) distances are rounded.

    Args:
        motion: lists the states and moves between them.
        checker: tells which poses and moves are free.
        reached: tells which states are at the goal. Where there are no goal states, there are no paths, and every free
            state is a start.
        farthest: longest path of a start, steps; None for any length.
        fits: body_to_world [S, 4, 4] -> [S] bool, where an episode may begin; None takes what the checker finds free.
            It keeps a robot that can pass through things from beginning inside one.
        find_field: finds the costs, or remembers them.

    Raises:
        ValueError: if no pose is free, the goal is not free, or no start reaches it.
    """
    states, actions = motion.states(), motion.actions()
    poses = motion.body_to_world(states)
    free = ~checker.collides(poses)
    at_goal = reached(states)
    field = None if at_goal is None else find_field(motion, checker, reached)
    free = free if fits is None else free & fits(poses)
    if at_goal is None or field is None:
        if not free.any():
            raise ValueError(
                f"scene: expected free poses, got {len(states)} poses in which no robot can begin; {WAYS_OUT}"
            )
        rows = free.nonzero().squeeze(1)
        return Plan(states, free, torch.where(free, 0, UNREACHABLE), actions, motion, checker, rows, reached)
    left = field(states)
    distance = torch.where(free & (left < FAR), left.round().clamp_min(1).long(), UNREACHABLE)
    distance = torch.where(free & at_goal, 0, distance)
    starts = (distance > 0) & (distance <= (distance.max() if farthest is None else farthest))
    if not starts.any():
        raise ValueError(
            f"task.goal: expected a path to it from some free pose, got none from {int(free.sum())}; {WAYS_OUT}"
        )
    return Plan(states, free, distance, actions, motion, checker, starts.nonzero().squeeze(1), reached, field)
