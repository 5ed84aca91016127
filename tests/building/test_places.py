"""What is solid where robots may walk, and which places are refused."""

import warnings
from pathlib import Path

import numpy as np
import pytest
import torch

from splatrl.building.instantiation import instantiate
from splatrl.building.misfits import check_height, warn_of_no_floor
from splatrl.building.places import Place, build_places, start_region
from splatrl.collision.voxels import Voxels
from splatrl.configuration import load_config
from tests.tiny import tiny_overrides

WIDE = ["task.motion.lower=[-2.0,-2.5]", "task.motion.upper=[2.0,2.5]"]


def built(folder: Path, *overrides: str, task: str = "grid") -> Place:
    """Build the tiny room, whose walls stand at x = ±1.5 and y = ±2 m."""
    cfg = load_config([*tiny_overrides(folder, task), *overrides])
    (place,) = build_places([cfg], torch.device("cpu"), [""])
    return place


@pytest.mark.parametrize("task", ["grid", "drive"])
def test_walls_beyond_the_bounds_of_the_scene_are_solid_where_robots_may_walk(tmp_path: Path, task: str) -> None:
    place = built(
        tmp_path, *WIDE, "scene.bounds=[[-0.6,-1.1,0.0],[0.6,1.1,1.2]]", "robot.body.size=[0.3,0.3,0.2]", task=task
    )
    motion, xs = place.task.motion, torch.tensor([-1.5, 1.5]).double()
    against = torch.stack([xs, torch.zeros(2).double(), torch.zeros(2).double()], 1)
    assert place.checker.collides(motion.body_to_world(motion.nearest(against))).all()
    starts = motion.planar(place.plan.states[place.plan.start_rows])[:, :2]
    assert (starts.abs() <= torch.tensor([0.6, 1.1])).all()


def test_a_warning_tells_of_robots_that_could_walk_where_nothing_was_captured(tmp_path: Path) -> None:
    wider = ["task.motion.lower=[-3.0,-3.5]", "task.motion.upper=[3.0,3.5]"]
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        built(tmp_path, *wider)  # the room is closed: all beyond its walls is solid
        warnings.filterwarnings("ignore", "tiny: .* free poses cannot reach the goal")  # those beyond the walls
        built(tmp_path, *wider, "collision.occupancy.fill=null", "scene.bounds=[[-3,-3.5,0],[3,3.5,1.2]]")
    where = r"tiny: robots may go where nothing was captured, x from -3.* beyond x from -1\.5\S* to 1\.5"
    with pytest.warns(UserWarning, match=where):
        built(tmp_path, *wider, "collision.occupancy.fill=null")


def test_a_scene_in_which_nothing_is_solid_causes_a_warning(tmp_path: Path) -> None:
    with pytest.warns(UserWarning, match=r"tiny: nothing is solid within bounds; is the scale right\?"):
        place = built(tmp_path, "collision.occupancy.density.min_opacity=0.95")
    assert str(place.occupancy.report()).startswith("problem     nothing is solid within bounds; is the scale right?")
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        assert "problem" not in str(built(tmp_path).occupancy.report())


def test_only_robots_at_a_fixed_height_must_not_be_far_above_the_scene(tmp_path: Path) -> None:
    floor, deep = ((-1.5, -2.0, -0.1), (1.5, 2.0, 0.0)), ((-0.1, -0.1, -0.3), (0.1, 0.1, -0.1))
    for task in ("grid", "drive"):
        robots = built(tmp_path, task=task).task
        check_height(floor, robots)
        above = r"robot\.height: expected robots less than 0\.2 m above the top of scene\.bounds, -0\.1 m, got 0\.5"
        with pytest.raises(ValueError, match=above):
            check_height(deep, robots)
    check_height(deep, built(tmp_path, task="circle").task)


def test_what_is_solid_is_known_as_far_as_the_task_lets_robots_go() -> None:
    pytest.importorskip("mujoco")
    for task, lowest, highest in (("route", [-2.3, -2.3], [2.3, 2.3]), ("gates", [-2.2, -2.2, 1.0], [2.2, 2.2, 2.0])):
        cfg = load_config([f"task={task}", "device=cpu"])
        made, body = instantiate(cfg.task), instantiate(cfg.robot).body
        _, (lower, upper) = start_region(made, body)
        beside = body.radius + made.leeway
        assert lower[:2] == pytest.approx([value - beside for value in lowest[:2]])
        assert upper[:2] == pytest.approx([value + beside for value in highest[:2]])
        if task == "gates":  # up to the ceiling
            assert (lower[2], upper[2]) == pytest.approx((1.0 - body.radius, 2.0 + body.radius))


def test_a_warning_tells_of_a_goal_and_of_starts_without_a_floor(tmp_path: Path) -> None:
    place = built(tmp_path)
    solid = place.occupancy
    x, y, z = (
        (np.arange(count) + 0.5 + first) * solid.resolution
        for count, first in zip(solid.occupied.shape, solid.origin_key, strict=True)
    )
    inside = (np.abs(x) < 1.4)[:, None] & (np.abs(y) < 1.9)
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        warn_of_no_floor(place.scene, place.plan, solid)
        warn_of_no_floor(place.scene, place.plan, solid.without(solid))  # nothing is known of the floor
    around_goal = (x > 0.2)[:, None] & (y > 0.2)  # the goal is at (0.5, 1)
    for kept, missing in ((~(x > -0.6)[:, None] | (y < -9), "the goal; type"), (around_goal, r"\d+ of \d+ starts")):
        occupied = solid.occupied & ~((inside & ~kept)[:, :, None] & (z < 0.5))
        with pytest.warns(UserWarning, match=f"tiny: nothing solid, such as a floor, is below {missing}"):
            warn_of_no_floor(place.scene, place.plan, Voxels(occupied, solid.origin_key, solid.resolution))


def test_building_a_place_whose_goal_has_no_floor_causes_a_warning(tmp_path: Path) -> None:
    beside = ["landmarks.goal=[2.5,0.0,0.0]", "task.motion.upper=[3.0,2.0]", "scene.bounds=[[-1.5,-2,0],[3,2,1.2]]"]
    with (
        pytest.warns(UserWarning, match="tiny: nothing solid, such as a floor, is below the goal"),
        warnings.catch_warnings(),
    ):
        warnings.filterwarnings("ignore", "tiny: (robots may go|.* free poses cannot)")
        built(tmp_path, *beside, "collision.occupancy.fill=null")
