"""Plans shortest paths over the free poses of a motion, and determines where episodes may begin."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from splatrl.collision.base import Checker
from splatrl.curriculum.field import FAR, Field, Moves, NoPath, Reached, cost_field
from splatrl.motions.base import PlannedMotion

UNREACHABLE = -1
ALIKE = 0.1
"""Two actions count as equally good if the steps left after them differ by no more than this."""
NO_GOAL = "task: expected a task with goal states, to which shortest paths can be planned"


@dataclass(frozen=True)
class Plan:
    """The states in which episodes may begin, and the distance of any state from the goal.

    Attributes:
        states: [S, D], all candidate start states.
        free: [S] bool, whether an episode could begin in a state: the body touches nothing, and ``fits`` allows it.
        distance: [S] int64, fewest steps to the goal; 0 at the goal, UNREACHABLE where there is no path. An action that
            is repeated k times takes k steps, or fewer if it ends at the goal. Without a goal, 0 where the body fits.
        actions: [A, ...], the actions from which paths are made.
        moves: where actions lead.
        start_rows: [N] int64, rows of the start set: the free states, other than goal states, from which a goal state
            can be reached within the longest path allowed; without a goal, all free states.
        field: steps to the goal from any state inside the bounds; None without a goal.
        max_steps: steps of the longest episode; None for any length, or if it does not end at the goal.
    """

    states: Tensor
    free: Tensor
    distance: Tensor
    actions: Tensor
    moves: Moves
    start_rows: Tensor
    field: Field | None = None
    max_steps: int | None = None

    @property
    def motion(self) -> PlannedMotion:
        """The motion that leads from state to state."""
        return self.moves.motion

    @property
    def checker(self) -> Checker:
        """Tells which moves are free."""
        return self.moves.checker

    @property
    def cut_off(self) -> Tensor:
        """Which states are free, but have no path to the goal: [S] bool; none of them without a goal."""
        return self.free & (self.distance == UNREACHABLE)

    @property
    def starts(self) -> Tensor:
        """The start set: [N, D] states."""
        return self.states[self.start_rows]

    @property
    def in_reach(self) -> "Plan":
        """The same plan with only the starts from which an episode is long enough to reach the goal, for training."""
        if self.max_steps is None:
            return self
        return replace(self, start_rows=self.start_rows[self.distance[self.start_rows] <= self.max_steps])

    def cost_to_go(self, state: Tensor) -> Tensor:
        """Return the fewest steps to the goal; whole numbers if the motion has finitely many states.

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
        """Return whether states are at the goal, all False without one: [N, D] -> [N] bool."""
        reached = self.moves.reached(state)
        return torch.zeros(len(state), dtype=torch.bool, device=state.device) if reached is None else reached

    def optimal(self, state: Tensor) -> Tensor:
        """Return which actions begin a shortest path.

        Args:
            state: [N, D], anywhere inside the bounds.

        Returns:
            [N, A] bool; all False at the goal, and where no path leads to it.

        Raises:
            ValueError: for a plan without a goal.
        """
        left = torch.stack([self._by_way_of(state, action) for action in self.actions], 1)
        best = left.amin(1, keepdim=True)
        return (left <= best + ALIKE) & (best < FAR) & ~self.at_goal(state).unsqueeze(1)

    def _by_way_of(self, state: Tensor, action: Tensor) -> Tensor:
        """Return the steps to the goal by way of an action, [N] float32; at least FAR where it leads to none."""
        ahead, steps, blocked = self.moves(state, action.expand(len(state), *action.shape))
        left = torch.full((len(state),), FAR, device=state.device)
        rows = (~blocked).nonzero().squeeze(1)
        left[rows] = torch.where(self.at_goal(ahead[rows]), 0.0, self.cost_to_go(ahead[rows])) + steps[rows]
        return left


def plan(
    motion: PlannedMotion,
    checker: Checker,
    reached: Reached,
    farthest: int | None = None,
    fits: Callable[[Tensor], Tensor] | None = None,
    find_field: Callable[[Moves], Field] = cost_field,
    repeats: int = 1,
    max_steps: int | None = None,
) -> Plan:
    """Find the shortest path from every state to the goal.

    A move is open if, according to the checker, the swept body touches nothing. With finitely many states paths are
    exact; for poses anywhere on a plane (see ``cost_field``) distances are rounded to whole steps.

    Args:
        motion: lists the states and moves between them.
        checker: tells which poses and moves are free.
        reached: tells which states are at the goal. If there are no goal states there are no paths, and every free
            state is a start.
        farthest: longest path from a start, steps; None for any length.
        fits: body_to_world [S, 4, 4] -> [S] bool, a further condition on where an episode may begin; None sets none
            beyond the checker's. It keeps a robot that can pass through things from starting inside one.
        find_field: computes the cost field, or retrieves it from a cache.
        repeats: number of times that a robot carries out each action; see ``Moves``.
        max_steps: see ``Plan``; it leaves the plan's starts as they are.

    Raises:
        NoPath: if no pose is free, the goal is not free, or no start reaches it.
    """
    states, actions, moves = motion.states(), motion.actions(), Moves(motion, checker, reached, repeats)
    poses = motion.body_to_world(states)
    free = ~checker.collides(poses)
    at_goal = reached(states)
    field = None if at_goal is None else find_field(moves)
    free = free if fits is None else free & fits(poses)
    if at_goal is None or field is None:
        if not free.any():
            raise NoPath(f"scene: expected free poses, got {len(states)} poses in which no robot can start")
        rows = free.nonzero().squeeze(1)
        return Plan(states, free, torch.where(free, 0, UNREACHABLE), actions, moves, rows)
    left = field(states)
    distance = torch.where(free & (left < FAR), left.round().clamp_min(1).long(), UNREACHABLE)
    distance = torch.where(free & at_goal, 0, distance)
    starts = (distance > 0) & (distance <= (distance.max() if farthest is None else farthest))
    if not starts.any():
        raise NoPath(
            f"task: expected a path to the goal from at least one free pose, found none from {int(free.sum())}"
        )
    return Plan(states, free, distance, actions, moves, starts.nonzero().squeeze(1), field, max_steps)
