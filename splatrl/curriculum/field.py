"""Cost-to-go of every state: the number of steps to the goal, by value iteration over the nodes of a motion."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from splatrl.collision.base import Checker
from splatrl.motions.base import PlannedMotion, Taps
from splatrl.waits import late_bar

FAR = 1e6
"""Cost-to-go of states without a path to the goal."""
LEAST_AWAY = 1e-3
"""Least weight that an action gives to other nodes than its own; less may be rounding."""
Reached = Callable[[Tensor], Tensor | None]
"""Function that returns whether states [N, ...] are at a goal, [N] bool, or None if there are no goal states."""
SETTLED = 1e-3
"""Value iteration stops when no node's cost changes by more than this many steps."""


class Reach(NamedTuple):
    """Where N actions have led.

    Attributes:
        state: [N, ...], the states.
        steps: [N] float32, number of steps taken.
        blocked: [N] bool, whether the last of them was blocked.
    """

    state: Tensor
    steps: Tensor
    blocked: Tensor


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

    def __call__(self, state: Tensor, action: Tensor) -> Reach:
        """Return where actions lead: states [N, ...], actions [N, ...]."""
        *_, last = self.each(state, action)
        return last

    def each(self, state: Tensor, action: Tensor) -> Iterator[Reach]:
        """Yield where actions have led after one step, after two, and so on; where an action ends, it stays.

        Args:
            state: [N, ...].
            action: [N, ...].
        """
        ahead, blocked = self._once(state, action)
        steps = torch.ones(len(state), device=state.device)
        yield Reach(ahead, steps, blocked)
        for _ in range(self.repeats - 1):
            rows = (~blocked).nonzero().squeeze(1)
            at_goal = self.reached(ahead[rows])
            rows = rows if at_goal is None else rows[~at_goal]
            ahead, steps, blocked = ahead.clone(), steps.clone(), blocked.clone()
            ahead[rows], blocked[rows] = self._once(ahead[rows], action[rows])
            steps[rows] += 1
            yield Reach(ahead, steps, blocked)

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


def _onward(rows: Tensor, taps: Taps, steps: Tensor) -> tuple[Taps, Tensor]:
    """Repeat actions that stay near their own node until they have left it, so that few sweeps settle their costs.

    If a node has the weight w in where an action leads from it, then c = s + w c + (1 − w) c′ has the same solution as
    c = s / (1 − w) + c′. An action that leads away by ``LEAST_AWAY`` or less costs
    ``FAR``.

    Args:
        rows: [N] int64, the nodes from which the action leads.
        taps: where it leads.
        steps: [N] its steps.
    """
    away = taps.weight * (taps.node != rows[:, None])
    rest = away.sum(1)
    left = rest > LEAST_AWAY
    weight = torch.where(left[:, None], away / rest[:, None], 0.0)
    used = (weight > 0).any(0)  # a turn on the spot needs one or two columns, a step four
    return Taps(taps.node[:, used], weight[:, used]), torch.where(left, steps / rest, FAR)


def cost_field(moves: Moves) -> Field:
    """Compute the steps to the goal from every state by value iteration.

    The cost of a state is that of its best successor plus the steps of the action that leads there. Where every action
    leads from node to node, as with finitely many states, the field is exact and equals a breadth-first search.
    Otherwise costs are interpolated among the free nodes (a semi-Lagrangian scheme), so the field is smooth, paths that
    descend it seldom circle, and it resolves differences between actions of less than a step.

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
    ways = [_open(moves, nodes[rows], action) for action in motion.actions()]
    costs = _settle(torch.where(goals, 0.0, FAR), rows, ways, free)
    joined = costs < 0.5 * FAR  # nor may free nodes without a path contribute to interpolation
    if not torch.equal(joined, free):
        kept = joined[rows]
        ways = [(Taps(taps.node[kept], taps.weight[kept]), steps[kept]) for taps, steps in ways]
        costs = _settle(torch.where(joined, costs, FAR), rows[kept], ways, joined)
    return Field(motion, costs)


def _settle(costs: Tensor, rows: Tensor, ways: list[tuple[Taps, Tensor]], allowed: Tensor) -> Tensor:
    """Set the cost of each row to that of its best successor plus the steps to it, until nothing changes.

    Args:
        costs: [C] float32, costs of all nodes at first.
        rows: [N] int64, the nodes whose costs are to be found.
        ways: for each action, the taps of where it leads from each row, and its steps [N].
        allowed: [C] bool, the nodes among which costs are interpolated.
    """
    slim = [_onward(rows, _among(taps, allowed), steps) for taps, steps in ways]
    with late_bar("shortest paths", None, "sweep") as bar:
        while True:
            best = torch.stack([_mean(costs, taps) + steps for taps, steps in slim]).amin(0).clamp_max(FAR)
            settled = bool(((costs[rows] - best).abs() <= SETTLED).all())
            costs = costs.index_put((rows,), best)
            if settled:
                return costs
            bar.update()


def _open(moves: Moves, state: Tensor, action: Tensor) -> tuple[Taps, Tensor]:
    """Return where an action leads from states, and its steps; a blocked move leads back, so it shortens no path."""
    ahead, steps, blocked = moves(state, action.expand(len(state), *action.shape))
    back = blocked.view(-1, *[1] * (state.ndim - 1))
    return moves.motion.taps(torch.where(back, state, ahead)), steps
