"""Distances of motions that leave the lattice, against arithmetic and against a search without a grid."""

import math
from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor

from splatrl.bodies import Box
from splatrl.collision import Checker, NoChecker
from splatrl.curriculum import UNREACHABLE, Plan, plan
from splatrl.curriculum.field import FAR, Moves, _settle, cost_field
from splatrl.envs.tasks import Drive, Fps
from splatrl.motions import DriveMotion, ForwardMotion, PlannedMotion
from splatrl.motions.base import Taps
from tests.envs.rooms import BOUNDS, coarse_drive, drive_plan
from tests.tiny import HEIGHT, BlockChecker

SQUARE: dict[str, Any] = {"lower": (-0.75, -0.75), "upper": (0.75, 0.75)}


class Fence(BlockChecker):
    """Blocks every crossing of the line x = 0.3, though every pose is free."""

    def collides(self, body_to_world: Tensor) -> Tensor:
        return torch.zeros(len(body_to_world), dtype=torch.bool)

    def free_fraction(self, start: Tensor, end: Tensor) -> Tensor:
        return torch.where((start[:, 0, 3] < 0.3) != (end[:, 0, 3] < 0.3), 0.5, 1.0)


def empty() -> NoChecker:
    return NoChecker(None, Box((0.1, 0.1, 0.1)))


def fewest_steps(
    motion: ForwardMotion, checker: Checker, reached: Callable[[Tensor], Tensor], start: Tensor, limit: int = 20
) -> int:
    """Count the steps to the goal from one start, by breadth-first search, a whole frontier of poses at a time."""
    frontier, known, steps = start[None], start.new_zeros(0, dtype=torch.int64), 0
    while len(frontier) and not reached(frontier).any():
        assert steps < limit
        begin, action = frontier.repeat_interleave(4, 0), torch.arange(4).repeat(len(frontier))
        ahead = motion.advance(begin, action)
        moved = motion.inside(ahead) & ~checker.sweeps(motion.body_to_world(begin), motion.body_to_world(ahead))
        frontier, known = _new(ahead[moved], motion, known)
        steps += 1
    return steps if len(frontier) else UNREACHABLE


def _new(states: Tensor, motion: ForwardMotion, known: Tensor) -> tuple[Tensor, Tensor]:
    """Return the distinct states (to a millimetre) that are new, and the keys of all states known afterwards."""
    x, y = ((states[:, :2] + 2) * 1000).round().long().unbind(1)
    heading = (states[:, 2] / motion.angle_step).round().long() % motion.headings
    key, row = ((x * 4096 + y) * 64 + heading).unique(return_inverse=True)
    first = torch.full((len(key),), len(states)).scatter_reduce(0, row, torch.arange(len(states)), "amin")
    fresh = ~torch.isin(key, known)
    return states[first[fresh]], torch.cat([known, key[fresh]])


def distance_from(found: Plan, x: float, y: float, yaw: float) -> int:
    """Return the planned distance from one start."""
    offset = (found.states - torch.tensor([x, y, yaw])).abs().sum(1)
    assert offset.min() < 1e-4
    return int(found.distance[offset.argmin()])


@pytest.mark.parametrize(("step", "side"), [(0.25, 0.75), (0.1, 0.7)])
def test_straight_ahead_in_an_empty_room_takes_the_distance_divided_by_the_step(step: float, side: float) -> None:
    motion = ForwardMotion(HEIGHT, step, 45.0, (-side, -side), (side, side))
    found = plan(motion, empty(), Fps(motion, (side, 0.0, 0.0)).reached)
    count = round(2 * side / step)
    for steps in range(2, count + 1):
        assert distance_from(found, side - steps * step, 0.0, 0.0) == steps - 1  # the goal is one step wide
    assert distance_from(found, -side, 0.0, math.pi / 4) == count  # one turn, then straight on


def test_straight_ahead_a_drive_takes_the_distance_divided_by_its_speed() -> None:
    motion = DriveMotion(HEIGHT, angular_deg=225.0, spacing=0.25, headings=4, **SQUARE)  # 0.1 m and 45° per time step
    found = plan(motion, empty(), Drive(motion, (0.75, 0.0, 0.0)).reached)
    assert distance_from(found, -0.75, 0.0, 0.0) == 14 and distance_from(found, 0.25, 0.0, 0.0) == 4


def test_turning_on_the_spot_takes_the_shorter_way_round() -> None:
    motion = ForwardMotion(HEIGHT, 0.25, 30.0, **SQUARE)
    found = plan(motion, empty(), Fps(motion, (0.0, 0.0, 90.0)).reached)
    turns = [distance_from(found, 0.0, 0.0, math.radians(30.0 * turn)) for turn in range(12)]
    assert turns == [2, 1, 0, 0, 0, 1, 2, 3, 4, 5, 4, 3]


def test_on_a_lattice_the_field_equals_a_breadth_first_search() -> None:
    """Quarter turns lead from node to node, so nothing is interpolated."""
    motion = ForwardMotion(HEIGHT, 0.25, 90.0, **BOUNDS)
    task, checker = Fps(motion, (0.5, 1.0, 0.0)), BlockChecker()
    found = plan(motion, checker, task.reached)
    rows = found.start_rows[torch.randperm(len(found.start_rows), generator=torch.Generator().manual_seed(0))[:60]]
    expected = [fewest_steps(motion, checker, task.reached, found.states[row]) for row in rows]
    assert found.distance[rows].tolist() == expected and max(expected) >= 10


def test_off_the_lattice_distances_are_close_to_those_of_a_search() -> None:
    motion = ForwardMotion(HEIGHT, 0.25, 45.0, **SQUARE)
    task, checker = Fps(motion, (0.5, 0.5, 0.0)), BlockChecker(reach=0.3)
    found = plan(motion, checker, task.reached)
    rows = found.start_rows[torch.randperm(len(found.start_rows), generator=torch.Generator().manual_seed(1))[:40]]
    expected = torch.tensor([fewest_steps(motion, checker, task.reached, found.states[row]) for row in rows])
    off = found.cost_to_go(found.states[rows]) - expected
    assert off.abs().mean() < 0.35 and off.abs().max() < 1.6 and expected.max() >= 8  # measured: 0.20 and 1.27


def followed(found: Plan, limit: int) -> Tensor:
    """Count the steps to the goal from every start by always taking the best action: [N] float32, infinite if never."""
    state = found.states[found.start_rows]
    steps = torch.full((len(state),), torch.inf)
    for count in range(limit + 1):
        there = found.at_goal(state)
        steps = torch.where(there & steps.isinf(), float(count), steps)
        best = found.optimal(state)
        assert torch.equal(best.any(1), ~there), "there is a best action everywhere but at the goal"
        ahead = found.motion.advance(state, found.actions[best.int().argmax(1)])
        start, end = found.motion.body_to_world(state), found.motion.body_to_world(ahead)
        assert not found.checker.sweeps(start, end)[~there].any() and found.motion.inside(ahead)[~there].all()
        state = torch.where(there[:, None], state, ahead)
    return steps


@pytest.mark.parametrize(
    ("turn_deg", "arrive", "late"),
    [(90.0, 1.0, 0), (60.0, 1.0, 3), (45.0, 1.0, 2), (30.0, 0.99, 3)],  # a few go back and forth beside the block
)
def test_following_the_best_action_leads_to_the_goal(turn_deg: float, arrive: float, late: int) -> None:
    motion = ForwardMotion(HEIGHT, 0.25, turn_deg, **BOUNDS)
    found = plan(motion, BlockChecker(), Fps(motion, (0.5, 1.0, 0.0)).reached)
    taken = followed(found, 30)
    there = taken.isfinite()
    assert there.float().mean() >= arrive
    assert (taken - found.distance[found.start_rows])[there].max() <= late


def test_a_drive_that_follows_the_best_action_reaches_the_goal() -> None:
    found = drive_plan()
    taken = followed(found, 30)
    assert taken.isfinite().all() and (taken - found.distance[found.start_rows]).max() <= 1


def test_no_action_is_best_at_the_goal_and_a_blocked_one_is_never_best() -> None:
    found = drive_plan()
    goals = found.states[found.distance == 0]
    assert len(goals) and not found.optimal(goals).any()
    motion = ForwardMotion(HEIGHT, 0.25, 90.0, **BOUNDS)
    around = plan(motion, BlockChecker(), Fps(motion, (0.75, 0.0, 0.0)).reached)
    facing_the_block, at_the_edge = [-0.5, 0.0, 0.0], [0.25, 1.5, math.pi / 2]
    best = around.optimal(torch.tensor([facing_the_block, at_the_edge, [0.0, 1.0, 0.0]]))
    assert best.any(1).all()
    assert best[:2, 0].tolist() == [False, False] and best[2].tolist() == [True, False, False, False]
    assert best[0].tolist() == [False, False, True, True]  # either way round the block


def test_poses_without_a_path_are_unreachable_and_do_not_distort_their_neighbours() -> None:
    motion = ForwardMotion(HEIGHT, 0.25, 30.0, **SQUARE)
    task = Fps(motion, (0.75, 0.0, 0.0))
    found, open_ = plan(motion, Fence(), task.reached), plan(motion, empty(), task.reached)
    east = found.states[:, 0] > 0.3
    assert found.free.all() and torch.equal(found.distance == UNREACHABLE, ~east)
    assert not found.optimal(found.states[~east]).any()
    assert (found.distance[east] >= open_.distance[east]).all()
    assert found.distance.max() <= open_.distance.max() + 4


def test_only_free_poses_are_starts() -> None:
    motion = ForwardMotion(HEIGHT, 0.25, 30.0, **SQUARE)
    found = plan(motion, BlockChecker(), Fps(motion, (0.75, 0.0, 0.0)).reached)
    in_block = (found.states[:, :2].abs() < 0.35).all(1)
    assert torch.equal(found.free, ~in_block) and in_block.any()
    assert (found.distance[in_block] == UNREACHABLE).all() and (found.distance[~in_block] >= 0).all()
    assert torch.equal(found.distance == 0, found.free & found.at_goal(found.states))


def test_a_field_is_zero_at_the_goal_and_smooth_elsewhere() -> None:
    motion = ForwardMotion(HEIGHT, 0.25, 45.0, **SQUARE)
    field = cost_field(Moves(motion, empty(), Fps(motion, (0.75, 0.0, 0.0)).reached))
    line = torch.stack([torch.linspace(-0.75, 0.75, 301), torch.zeros(301), torch.zeros(301)], 1)
    steps = field(line)
    assert steps[-50:].max() == 0 and steps[0] == pytest.approx(5.0, abs=0.01)
    assert (steps.diff() <= 1e-4).all() and steps.diff().abs().max() < 0.1
    assert torch.equal(field(line + torch.tensor([0.0, 0.0, math.tau])).round(decimals=2), steps.round(decimals=2))


@pytest.mark.parametrize("drive", [False, True])
def test_a_scene_without_a_free_pose_or_a_goal_is_refused(drive: bool) -> None:
    motion: PlannedMotion = coarse_drive().motion if drive else ForwardMotion(HEIGHT, 0.25, 90.0, **BOUNDS)
    make = Drive if drive else Fps
    with pytest.raises(ValueError, match=r"scene: expected free poses, got [0-9]+ poses that all collide"):
        plan(motion, BlockChecker(reach=9.0), make(motion, (0.5, 1.0, 0.0)).reached)
    with pytest.raises(
        ValueError, match=r"task: expected a free pose at the goal, found none among [1-9][0-9]* poses there"
    ):
        plan(motion, BlockChecker(reach=0.9), make(motion, (0.0, 0.0, 0.0)).reached)
    with pytest.raises(ValueError, match=r"task: expected a free pose at the goal, found none among 0 poses there"):
        plan(motion, BlockChecker(), make(motion, (5.0, 0.0, 0.0)).reached)


def test_a_goal_that_no_start_can_reach_is_refused() -> None:
    class Frozen(Fence):
        def free_fraction(self, start: Tensor, end: Tensor) -> Tensor:
            return torch.zeros(len(start))

    motion = ForwardMotion(HEIGHT, 0.25, 90.0, **BOUNDS)
    with pytest.raises(
        ValueError, match=r"task: expected a path to the goal from at least one free pose, found none from 468"
    ):
        plan(motion, Frozen(), Fps(motion, (0.5, 1.0, 0.0)).reached)


def test_the_cost_to_go_is_far_where_there_is_no_path() -> None:
    motion = ForwardMotion(HEIGHT, 0.25, 30.0, **SQUARE)
    found = plan(motion, Fence(), Fps(motion, (0.75, 0.0, 0.0)).reached)
    far = found.cost_to_go(torch.tensor([[-0.5, 0.1, 1.0], [0.5, 0.0, 0.0]]))
    assert far[0] == FAR and far[1] < 2


def test_actions_much_shorter_than_the_distance_between_nodes_have_accurate_costs() -> None:
    rows = torch.arange(1, 8)
    short = Taps(torch.stack([rows, rows - 1], 1), torch.tensor([0.98, 0.02]).repeat(7, 1))  # towards the goal, node 0
    none = Taps(rows[:, None], torch.ones(7, 1))
    costs = _settle(
        torch.tensor([0.0, *[FAR] * 7]),
        rows,
        [(short, torch.ones(7)), (none, torch.ones(7))],
        torch.ones(8, dtype=torch.bool),
    )
    torch.testing.assert_close(costs, 50.0 * torch.arange(8.0), atol=0.0, rtol=1e-4)
