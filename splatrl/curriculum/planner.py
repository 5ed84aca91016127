"""Shortest paths over the free poses of a motion: exact where its states can be listed, a field where they cannot."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import torch
from torch import Tensor
from torchrl.data import TensorSpec

from splatrl.collision.base import Checker
from splatrl.curriculum.field import FAR, PlanarMotion, steps_field

UNREACHABLE = -1
ALIKE = 0.1
"""Steps: two actions are equally good where what is left after them differs by no more."""


class FiniteMotion(Protocol):
    """A motion whose states can be listed; ``index`` is the inverse of ``states``."""

    @property
    def action_spec(self) -> TensorSpec: ...

    def states(self) -> Tensor: ...

    def index(self, state: Tensor) -> Tensor: ...

    def advance(self, state: Tensor, action: Tensor) -> Tensor: ...

    def inside(self, state: Tensor) -> Tensor: ...

    def body_to_world(self, state: Tensor) -> Tensor: ...


@dataclass(frozen=True)
class Plan:
    """The states in which episodes may begin, and how far the goal is from any state.

    Attributes:
        states: [S, D], all states from which one could start.
        free: [S] bool, where an episode could begin: the body touches nothing.
        distance: [S] int64, fewest steps to the goal; 0 at it, UNREACHABLE where there is no way.
        actions: [A, ...], the actions that paths are made of.
        motion: moves between the states.
        checker: tells which moves are free.
        steps_to_go: fewest steps to the goal from any states inside the bounds, [N, D] -> [N] float32, FAR where there
            is no way. Whole numbers for a finite motion.
        reached: whether states are at the goal, [N, D] -> [N] bool.
        farthest: longest path of a start, steps; None for any.
    """

    states: Tensor
    free: Tensor
    distance: Tensor
    actions: Tensor
    motion: FiniteMotion | PlanarMotion
    checker: Checker
    steps_to_go: Callable[[Tensor], Tensor]
    reached: Callable[[Tensor], Tensor]
    farthest: int | None = None

    @property
    def start_rows(self) -> Tensor:
        """Rows of the start set: free states from which a goal state can be reached, goal states left out."""
        near_enough = self.distance <= (self.distance.max() if self.farthest is None else self.farthest)
        return ((self.distance > 0) & near_enough).nonzero().squeeze(1)

    def optimal(self, state: Tensor) -> Tensor:
        """Which actions begin a shortest path.

        Args:
            state: [N, D], anywhere inside the bounds.

        Returns:
            [N, A] bool; no action at the goal, or where no free move leads to it.
        """
        after = torch.stack([self._after(state, action) for action in self.actions], 1)
        best = after.amin(1, keepdim=True)
        return (after <= best + ALIKE) & (best < FAR) & ~self.reached(state).unsqueeze(1)

    def _after(self, state: Tensor, action: Tensor) -> Tensor:
        """Steps that are left after an action, 0 where it reaches the goal, FAR where it is blocked: [N] float32."""
        ahead = self.motion.advance(state, action.expand(len(state), *action.shape))
        start, end = self.motion.body_to_world(state), self.motion.body_to_world(ahead)
        left = torch.full((len(state),), FAR, device=state.device)
        rows = (self.motion.inside(ahead) & ~self.checker.sweeps(start, end)).nonzero().squeeze(1)
        steps = self.steps_to_go(ahead[rows])
        left[rows] = torch.where(self.reached(ahead[rows]), 0.0, steps)
        return left


def plan(
    motion: FiniteMotion | PlanarMotion,
    checker: Checker,
    reached: Callable[[Tensor], Tensor],
    farthest: int | None = None,
    fits: Callable[[Tensor], Tensor] | None = None,
) -> Plan:
    """Find the shortest path from every state to the goal.

    A move counts as open when the swept body touches nothing, by the same checker that moves the robots. For a finite
    motion the paths are exact. For poses anywhere on a plane see ``steps_field``; its distances are rounded.

    Args:
        motion: lists the states and moves between them.
        checker: tells which poses and moves are free.
        reached: [S, D] states -> [S] bool, whether a state is at the goal.
        farthest: longest path of a start, steps; None for any.
        fits: body_to_world [S, 4, 4] -> [S] bool, where an episode may begin; None takes what the checker finds free. A
            robot that can go through things should not begin inside one.

    Raises:
        ValueError: when no pose is free, the goal is not free, or no start reaches it.
    """
    states = motion.states()
    free = ~checker.collides(motion.body_to_world(states))
    if isinstance(motion, PlanarMotion):
        actions, field = motion.actions(), steps_field(motion, checker, reached)
        left = field(states)
        distance = torch.where(free & (left < FAR), left.round().clamp_min(1).long(), UNREACHABLE)
        distance = torch.where(free & reached(states), 0, distance)
        found = Plan(states, free, distance, actions, motion, checker, field, reached)
    else:
        found = _exact(motion, checker, reached, states, free)
    if fits is not None:
        free = free & fits(motion.body_to_world(states))
    distance = torch.where(free, found.distance, UNREACHABLE)
    found = replace(found, free=free, distance=distance, farthest=farthest)
    if not len(found.start_rows):
        raise ValueError(f"task.goal: expected a way to it from some free pose, got none from {int(free.sum())}")
    return found


def _exact(
    motion: FiniteMotion, checker: Checker, reached: Callable[[Tensor], Tensor], states: Tensor, free: Tensor
) -> Plan:
    goals = free & reached(states)
    if not free.any():
        raise ValueError(f"scene: expected free poses, got {len(states)} poses that all collide")
    if not goals.any():
        raise ValueError(f"task.goal: expected a free pose at the goal, got {int(reached(states).sum())} that collide")
    actions = motion.action_spec.enumerate()
    distance = _distances(successors(motion, checker, states, free), goals)

    def steps_to_go(state: Tensor) -> Tensor:
        steps = distance[motion.index(state)]
        return torch.where(steps == UNREACHABLE, FAR, steps.float())

    return Plan(states, free, distance, actions, motion, checker, steps_to_go, reached)


def successors(motion: FiniteMotion, checker: Checker, states: Tensor, free: Tensor) -> Tensor:
    """Row of the state that each action leads to.

    Args:
        motion: moves between the states.
        checker: tells which moves are free.
        states: [S, D], all of the motion's.
        free: [S] bool, where the body touches nothing.

    Returns:
        [S, A] int64, UNREACHABLE where the move is blocked.
    """
    actions = motion.action_spec.enumerate()
    rows_after = torch.full((len(states), len(actions)), UNREACHABLE, device=states.device)
    for column, action in enumerate(actions):
        ahead = motion.advance(states, action.expand(len(states)))
        rows = (free & motion.inside(ahead)).nonzero().squeeze(1)
        rows = rows[free[motion.index(ahead[rows])]]
        start, end = motion.body_to_world(states[rows]), motion.body_to_world(ahead[rows])
        rows = rows[~checker.sweeps(start, end)]
        rows_after[rows, column] = motion.index(ahead[rows])
    return rows_after


def _distances(successors: Tensor, goals: Tensor) -> Tensor:
    """Breadth-first search from all goals at once, a whole frontier a step."""
    distance = torch.where(goals, 0, UNREACHABLE)
    open_moves = successors != UNREACHABLE
    steps = 0
    frontier = goals
    while frontier.any():
        steps += 1
        leads = (frontier[successors.clamp_min(0)] & open_moves).any(1)
        frontier = leads & (distance == UNREACHABLE)
        distance[frontier] = steps
    return distance
