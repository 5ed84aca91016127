"""Shortest paths on the ground, against lengths worked out by hand."""

import copy
import math

import numpy as np
import pytest
import torch

from splatrl.bodies import Box, Sphere
from splatrl.collision import NativeChecker, NoChecker, Occupancy
from splatrl.curriculum.geodesics import Geodesics
from splatrl.curriculum.ground import ground
from splatrl.motions import NavigateMotion
from splatrl.per_scene import rows_of, stacked

HEIGHT = 0.5
MOTION = NavigateMotion(HEIGHT, lower=(-1.0, -1.5), upper=(1.0, 1.5))
RADIUS = 0.1


def wall_with_a_door() -> Occupancy:
    """Make a wall along x at y = 0 that leaves a way past its end at x = 0.5."""
    return Occupancy.from_boxes([[-1.5, -0.05, 0.0]], [[0.5, 0.05, 1.0]], 0.05)


def checker(occupancy: Occupancy | None = None) -> NativeChecker:
    return NativeChecker(occupancy or wall_with_a_door(), Sphere(RADIUS))


def geodesics(cell: float = 0.05, **counts: int) -> Geodesics:
    numbers = {"for_training": 5, "for_tests": 3, "seed": 1} | counts
    return Geodesics.drawn(ground(MOTION, checker(), cell), **numbers)


def to(places: list[list[float]], goals: Geodesics, goal: list[float]) -> torch.Tensor:
    """Add a goal and return the distances from places to it."""
    more, rows = goals.with_goals(np.array([goal]), np.zeros(1, np.int64))
    return more.distance(torch.tensor(places), rows.expand(len(places)))


def test_on_open_ground_a_path_is_at_most_slightly_longer_than_the_straight_line() -> None:
    open_ground = Geodesics.drawn(ground(MOTION, NoChecker(Occupancy.empty(), Sphere(0.1)), 0.05), 1, 1, 0)
    generator = torch.Generator().manual_seed(0)
    places = torch.rand(500, 2, generator=generator) * torch.tensor([2.0, 3.0]) - torch.tensor([1.0, 1.5])
    found = to(places.tolist(), open_ground, [0.3, -0.2])
    straight = (places - torch.tensor([0.3, -0.2])).norm(dim=1)
    assert (found >= straight - 1e-5).all()
    assert (found <= 1.014 * straight + 0.01).all()
    near = straight < 0.1
    assert near.any() and torch.equal(found[near], straight[near])


def test_the_path_around_a_wall_passes_its_end() -> None:
    # The path goes straight to the wall's end, whose corners (0.5, ±0.05) it rounds on quarter circles of the body's
    # radius. From (0, -0.5) a tangent touches the first of them; an arc covers the remaining angle to its easternmost
    # point.
    away, down = 0.5, 0.45  # from the place to the first corner
    direct = math.hypot(away, down)
    tangent = math.sqrt(direct**2 - RADIUS**2)
    heading = math.atan2(down, away) - math.asin(RADIUS / direct)  # of the tangent, which passes south of the corner
    arc = RADIUS * (math.pi / 2 - heading)
    expected = 2 * (tangent + arc) + 0.1
    found = float(to([[0.0, -0.5]], geodesics(0.025), [0.0, 0.5]))
    assert found == pytest.approx(expected, rel=0.02)


def test_past_obstacles_a_path_is_at_most_2_cells_longer_than_on_a_fine_grid() -> None:
    obstacles = Occupancy.from_boxes(
        [[-0.5, -0.6, 0.0], [0.3, -0.2, 0.0], [-0.7, 0.5, 0.0], [0.2, 0.75, 0.0]],
        [[0.0, 0.0, 1.0], [0.35, 0.4, 1.0], [-0.2, 0.55, 1.0], [0.6, 1.1, 1.0]],
        0.05,
    )
    places = torch.rand(4000, 2, generator=torch.Generator().manual_seed(0)) * torch.tensor([2.0, 3.0])
    stand = torch.cat([places - torch.tensor([1.0, 1.5]), torch.zeros(4000, 1)], 1)
    free = stand[~checker(obstacles).collides(MOTION.body_to_world(stand)), :2].tolist()
    coarse, fine = (
        Geodesics.drawn(ground(MOTION, checker(obstacles), cell), for_training=1, for_tests=1, seed=0)
        for cell in (0.05, 0.0125)
    )
    for goal in ([0.8, -1.3], [-0.1, 0.3]):
        found, best = to(free, coarse, goal), to(free, fine, goal)
        assert (found <= 1.013 * best + 2 * 0.05).all() and (found >= best / 1.013 - 0.025).all()


def test_no_path_leads_through_a_gap_that_is_too_narrow_for_the_body() -> None:
    gap = Occupancy.from_boxes([[-1.5, -0.05, 0.0], [0.65, -0.05, 0.0]], [[0.5, 0.05, 1.0], [1.5, 0.05, 1.0]], 0.05)
    place = ground(MOTION, checker(gap), 0.05)
    upper = place.connected(torch.tensor([[0.0, 0.5], [0.0, -0.5]]))
    assert upper.sum() == 1  # the largest component is on one side
    inside = place.connected(torch.tensor([[0.0, 0.0]]))
    assert not inside.any()
    with pytest.raises(ValueError, match=r"goal of episode 0: expected a free place, got \[0.0, 0.0\]"):
        Geodesics.drawn(place, 1, 1, 0).with_goals(np.zeros((1, 2)), np.zeros(1, np.int64))


def lane(width: float) -> Occupancy:
    """Make two walls along x, with a lane between them."""
    half = 0.5 * width
    return Occupancy.from_boxes([[-1.5, half, 0.0], [-1.5, -2.0, 0.0]], [[1.5, 2.0, 1.0], [1.5, -half, 1.0]], 0.05)


@pytest.mark.parametrize(("body", "width"), [(Box((0.4, 0.4, 0.2)), 0.56), (Box((0.6, 0.1, 0.2)), 0.6)])
def test_a_box_is_led_only_where_it_can_turn(body: Box, width: float) -> None:
    middle = torch.stack([torch.linspace(-1.0, 1.0, 21), torch.zeros(21)], 1)
    wide = ground(MOTION, NativeChecker(lane(width + 0.1), body), 0.05)
    assert wide.connected(middle).all()
    narrow = NativeChecker(lane(width - 0.06), body)
    straight = torch.cat([middle, torch.zeros(21, 1)], 1)
    assert not narrow.collides(MOTION.body_to_world(straight)).any()  # where it can stand along the lane
    with pytest.raises(ValueError, match="expected places where the robot fits at every heading, found none"):
        ground(MOTION, narrow, 0.05)


def test_a_box_fits_at_every_heading_at_the_nodes_that_are_open() -> None:
    check = NativeChecker(wall_with_a_door(), Box((0.5, 0.2, 0.2)))
    place = ground(MOTION, check, 0.05)
    spots = torch.from_numpy(place.place(np.flatnonzero(place.open))).float()
    for yaw in torch.linspace(0.0, math.pi, 19):
        turned = MOTION.body_to_world(torch.cat([spots, yaw.expand(len(spots), 1)], 1))
        assert not check.collides(turned).any()
    round_one = ground(MOTION, NativeChecker(wall_with_a_door(), Sphere(0.28)), 0.05)  # over half the box's diagonal
    assert not (round_one.open & ~place.open).any()
    assert place.open.sum() < 1.1 * round_one.open.sum()


def test_goals_are_free_seeded_and_drawn_at_the_requested_distance() -> None:
    goals, again, other = geodesics(), geodesics(), geodesics(seed=2)
    assert torch.equal(goals.goals, again.goals) and not torch.equal(goals.goals, other.goals)
    assert goals.grounds[0].connected(goals.goals).all()
    places = torch.rand(200, 2, generator=torch.Generator().manual_seed(3)) * 0.4 + torch.tensor([0.55, -1.0])
    rows = goals.draw(places, 0.5, 2.0, torch.Generator().manual_seed(4))
    assert rows.min() >= 0 and rows.max() < 5
    everywhere = torch.stack([goals.distance(places, torch.full((200,), row)) for row in range(5)], 1)
    fits = (everywhere >= 0.5) & (everywhere <= 2.0)
    chosen = goals.distance(places, rows)
    assert torch.equal((chosen >= 0.5) & (chosen <= 2.0), fits.any(1)) and fits.any(1).sum() > 100
    tests = goals.draw(places, 0.0, 9.0, torch.Generator().manual_seed(4), tests=True)
    assert tests.min() >= 5 and tests.max() < 8


@pytest.mark.parametrize("at_once", [1, 700, 10**6])
def test_a_place_is_within_range_if_any_goal_for_training_is(at_once: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("splatrl.curriculum.geodesics.AT_ONCE", at_once)
    goals = geodesics(for_training=6)
    places = torch.rand(300, 2, generator=torch.Generator().manual_seed(5)) * torch.tensor([2.0, 3.0])
    places -= torch.tensor([1.0, 1.5])
    for least, most in ((0.0, 0.3), (1.0, 1.2), (0.0, 0.0), (0.0, 99.0)):
        far = torch.stack([goals.distance(places, torch.full((300,), row)) for row in range(6)])
        assert torch.equal(goals.within(places, least, most), ((far >= least) & (far <= most)).any(0))


def test_room_is_1_where_the_body_fits_in_the_goals_scene_and_0_beyond_the_bounds() -> None:
    walled = geodesics()
    open_ground = Geodesics.drawn(ground(MOTION, NoChecker(Occupancy.empty(), Sphere(0.1)), 0.05), 5, 3, 0)
    both = stacked([walled, open_ground])
    places = torch.tensor([[0.0, -0.5], [0.0, 0.0], [-0.5, -0.175], [1.0, 1.5], [1.01, 0.5], [0.5, -1.51]])
    in_walled, in_open = (both.room(places, torch.full((6,), row)) for row in (0, 8))
    assert in_walled[:2].tolist() == [1.0, 0.0] and 0.0 < in_walled[2] < 1.0  # between a free node and one that is not
    assert in_open[:4].tolist() == [1.0] * 4
    assert in_walled[3] == 1.0 and not in_walled[4:].any() and not in_open[4:].any()


def test_several_scenes_keep_their_goals_apart() -> None:
    one, other = geodesics(), geodesics(seed=5)
    both = stacked([one, other])
    places = torch.tensor([[0.7, 0.5], [0.7, -0.5], [0.8, 1.0]])
    scene = torch.tensor([1, 0, 1])
    rows = rows_of(both, scene).draw(places, 0.2, 5.0, torch.Generator().manual_seed(0))
    assert torch.equal(rows >= 8, scene == 1)
    for row, alone in ((0, other), (1, one), (2, other)):
        mine = int(rows[row]) % 8
        expected = alone.distance(places[row : row + 1], torch.tensor([mine]))
        assert torch.equal(both.distance(places[row : row + 1], rows[row : row + 1]), expected)
    more, added = both.with_goals(np.array([[0.7, 0.5], [0.7, 0.5]]), np.array([1, 0]))
    assert torch.allclose(more.goals[added], torch.tensor([0.7, 0.5]))


def test_further_goals_keep_the_distances_to_all_and_share_those_at_one_node(monkeypatch: pytest.MonkeyPatch) -> None:
    both = stacked([geodesics(), geodesics(seed=5)])
    own = both.goals[:2].double().numpy()  # which the first scene already has
    places = np.concatenate([[[0.7, 0.5], [0.7, -0.5], [0.71, 0.49]], own, [[0.7, 0.5]]])
    scene = np.array([1, 0, 1, 0, 0, 0])
    more, rows = both.with_goals(places, scene)
    assert len(more.goals) == len(both.goals) + 3 and rows[0] == rows[2] and rows.unique().numel() == 5
    assert rows[3:5].tolist() == [0, 1]
    torch.testing.assert_close(more.goals[rows].double(), torch.tensor(places), atol=0.011, rtol=0)
    assert ((rows >= more.begins[1]) == torch.from_numpy(scene == 1)).all()
    nodes = both.grounds[0].open.size
    monkeypatch.setattr("splatrl.curriculum.geodesics.MOST_DISTANCES", 3 * nodes)
    both.with_goals(places, scene)
    monkeypatch.setattr("splatrl.curriculum.geodesics.MOST_DISTANCES", 3 * nodes - 1)
    with pytest.raises(ValueError, match=rf"goals: expected at most {3 * nodes - 1:,} distances .*; type starts="):
        both.with_goals(places, scene)


def test_a_copy_shares_the_ground() -> None:
    goals = geodesics()
    assert copy.deepcopy(goals).grounds[0] is goals.grounds[0]


def test_too_many_goals_or_nodes_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ValueError, match=r"task\.goals: expected at most"):
        geodesics(for_training=10**5)
    place = ground(MOTION, checker(), 0.02)
    monkeypatch.setattr("splatrl.curriculum.geodesics.MOST_DISTANCES", 5 * place.open.size)
    with pytest.raises(ValueError, match=r"task\.goals: expected at most 5 goals, for a grid of [\d,]+ nodes, got 6"):
        Geodesics.drawn(place, 3, 3, 0)
    with pytest.raises(ValueError, match=r"task\.cell"):
        ground(MOTION, checker(), 0.001)
    full = Occupancy.from_boxes([[-2.0, -2.0, 0.0]], [[2.0, 2.0, 1.0]], 0.05)
    with pytest.raises(
        ValueError, match=r"where the robot fits at every heading, found none for x from .* to .* and y from"
    ):
        ground(MOTION, checker(full), 0.05)
