"""What is solid where robots may walk, and which places are refused."""

import warnings
from pathlib import Path

import pytest
import torch

from splatrl.building.places import Place, build_places
from splatrl.configuration import load_config
from splatrl.misfits import check_height
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


def test_robots_that_could_walk_where_nothing_was_captured_are_refused(tmp_path: Path) -> None:
    wider = ["task.motion.lower=[-3.0,-3.5]", "task.motion.upper=[3.0,3.5]"]
    built(tmp_path, *wider)  # the room is closed: all beyond its walls is solid
    with pytest.raises(
        ValueError, match=r"where the scene was captured, x from -1\.5\S* to 1\.5.*got free poses at x from -3"
    ):
        built(tmp_path, *wider, "collision.occupancy.fill=null")
    built(tmp_path, *wider, "collision.occupancy.fill=null", "scene.bounds=[[-3,-3.5,0],[3,3.5,1.2]]")


def test_a_scene_in_which_nothing_is_solid_causes_a_warning(tmp_path: Path) -> None:
    with pytest.warns(UserWarning, match=r"tiny: nothing is solid within bounds; is the scale right\?"):
        place = built(tmp_path, "collision.occupancy.density.min_opacity=0.95")
    assert str(place.occupancy.report()).startswith("problem     nothing is solid within bounds; is the scale right?")
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        assert "problem" not in str(built(tmp_path).occupancy.report())


def test_only_robots_at_a_fixed_height_must_be_below_the_top_of_the_scene(tmp_path: Path) -> None:
    low = ((-1.5, -2.0, 0.0), (1.5, 2.0, 0.4))
    for task in ("grid", "drive"):
        with pytest.raises(ValueError, match=r"robot\.height: expected robots below 0\.4 m, .* got 0\.5"):
            check_height(low, built(tmp_path, task=task).task)
    check_height(low, built(tmp_path, task="circle").task)
