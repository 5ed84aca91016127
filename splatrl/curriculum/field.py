"""How far the goal is from poses anywhere on a plane: value iteration on a grid of positions and headings."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Protocol, runtime_checkable

import torch
from torch import Tensor

from splatrl.collision.base import Checker

FAR = 1e6
"""Steps to the goal from where there is no way to it."""
SETTLED = 1e-3
"""Steps: the field is done when no node changes by more in an iteration."""


@runtime_checkable
class PlanarMotion(Protocol):
    """A motion whose states are poses anywhere on a plane, [3] float32: x and y in metres and yaw in radians."""

    cell: float
    angle_cell: float
    lower: Tensor
    upper: Tensor

    def states(self) -> Tensor:
        """The states in which episodes may begin: [S, 3]."""
        ...

    def actions(self) -> Tensor:
        """The actions that paths are made of: [A, ...]."""
        ...

    def advance(self, state: Tensor, action: Tensor) -> Tensor: ...

    def inside(self, state: Tensor) -> Tensor: ...

    def body_to_world(self, state: Tensor) -> Tensor: ...


class Taps(NamedTuple):
    """The nodes around poses.

    Attributes:
        node: [N, 8] int64.
        weight: [N, 8] float32, trilinear, summing to 1.
    """

    node: Tensor
    weight: Tensor


@dataclass(frozen=True)
class Grid:
    """Nodes at positions ``cell`` apart and headings ``angle_cell`` apart.

    Attributes:
        lower: [2] position of the first node, metres.
        shape: number of columns (x), rows (y) and headings.
        cell: metres.
        angle_cell: radians.
    """

    lower: Tensor
    shape: tuple[int, int, int]
    cell: float
    angle_cell: float

    @classmethod
    def of(cls, motion: PlanarMotion) -> "Grid":
        """The grid over a motion's bounds."""
        columns, rows = (((motion.upper - motion.lower) / motion.cell).round().long() + 1).tolist()
        headings = round(2 * torch.pi / motion.angle_cell)
        return cls(motion.lower, (columns, rows, headings), motion.cell, 2 * torch.pi / headings)

    def nodes(self) -> Tensor:
        """The pose of each node: [C, 3] float32."""
        axes = torch.cartesian_prod(*(torch.arange(count, device=self.lower.device) for count in self.shape))
        return torch.cat([self.lower + self.cell * axes[:, :2], self.angle_cell * axes[:, 2:]], 1)

    def taps(self, state: Tensor) -> Taps:
        """The eight nodes around poses: [N, 3] -> taps; beyond the grid those of its edge."""
        x, y = ((state[:, :2] - self.lower) / self.cell).unbind(1)
        heading = state[:, 2] / self.angle_cell
        node = state.new_zeros(len(state), 1, dtype=torch.int64)
        weight = state.new_ones(len(state), 1)
        for place, count, wraps in zip((x, y, heading), self.shape, (False, False, True), strict=True):
            place = (place * 1024).round() / 1024  # what rounding moved off a node is on it
            low = place.floor()
            pair = torch.stack([low, low + 1], 1).long()
            pair = pair % count if wraps else pair.clamp(0, count - 1)
            share = torch.stack([1 - (place - low), place - low], 1)
            node = (node.unsqueeze(2) * count + pair.unsqueeze(1)).flatten(1)
            weight = (weight.unsqueeze(2) * share.unsqueeze(1)).flatten(1)
        return Taps(node, weight)


@dataclass(frozen=True)
class Field:
    """Steps to the goal, at nodes and in between.

    Attributes:
        grid: the nodes.
        steps: [C] float32 from each node; FAR where there is no way or the body does not fit.
    """

    grid: Grid
    steps: Tensor

    def __call__(self, state: Tensor) -> Tensor:
        """Steps to the goal from poses, interpolated among the nodes from which there is a way: [N, 3] -> [N]."""
        return _mean(self.steps, _among(self.grid.taps(state), self.steps < FAR))


def _among(taps: Taps, allowed: Tensor) -> Taps:
    """Taps whose weight is all on allowed nodes; without one among them, unchanged."""
    weight = taps.weight * allowed[taps.node]
    total = weight.sum(1, keepdim=True)
    return Taps(taps.node, torch.where(total > 1e-3, weight / total, taps.weight))


def _mean(steps: Tensor, taps: Taps) -> Tensor:
    return (steps[taps.node] * taps.weight).sum(1)


def _slim(taps: Taps) -> Taps:
    """Taps without columns in which no pose has weight: a turn on the spot needs one, a step four."""
    used = (taps.weight > 0).any(0)
    return Taps(taps.node[:, used], taps.weight[:, used])


def steps_field(motion: PlanarMotion, checker: Checker, reached: Callable[[Tensor], Tensor]) -> Field:
    """Steps to the goal from every pose, by value iteration: a pose is one step farther than the best it leads to.

    Between nodes the steps are interpolated among the free ones (semi-Lagrangian), so the field is smooth, paths that
    follow it downhill do not circle, and it can tell which of two actions is better by less than a step.

    Args:
        motion: the actions, and where they lead.
        checker: tells which poses and moves are free.
        reached: [N, 3] states -> [N] bool, whether a state is at the goal.

    Raises:
        ValueError: when no pose is free, or none at the goal.
    """
    grid = Grid.of(motion)
    nodes = grid.nodes()
    free = motion.inside(nodes) & ~checker.collides(motion.body_to_world(nodes))
    at_goal = reached(nodes)
    if not free.any():
        raise ValueError(f"scene: expected free poses, got {len(nodes)} poses that all collide")
    if not (goals := free & at_goal).any():
        raise ValueError(f"task.goal: expected a free pose at the goal, got {int(at_goal.sum())} that collide")
    rows = (free & ~goals).nonzero().squeeze(1)
    taps = [_open(motion, checker, grid, nodes[rows], action) for action in motion.actions()]
    steps = _settle(torch.where(goals, 0.0, FAR), rows, [_slim(_among(tap, free)) for tap in taps])
    joined = steps < 0.5 * FAR  # a free node from which there is no way must not count among its neighbours either
    if not torch.equal(joined, free):
        taps = [Taps(tap.node[joined[rows]], tap.weight[joined[rows]]) for tap in taps]
        rows = rows[joined[rows]]
        steps = _settle(torch.where(goals, 0.0, FAR), rows, [_slim(_among(tap, joined)) for tap in taps])
    return Field(grid, steps)


def _settle(steps: Tensor, rows: Tensor, taps: list[Taps]) -> Tensor:
    """Set each row to one more than the best of its taps, until nothing changes."""
    while True:
        best = torch.stack([_mean(steps, tap) for tap in taps]).amin(0).add(1).clamp_max(FAR)
        settled = bool(((steps[rows] - best).abs() <= SETTLED).all())
        steps = steps.index_put((rows,), best)
        if settled:
            return steps


def _open(motion: PlanarMotion, checker: Checker, grid: Grid, state: Tensor, action: Tensor) -> Taps:
    """Where an action leads from states; blocked moves lead to themselves, which helps nobody."""
    ahead = motion.advance(state, action.expand(len(state), *action.shape))
    blocked = ~motion.inside(ahead) | checker.sweeps(motion.body_to_world(state), motion.body_to_world(ahead))
    return grid.taps(torch.where(blocked.unsqueeze(1), state, ahead))
