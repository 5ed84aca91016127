import functools
import itertools
import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import torch
from omegaconf import OmegaConf
from torch import Tensor

from splatrl.bodies import Box, Sphere
from splatrl.cameras import Cameras, intrinsics, look_at
from splatrl.collision import FclChecker, NativeChecker, Occupancy, fcl
from splatrl.collision.distances import DistanceField
from splatrl.curriculum.planner import Plan, plan
from splatrl.envs.tasks import Grid
from splatrl.geometry import rigid
from splatrl.motions import LatticeMotion
from splatrl.renderers import NativeRenderer
from splatrl.scenes.gaussians import Gaussians
from splatrl.scenes.yard import EGG, backyard_gaussians, backyard_obstacles
from splatrl.scenes.yard.clutter import BELONGS_TO, Shift, clutter_moves, moved
from splatrl.scenes.yard.enclosure import enclosure
from splatrl.scenes.yard.furniture import egg, furniture
from splatrl.scenes.yard.layout import EGG_STONE, Solid, trees
from splatrl.scenes.yard.light import SUN, occluders, sunlight
from splatrl.spherical_harmonics import C0

SETTING = OmegaConf.load(Path(__file__).parents[2] / "conf" / "scene" / "backyard.yaml")
GOAL = tuple(SETTING.landmarks.goal)
"""The goal pose of the grid task: x and y in metres and yaw in degrees."""
ROBOT_HEIGHT = SETTING.robot.height
BOUNDS = ((-1.0, -1.0), (1.0, 1.0))
"""Lowest and highest (x, y) of the robot's pose, inclusive, metres: 121 positions in steps of 0.2 m."""
YARDS = ((0, 0), (7, 1))
"""Seed and clutter of the yards under test."""
ROBOT = Box((0.4, 0.4, 0.1))
ABOVE_GRASS = 0.15
ROUND = ("shrub", "pots on the table", "egg", "egg stone", "shrub pot", "rain barrel", "trunk")


@pytest.fixture(scope="module", autouse=True)
def one_distance_field() -> Iterator[None]:
    """Let all checkers of an occupancy share its distance field, which takes most of a second to compute."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fcl, "DistanceField", functools.lru_cache(maxsize=1)(DistanceField))
        yield


@functools.cache
def made(seed: int, clutter: int) -> Gaussians:
    """Return a cached yard, which no test may change."""
    return backyard_gaussians(seed, clutter)


@pytest.fixture(scope="module", params=YARDS)
def numbers(request: pytest.FixtureRequest) -> tuple[int, int]:
    seed, clutter = request.param
    return seed, clutter


@pytest.fixture(scope="module")
def yard(numbers: tuple[int, int]) -> Gaussians:
    return made(*numbers)


@pytest.fixture(scope="module")
def occupancy(yard: Gaussians) -> Occupancy:
    return Occupancy.from_gaussians(yard, resolution=0.05)


@pytest.fixture(scope="module")
def task() -> Grid:
    lower, upper = BOUNDS
    return Grid(LatticeMotion(ROBOT_HEIGHT, 0.2, 22.5, lower, upper), GOAL)


@pytest.fixture(scope="module")
def planned(occupancy: Occupancy, task: Grid) -> Plan:
    return plan(task.motion, NativeChecker(occupancy, ROBOT), task.reached)


@pytest.fixture(scope="module")
def free_positions(planned: Plan, task: Grid) -> Tensor:
    """Positions that are free at some heading: [P, 3] metres."""
    some = planned.free.view(11, 11, 16).any(2)
    x, y = task.motion.planar(planned.states)[:, :2].float().view(11, 11, 16, 2)[:, :, 0][some].unbind(-1)
    return torch.stack([x, y, torch.full_like(x, ROBOT_HEIGHT)], -1)


def ego(position: tuple[float, float], yaw: float, width: int = 64, height: int = 64) -> Cameras:
    """Return the robot's camera: level, with a 90° field of view."""
    eye = torch.tensor([*position, ROBOT_HEIGHT])
    ahead = eye + torch.tensor([math.cos(yaw), math.sin(yaw), 0.0])
    return Cameras(look_at(eye, ahead)[None], intrinsics(math.pi / 2, width, height), width, height)


def red(rgb: Tensor) -> Tensor:
    """Return which pixels show the egg: [..., 3] -> [...] bool."""
    return (rgb[..., 0] > 0.4) & (rgb[..., 1:].amax(-1) < 0.35 * rgb[..., 0])


def random_points(count: int, low: tuple[float, ...], high: tuple[float, ...], salt: int) -> Tensor:
    """Return random points in a box: [count, 3] metres."""
    generator = torch.Generator().manual_seed(salt)
    corner, opposite = torch.tensor(low), torch.tensor(high)
    return corner + (opposite - corner) * torch.rand(count, 3, generator=generator)


def at(points: Tensor) -> Tensor:
    """Return poses without rotation: [N, 3] -> [N, 4, 4]."""
    return rigid(torch.eye(3).expand(len(points), 3, 3), points)


def test_a_seed_always_gives_the_same_bytes_and_another_seed_gives_others() -> None:
    first, second, other = made(0, 0), backyard_gaussians(0), backyard_gaussians(4)
    for name in ("means", "quats", "scales", "opacities", "sh"):
        assert getattr(first, name).numpy().tobytes() == getattr(second, name).numpy().tobytes()
    assert first.means.numpy().tobytes() != other.means.numpy().tobytes()


def test_the_backyard_is_a_valid_scene_of_moderate_size(yard: Gaussians) -> None:
    assert 20_000 <= len(yard.means) <= 60_000
    assert yard.sh_degree == 0
    assert all(getattr(yard, name).isfinite().all() for name in ("means", "quats", "scales", "opacities", "sh"))
    assert torch.allclose(yard.quats.norm(dim=1), torch.ones(len(yard.means)), atol=1e-5)
    assert (yard.scales > 0).all() and (yard.opacities > 0.5).all() and (yard.opacities <= 1).all()
    colors = yard.sh[:, 0] * C0 + 0.5
    assert colors.min() > -1e-6 and colors.max() < 1 + 1e-6


def test_no_view_of_a_robot_has_a_hole(yard: Gaussians) -> None:
    renderer = NativeRenderer(yard)
    for position, yaw in itertools.product([(-1.0, -1.0), (0.5, -0.3), (0.4, 1.0)], [0.2, 1.5, 3.0, 4.4]):
        alpha = renderer.render(ego(position, yaw, width=40, height=30)).alpha
        assert alpha.min() > 0.97, (position, yaw)


def test_about_a_quarter_of_the_positions_is_blocked_at_every_heading(planned: Plan) -> None:
    blocked = ~planned.free.view(121, 16).any(1)
    assert 0.18 <= blocked.float().mean() <= 0.30


def test_every_free_pose_has_a_path_to_the_goal_and_the_longest_path_is_a_detour(planned: Plan) -> None:
    assert (planned.distance[planned.free] >= 0).all()
    assert 22 <= planned.distance.max() <= 28


def test_the_goal_pose_and_all_poses_next_to_it_are_free(planned: Plan, task: Grid) -> None:
    reached = task.reached(planned.states)
    assert reached.sum() == 27
    assert planned.free[reached].all()


def test_a_robot_2_cm_wider_or_narrower_collides_at_the_same_poses(occupancy: Occupancy, task: Grid) -> None:
    states = task.motion.states()
    square_on = task.motion.body_to_world(states[states[:, 2] % 4 == 0])
    hits = [FclChecker(occupancy, Box((size, size, 0.1))).collides(square_on) for size in (0.38, 0.4, 0.42)]
    assert torch.equal(hits[0], hits[1]) and torch.equal(hits[1], hits[2])


def test_the_egg_is_large_and_central_in_the_view_from_the_goal(yard: Gaussians) -> None:
    x, y, yaw_deg = GOAL
    seen = red(NativeRenderer(yard).render(ego((x, y), math.radians(yaw_deg))).rgb[0])
    assert seen.float().mean() >= 0.02
    row, column = seen.nonzero().float().mean(0) + 0.5
    assert abs(row - 32) < 3 and abs(column - 32) < 3


def test_the_egg_is_hidden_from_at_least_a_fifth_of_the_free_positions(yard: Gaussians, free_positions: Tensor) -> None:
    width, height = 20, 16
    poses = look_at(free_positions, torch.tensor(EGG))
    output = NativeRenderer(yard).render(Cameras(poses, intrinsics(0.4, width, height), width, height))
    hidden = ~red(output.rgb).flatten(1).any(1)
    distance = (free_positions - torch.tensor(EGG)).norm(dim=1)
    middle = output.depth[:, height // 2, width // 2]
    assert hidden.float().mean() >= 0.20
    assert (middle[hidden] < 0.9 * distance[hidden]).all()
    assert (~hidden).float().mean() >= 0.3


def test_no_two_views_look_alike(yard: Gaussians) -> None:
    renderer = NativeRenderer(yard)
    places = [(-0.8, -0.8), (-0.6, 0.6), (0.6, -0.4), (0.4, 0.8)]
    views = torch.cat(
        [renderer.render(ego(place, turn * math.pi / 2, 16, 14)).rgb for place in places for turn in range(4)]
    ).flatten(1)
    differences = torch.cdist(views, views) / math.sqrt(views.shape[1])
    assert (differences + torch.eye(len(views))).min() > 0.08


def test_obstacles_near_the_robot_are_the_same_for_every_seed() -> None:
    def near(seed: int) -> list[tuple[str, tuple[float, float, float], tuple[float, float, float]]]:
        return [obstacle for obstacle in backyard_obstacles(seed) if obstacle[0] != "trunk"]

    assert near(0) == near(7)
    assert backyard_obstacles(0) != backyard_obstacles(7)


def test_without_clutter_nothing_is_moved(monkeypatch: pytest.MonkeyPatch) -> None:
    home = furniture(np.random.default_rng(0), clutter=0)
    elsewhere = furniture(np.random.default_rng(0), clutter=1)
    monkeypatch.setattr("splatrl.scenes.yard.furniture.moved", lambda part, center, move: part)
    never = furniture(np.random.default_rng(0), clutter=1)
    assert home.means.tobytes() == never.means.tobytes() != elsewhere.means.tobytes()
    assert home.axes.tobytes() == never.axes.tobytes()
    assert home.colors.tobytes() == elsewhere.colors.tobytes()
    assert backyard_obstacles(3, clutter=0) == backyard_obstacles(3)


@pytest.mark.parametrize("clutter", range(1, 9))
def test_clutter_moves_only_its_own_things_and_keeps_them_out_of_the_robots_reach(clutter: int) -> None:
    reach = 1.0 + ROBOT.radius
    for (name, *before), (same, *after) in zip(backyard_obstacles(3), backyard_obstacles(3, clutter), strict=True):
        assert name == same
        shift = np.subtract(after, before)
        assert np.allclose(shift[0], shift[1])
        assert (np.linalg.norm(shift[0]) > 0.1) == (name in BELONGS_TO and name != "pots on the table"), name
        if shift.any():
            low, high = np.array(after)[:, :2]
            assert (low > reach).any() or (high < -reach).any(), name
            assert shift[:, 2].max() == 0 and np.abs(shift).max() < 0.8


def test_every_clutter_number_moves_things_differently_and_a_negative_one_is_refused() -> None:
    assert len({str(clutter_moves(clutter)) for clutter in range(20)}) == 20
    with pytest.raises(ValueError, match="clutter"):
        backyard_gaussians(0, clutter=-1)


def test_a_moved_thing_is_turned_about_its_own_middle() -> None:
    part = furniture(np.random.default_rng(0))
    turned = moved(part, (0.3, -1.0), Shift(x=0.1, turn=math.pi))
    assert np.allclose(turned.means[:, :2] + part.means[:, :2], [0.3 * 2 + 0.1, -2.0])
    assert np.allclose(turned.axes[:, :2], -part.axes[:, :2]) and np.allclose(turned.axes[:, 2], part.axes[:, 2])
    assert np.allclose(turned.normals * (-1, -1, 1), part.normals)
    assert moved(part, (0.3, -1.0), Shift()) is part


def test_a_cube_in_free_space_touches_nothing(numbers: tuple[int, int], occupancy: Occupancy) -> None:
    half, margin = 0.1, 0.05
    low, high = (-1.4, -1.4, ABOVE_GRASS + half + margin), (1.4, 1.4, 1.2)
    centers = random_points(4000, low, high, salt=1)
    clear = torch.ones(len(centers), dtype=torch.bool)
    for _, corner, opposite in backyard_obstacles(*numbers):
        reach = half + margin
        inside = (centers > torch.tensor(corner) - reach) & (centers < torch.tensor(opposite) + reach)
        clear &= ~inside.all(1)
    assert clear.sum() > 1000
    assert not FclChecker(occupancy, Box((0.2, 0.2, 0.2))).collides(at(centers[clear])).any()


def test_the_faces_of_every_obstacle_are_solid(numbers: tuple[int, int], occupancy: Occupancy) -> None:
    touch = FclChecker(occupancy, Sphere(0.05))
    for name, low, high in backyard_obstacles(*numbers):
        corner, opposite = torch.tensor(low).clamp(-3.1, 3.1), torch.tensor(high).clamp(-3.1, 3.1)
        height = max(0.5 * float(corner[2] + opposite[2]), ABOVE_GRASS + 0.05)
        for axis, end in itertools.product((0, 1), (corner, opposite)):
            point = 0.5 * (corner + opposite)
            if abs(float(end[axis])) > 2.95:
                continue  # the far side of the yard's enclosure
            point[axis], point[2] = end[axis], height
            assert touch.collides(at(point[None])).all(), (name, axis, point.tolist())


def test_nothing_slips_through_an_obstacle(numbers: tuple[int, int], occupancy: Occupancy) -> None:
    needle = FclChecker(occupancy, Sphere(0.005))
    for name, low, high in backyard_obstacles(*numbers):
        if name in ROUND or name in ("table leg", "bench"):
            continue
        inset_low = (*(v + 0.03 for v in low[:2]), max(low[2] + 0.01, ABOVE_GRASS))
        inset_high = (*(v - 0.03 for v in high[:2]), high[2] - 0.03)
        points = random_points(300, inset_low, inset_high, salt=2)
        axis = 0 if high[0] - low[0] < high[1] - low[1] else 1
        start, end = points.clone(), points.clone()
        start[:, axis], end[:, axis] = low[axis] - 0.15, high[axis] + 0.15
        assert needle.sweeps(at(start), at(end)).all(), name


def test_surfels_have_right_handed_axes_and_the_egg_faces_outward() -> None:
    rng = np.random.default_rng(0)
    for part in (furniture(rng), enclosure(rng)):
        assert np.allclose(part.axes @ part.axes.swapaxes(1, 2), np.eye(3), atol=1e-9)
        assert np.allclose(np.linalg.det(part.axes), 1.0)
    shell = egg(rng)
    outward = shell.means - np.array(EGG)
    on_egg = shell.means[:, 2] > EGG_STONE.high[2] + 0.01
    assert ((outward * shell.normals).sum(1)[on_egg] > 0).all()


def test_a_box_casts_its_shadow_away_from_the_sun_and_not_on_itself() -> None:
    box = Solid("box", (-0.5, -0.5, 0.0), (0.5, 0.5, 1.0))
    far_crowns = tuple(tree for tree in trees(0) if tree.x > 5)
    behind, before, on_top = (-0.9 * SUN * (1, 1, 0), 1.8 * SUN * (1, 1, 0), np.array([0.1, 0.2, 1.0]))
    share = sunlight(np.stack([behind / np.hypot(*SUN[:2]), before, on_top]), occluders([box], far_crowns))
    assert share[0] == 0.0
    assert (share[1:] > 0.9).all()


def test_a_tree_crown_lets_part_of_the_light_through() -> None:
    tree = trees(0)[0]
    foot = np.array([tree.x, tree.y, tree.crown_height]) - 2.0 * SUN
    nowhere = Solid("nowhere", (90.0, 90.0, 0.0), (91.0, 91.0, 1.0))
    assert 0.02 < sunlight(foot[None], occluders([nowhere], (tree,)))[0] < 0.5
