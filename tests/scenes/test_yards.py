"""Generated yards are as hard as the backyard, solvable by the robots' collision checker, and all different."""

import math
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

import splatrl
from splatrl.bodies import Box
from splatrl.cameras import Cameras, intrinsics, look_at
from splatrl.collision import NativeChecker, Occupancy
from splatrl.configuration import load_config
from splatrl.curriculum.planner import Plan, plan
from splatrl.envs.tasks import Grid
from splatrl.motions import LatticeMotion
from splatrl.renderers import NativeRenderer
from splatrl.scenes.yard import backyard_obstacles
from splatrl.scenes.yard.layout import Solid
from splatrl.scenes.yards import Yard, source, yard, yards
from splatrl.scenes.yards.layout import beside, span, strip
from splatrl.scenes.yards.solvable import BLOCKED, LONGEST, Cells, difficulty, footprints, solvable
from tests.preloaded import Process, start

SEEDS = (0, 3, 10)
ROUND = ("shrub", "egg", "egg stone", "shrub pot", "rain barrel", "trunk")
FIELDS = ("means", "quats", "scales", "opacities", "sh")


@pytest.fixture(scope="module", autouse=True)
def own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """An initially empty cache, so that the code under test generates the yards."""
    folder = tmp_path_factory.mktemp("cache")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SPLATRL_CACHE", str(folder))
        yield folder


@pytest.fixture(scope="module", params=[SEEDS[0], *(pytest.param(seed, marks=pytest.mark.slow) for seed in SEEDS[1:])])
def made(request: pytest.FixtureRequest) -> Yard:
    (one,) = yards([request.param])
    return one


@pytest.fixture(scope="module")
def task(made: Yard) -> Grid:
    return Grid(LatticeMotion(0.4, 0.2, 22.5, (-1.0, -1.0), (1.0, 1.0)), made.goal)


@pytest.fixture(scope="module")
def planned(made: Yard, task: Grid) -> Plan:
    checker = NativeChecker(Occupancy.from_scene(made.scene), Box((0.4, 0.4, 0.1)))
    return plan(task.motion, checker, task.reached)


def all_bytes(scene: splatrl.Scene) -> list[bytes]:
    return [getattr(scene.gaussians, name).numpy().tobytes() for name in FIELDS]


def red(rgb: Tensor) -> Tensor:
    """Return which pixels show the egg: [..., 3] -> [...] bool."""
    return (rgb[..., 0] > 0.4) & (rgb[..., 1:].amax(-1) < 0.35 * rgb[..., 0])


def test_a_yard_is_as_hard_as_the_backyard_for_the_robots_collision_checker(made: Yard, planned: Plan) -> None:
    blocked = (~planned.free.view(121, 16).any(1)).float().mean()
    assert BLOCKED[0] <= blocked <= BLOCKED[1]
    assert LONGEST[0] <= planned.distance.max() <= LONGEST[1]
    assert blocked == pytest.approx(made.blocked) and planned.distance.max() == made.longest


def test_every_free_pose_has_a_path_to_the_goal_and_all_poses_next_to_the_goal_are_free(
    planned: Plan, task: Grid
) -> None:
    assert (planned.distance[planned.free] >= 0).all()
    reached = task.reached(planned.states)
    assert reached.sum() == 27 and planned.free[reached].all()


def test_the_egg_is_large_and_central_in_the_view_from_the_goal(made: Yard) -> None:
    x, y, yaw_deg = made.goal
    eye, yaw = torch.tensor([x, y, 0.4]), math.radians(yaw_deg)
    ahead = eye + torch.tensor([math.cos(yaw), math.sin(yaw), 0.0])
    seen = red(
        NativeRenderer(made.scene)
        .render(Cameras(look_at(eye, ahead)[None], intrinsics(math.pi / 2, 64, 64), 64, 64))
        .rgb[0]
    )
    assert seen.float().mean() >= 0.02
    row, column = seen.nonzero().float().mean(0) + 0.5
    assert abs(row - 32) < 3 and abs(column - 32) < 3
    assert math.dist(made.egg[:2], made.goal[:2]) < 0.8


def test_the_object_hangs_in_free_space_and_the_bounds_contain_the_walkable_area(made: Yard) -> None:
    occupancy = Occupancy.from_scene(made.scene)
    (ahead,) = torch.eye(4)[None].clone()
    ahead[:3, 3] = torch.tensor(made.object)
    assert not NativeChecker(occupancy, Box((0.2, 0.2, 0.2))).collides(ahead[None]).any()
    (lower, upper), (low, high) = made.scene.bounds, made.walk
    assert all(a < b < -1.0 and 1.0 < c < d for a, b, c, d in zip(lower, low, high, upper, strict=False))
    assert lower[2] == 0.0


def test_no_view_of_a_robot_has_a_hole(made: Yard, planned: Plan) -> None:
    poses = planned.motion.body_to_world(planned.starts[:: len(planned.starts) // 12])
    eyes = poses[:, :3, 3]
    cameras = Cameras(look_at(eyes, eyes + poses[:, :3, 0]), intrinsics(math.pi / 2, 40, 30), 40, 30)
    assert NativeRenderer(made.scene).render(cameras).alpha.min() > 0.95


def test_a_yard_is_a_valid_scene_of_moderate_size_in_memory_and_on_disk(made: Yard, own_cache: Path) -> None:
    g = made.scene.gaussians
    assert 30_000 <= len(g.means) <= 120_000
    assert all(getattr(g, name).isfinite().all() for name in FIELDS)
    assert (g.scales > 0).all() and (g.opacities > 0.5).all() and (g.opacities <= 1).all()
    (kept,) = own_cache.glob(f"yard-{made.seed}-*.npz")
    assert kept.stat().st_size < 30e6


def test_a_seed_gives_the_same_yard_in_any_process_and_other_seeds_give_other_yards(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    alone = yards([10, 3])
    other, first = alone
    assert all_bytes(first.scene) == all_bytes(yards([3])[0].scene)  # from the cache
    assert all_bytes(first.scene) != all_bytes(other.scene)
    assert first.egg != other.egg and first.scene.bounds != other.scene.bounds
    monkeypatch.setenv("SPLATRL_CACHE", str(tmp_path))
    begun: list[str] = []

    def started(command: list[str], stdout: int) -> Process:
        assert command[0] == sys.executable and stdout == subprocess.DEVNULL
        begun.append(command[-1])
        return start(*command[1:])

    monkeypatch.setattr(source, "Popen", started)
    together = yards([10, 3], workers=2)
    assert begun == ["10", "3"]
    assert [one.seed for one in together] == [10, 3]
    for one, same in zip(alone, together, strict=True):
        assert all_bytes(one.scene) == all_bytes(same.scene) and one.goal == same.goal and one.walk == same.walk
    assert all_bytes(yard(3)) == all_bytes(first.scene)


def test_the_measured_difficulty_of_the_backyard_is_that_of_the_planner() -> None:
    cells = Cells.empty((-3.0, -3.0), (3.0, 3.0))
    for name, low, high in backyard_obstacles():
        cells.fill(Solid(name, low, high), pad=0.0, round_=name in ROUND)
    found = difficulty(cells, (0.6, 0.4, 0.0))
    assert found.blocked == pytest.approx(33 / 121) and found.longest == 24  # as tests/scenes/test_backyard.py plans it
    assert solvable(found)


def test_strips_lie_inside_the_sides_of_a_yard_and_points_beside_them_in_or_outside() -> None:
    outline, low, high = (-3.0, -2.0, 5.0, 4.0), 0.5, 1.5
    strips = [strip(outline, quarters, low, high, 0.25, 1.0) for quarters in range(4)]
    assert strips == [(0.5, 3.0, 1.5, 3.75), (-2.75, 0.5, -2.0, 1.5), (0.5, -1.75, 1.5, -1.0), (4.0, 0.5, 4.75, 1.5)]
    assert [beside(outline, quarters, 0.5, -1.0) for quarters in range(4)] == [(0.5, 5), (-4, 0.5), (0.5, -3), (6, 0.5)]
    assert [span(outline, quarters) for quarters in range(4)] == 2 * [(-3.0, 5.0), (-2.0, 4.0)]


def test_a_yard_divided_by_a_wall_is_not_solvable_and_an_empty_one_is_too_easy() -> None:
    cells = Cells.empty((-2.0, -2.0), (2.0, 2.0))
    assert not solvable(difficulty(cells, (0.6, 0.0, 0.0)))
    cells.fill(Solid("wall", (-0.13, -2.0, 0.0), (-0.07, 2.0, 1.0)), pad=0.0)
    found = difficulty(cells, (0.6, 0.0, 0.0))
    assert 0.4 < found.connected < 0.6 and 0.4 < found.open < 0.6 and found.goal_free and not solvable(found)


def test_things_above_or_below_the_body_do_not_block_and_a_goal_inside_a_thing_is_not_free() -> None:
    cells = Cells.empty((-2.0, -2.0), (2.0, 2.0))
    cells.fill(Solid("step", (-1.0, -1.0, 0.0), (1.0, 1.0, 0.3)), pad=0.0)
    cells.fill(Solid("arch", (-1.0, -1.0, 0.6), (1.0, 1.0, 0.9)), pad=0.0)
    assert not cells.solid.any()
    cells.fill(Solid("pot", (0.5, -0.1, 0.0), (0.7, 0.1, 0.6)), pad=0.0, round_=True)
    assert not difficulty(cells, (0.6, 0.0, 0.0)).goal_free


def test_the_footprint_of_a_turned_body_covers_about_the_area_of_its_square() -> None:
    masks = footprints()
    assert masks[0].sum() == 64  # 0.4 m of cells of 0.05 m, square to the grid
    assert np.allclose(masks[1:].sum((1, 2)) * 0.05**2, 0.16, rtol=0.45) and (masks[1:].sum((1, 2)) > 64).all()


def test_a_config_takes_goal_and_object_from_the_yard_unless_the_command_line_sets_them() -> None:
    (one,) = yards([3])
    cfg = load_config(["scene=yard", "scene.seed=3"])
    assert tuple(cfg.landmarks.goal) == one.goal and tuple(cfg.landmarks.object) == one.object
    cfg = load_config(["scene=yard", "scene.seed=3", "landmarks.goal=[0.2,0.2,90]"])
    assert list(cfg.landmarks.goal) == [0.2, 0.2, 90] and tuple(cfg.landmarks.object) == one.object


@pytest.mark.parametrize("seed", ["1,2", "x", "-1", "1.5"])
def test_an_invalid_seed_is_refused_by_its_key(seed: str) -> None:
    with pytest.raises(ValueError, match=r"scene\.seed: expected one whole number"):
        load_config(["scene=yard", f"scene.seed={seed}"])


def test_a_negative_seed_empty_bounds_and_zero_workers_are_refused() -> None:
    with pytest.raises(ValueError, match=r"scene\.seed"):
        yard(-1)
    with pytest.raises(ValueError, match="bounds"):
        yard(3, bounds=[[0, 0, 0], [0, 1, 1]])
    with pytest.raises(ValueError, match="workers"):
        yards([3], workers=0)


def test_two_overrides_suffice_for_an_environment_in_one_yard(own_cache: Path) -> None:
    env = splatrl.make_env(["scene=yard", "scene.seed=3"], batch_size=[2])
    assert env.rollout(2)["pixels"].float().std() > 10
