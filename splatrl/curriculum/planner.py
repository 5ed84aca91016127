"""Shortest paths over the free poses of a finite motion."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor
from torchrl.data import TensorSpec

from splatrl.collision.base import Checker

UNREACHABLE = -1


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
    """Every state of a finite motion, what each action does there, and how far the goal is.

    Attributes:
        states: [S, D] int64, all states.
        free: [S] bool, where the body touches nothing.
        successors: [S, A] int64, row of the state that an action leads to; UNREACHABLE where the move is blocked.
        distance: [S] int64, fewest steps to a free goal state; 0 at one, UNREACHABLE where there is no way.
    """

    states: Tensor
    free: Tensor
    successors: Tensor
    distance: Tensor

    @property
    def start_rows(self) -> Tensor:
        """Rows of the start set: free states from which a goal state can be reached, goal states left out."""
        return (self.distance > 0).nonzero().squeeze(1)


def plan(motion: FiniteMotion, checker: Checker, reached: Callable[[Tensor], Tensor]) -> Plan:
    """Find the shortest path from every state to the goal.

    A move counts as open when the swept body touches nothing, by the same checker that moves the robots.

    Args:
        motion: lists the states and moves between them.
        checker: tells which poses and moves are free.
        reached: [S, D] states -> [S] bool, whether a state is at the goal.

    Raises:
        ValueError: when no pose is free, the goal is not free, or no start reaches it.
    """
    states = motion.states()
    free = ~checker.collides(motion.body_to_world(states))
    goals = free & reached(states)
    if not free.any():
        raise ValueError(f"scene: expected free poses, got {len(states)} poses that all collide")
    if not goals.any():
        raise ValueError(f"task.goal: expected a free pose at the goal, got {int(reached(states).sum())} that collide")
    successors = _successors(motion, checker, states, free)
    distance = _distances(successors, goals)
    if not (distance > 0).any():
        raise ValueError(f"task.goal: expected a way to it from some free pose, got none from {int(free.sum())}")
    return Plan(states, free, successors, distance)


def _successors(motion: FiniteMotion, checker: Checker, states: Tensor, free: Tensor) -> Tensor:
    actions = motion.action_spec.enumerate()
    successors = states.new_full((len(states), len(actions)), UNREACHABLE)
    for column, action in enumerate(actions):
        ahead = motion.advance(states, action.expand(len(states)))
        rows = (free & motion.inside(ahead)).nonzero().squeeze(1)
        rows = rows[free[motion.index(ahead[rows])]]
        start, end = motion.body_to_world(states[rows]), motion.body_to_world(ahead[rows])
        rows = rows[~checker.sweeps(start, end)]
        successors[rows, column] = motion.index(ahead[rows])
    return successors


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
