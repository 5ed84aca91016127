"""Cost-to-go of every state: the number of steps to the goal, by value iteration over the nodes of a motion."""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor
from tqdm import tqdm

from splatrl.collision.base import Checker
from splatrl.motions.base import PlannedMotion, Taps

FAR = 1e6
"""Cost-to-go of states without a path to the goal."""
Reached = Callable[[Tensor], Tensor | None]
"""Function that returns whether states [N, ...] are at a goal, [N] bool, or None if there are no goal states."""
SETTLED = 1e-3
"""Value iteration stops when no node's cost changes by more than this many steps."""
PATIENCE = 2.0
"""Seconds after which value iteration shows its progress."""


@dataclass(frozen=True)
class Moves:
    """Where actions lead robots, and which actions are blocked.

    Attributes:
        motion: carries out actions.
        checker: tells which poses and moves are free.
        reached: tells which states are at a goal.
        repeats: number of times that an action is carried out; it ends at a goal, and where it is blocked.
    """

    motion: PlannedMotion
    checker: Checker
    reached: Reached
    repeats: int = 1

    def __call__(self, state: Tensor, action: Tensor) -> tuple[Tensor, Tensor]:
        """Return where actions lead, and whether they are blocked: [N, ...], [N, ...] -> [N, ...], [N] bool."""
        ahead, blocked = self._once(state, action)
        for _ in range(self.repeats - 1):
            rows = (~blocked).nonzero().squeeze(1)
            at_goal = self.reached(ahead[rows])
            rows = rows if at_goal is None else rows[~at_goal]
            ahead[rows], blocked[rows] = self._once(ahead[rows], action[rows])
        return ahead, blocked

    def _once(self, state: Tensor, action: Tensor) -> tuple[Tensor, Tensor]:
        ahead = self.motion.advance(state, action)
        start, end = self.motion.body_to_world(state), self.motion.body_to_world(ahead)
        return ahead, ~self.motion.inside(ahead) | self.checker.sweeps(start, end)


class NoPath(ValueError):
    """No pose is free, or no path leads to the goal. ``Task.ways_out`` tells what to change."""


@dataclass(frozen=True)
class Field:
    """Steps to the goal at the nodes of a motion, interpolated between them.

    Attributes:
        motion: the motion that defines the nodes.
        cost_to_go: [C] float32, steps from each node; FAR where there is no path or the body does not fit.
    """

    motion: PlannedMotion
    cost_to_go: Tensor

    def __call__(self, state: Tensor) -> Tensor:
        """Return the steps to the goal from states, interpolated among nodes that have a path: [N, ...] -> [N]."""
        return _mean(self.cost_to_go, _among(self.motion.taps(state), self.cost_to_go < FAR))


def _among(taps: Taps, allowed: Tensor) -> Taps:
    """Move all weight of taps onto allowed nodes; taps without an allowed node are unchanged."""
    weight = taps.weight * allowed[taps.node]
    total = weight.sum(1, keepdim=True)
    return Taps(taps.node, torch.where(total > 1e-3, weight / total, taps.weight))


def _mean(values: Tensor, taps: Taps) -> Tensor:
    return (values[taps.node] * taps.weight).sum(1)


def _slim(taps: Taps) -> Taps:
    """Drop the columns of taps in which no state has weight: a turn on the spot needs one column, a step four."""
    used = (taps.weight > 0).any(0)
    return Taps(taps.node[:, used], taps.weight[:, used])


def cost_field(moves: Moves) -> Field:
    """Compute the steps to the goal from every state by value iteration; a repeated action counts as one step.

    The cost of a state is one step more than that of its best successor. Where every action leads from node to node, as
    with finitely many states, the field is exact and equals a breadth-first search. Otherwise costs are interpolated
    among the free nodes (a semi-Lagrangian scheme), so the field is smooth, paths that descend it do not circle, and it
    resolves differences between actions of less than a step.

    Args:
        moves: where the actions lead.

    Raises:
        NoPath: if no pose is free, or none at the goal.
    """
    motion = moves.motion
    nodes = motion.nodes()
    free = motion.inside(nodes) & ~moves.checker.collides(motion.body_to_world(nodes))
    at_goal = moves.reached(nodes)
    assert at_goal is not None, "there are no paths without goal states"
    if not free.any():
        raise NoPath(f"scene: expected free poses, got {len(nodes)} poses that all collide")
    if not (goals := free & at_goal).any():
        raise NoPath(f"task: expected a free pose at the goal, found none among {int(at_goal.sum())} poses there")
    rows = (free & ~goals).nonzero().squeeze(1)
    taps = [_open(moves, nodes[rows], action) for action in motion.actions()]
    costs = _settle(torch.where(goals, 0.0, FAR), rows, [_slim(_among(tap, free)) for tap in taps])
    joined = costs < 0.5 * FAR  # nor may free nodes without a path contribute to interpolation
    if not torch.equal(joined, free):
        taps = [Taps(tap.node[joined[rows]], tap.weight[joined[rows]]) for tap in taps]
        rows = rows[joined[rows]]
        costs = _settle(torch.where(joined, costs, FAR), rows, [_slim(_among(tap, joined)) for tap in taps])
    return Field(motion, costs)


def _settle(costs: Tensor, rows: Tensor, taps: list[Taps]) -> Tensor:
    """Set the cost of each row to one more than that of its best successor, until nothing changes."""
    with tqdm(desc="shortest paths", unit="sweep", delay=PATIENCE, leave=False, dynamic_ncols=True) as bar:
        while True:
            best = torch.stack([_mean(costs, tap) for tap in taps]).amin(0).add(1).clamp_max(FAR)
            settled = bool(((costs[rows] - best).abs() <= SETTLED).all())
            costs = costs.index_put((rows,), best)
            if settled:
                return costs
            bar.update()


def _open(moves: Moves, state: Tensor, action: Tensor) -> Taps:
    """Return where an action leads from states; a blocked move leads back to its own state, so it shortens no path."""
    ahead, blocked = moves(state, action.expand(len(state), *action.shape))
    return moves.motion.taps(torch.where(blocked.view(-1, *[1] * (state.ndim - 1)), state, ahead))
