"""The poster task."""

import math
from typing import Any

import pytest
import torch
from hydra.utils import instantiate

from splatrl.configuration import load_config
from splatrl.envs.tasks import Fps, Poster
from splatrl.motions import ForwardMotion
from tests.tiny import HEIGHT

PUBLISHED = [0.3179229490458535, 0.044831075423480554, -0.3, 90.0, 0.0, 80.0]


def test_the_published_goal_looks_along_170_degrees() -> None:
    task = Poster(ForwardMotion(HEIGHT), PUBLISHED)
    assert task.goal.tolist() == [PUBLISHED[0], PUBLISHED[1], math.radians(170.0)]


def test_a_yaw_of_zero_looks_along_y_as_a_level_opengl_camera_does() -> None:
    """The camera's view direction, −z, is turned by a roll of 90° about x and by the yaw about z."""
    for yaw_deg in (0.0, 80.0, -30.0):
        yaw = math.radians(yaw_deg)
        forward = [-math.sin(yaw), math.cos(yaw)]  # Rz(yaw) @ Rx(90°) @ (0, 0, -1)
        goal = Poster(ForwardMotion(HEIGHT), [0.1, 0.2, 0.0, 90.0, 0.0, yaw_deg]).goal
        assert [math.cos(goal[2]), math.sin(goal[2])] == pytest.approx(forward)


def test_the_config_is_the_published_example() -> None:
    task = instantiate(load_config(["task=poster"]).task)
    assert isinstance(task, Fps) and task.goal.tolist() == Poster(task.motion, PUBLISHED).goal.tolist()
    assert (task.motion.step, task.motion.headings, task.max_steps) == (0.1, 36, 200)
    there = torch.tensor([[0.32, 0.04, math.radians(165.0)], [0.32, 0.04, math.radians(80.0)]])
    assert task.reached(there).tolist() == [True, False]


@pytest.mark.parametrize(
    "goal",
    [
        None,
        3.0,
        ["1"] * 6,
        PUBLISHED[:3],
        [*PUBLISHED, 0.0],
        [math.nan, *PUBLISHED[1:]],
        [*PUBLISHED[:2], math.inf, 90, 0, 80],
    ],
)
def test_a_goal_of_anything_but_six_finite_numbers_is_refused(goal: Any) -> None:
    with pytest.raises(ValueError, match=r"task\.goal: expected finite x, y, z \(metres\), roll, pitch and yaw"):
        Poster(ForwardMotion(HEIGHT), goal)
