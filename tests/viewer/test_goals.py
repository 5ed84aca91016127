"""The goals of an episode are shown over the splats, in words, and in the panel if they are images."""

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from splatrl.envs.tasks import Mark
from splatrl.envs.world import World
from splatrl.evaluation.figure_style import GOAL
from splatrl.viewer.driving import Driving
from splatrl.viewer.goals import whereabouts
from splatrl.viewer.page import Page
from splatrl.viewer.robot import enlarged, rgb
from splatrl.viewer.takes import Takes


@pytest.mark.parametrize(
    ("robot", "goal", "said"),
    [
        ((0.0, 0.0, 0.0), (0.0, 1.5), "goal 1.50 m, 90° left"),
        ((0.0, 0.0, 3.0), (-1.0, 0.2), "goal 1.02 m, ahead"),
        ((1.0, 1.0, -3.0), (0.0, 2.0), "goal 1.41 m, 53° right"),
    ],
)
def test_the_distance_and_direction_of_a_goal_are_given_in_words(
    robot: tuple[float, ...], goal: tuple[float, float], said: str
) -> None:
    mark = Mark("goal", torch.tensor([*goal, math.nan], dtype=torch.float64))
    assert whereabouts(torch.tensor(robot, dtype=torch.float64), mark) == said


def test_the_goal_of_an_episode_is_shown_at_its_pose(page: Page, make_world: Callable[..., World]) -> None:
    driving = Driving(page, make_world("pointnav"))
    for key in ("N", "R"):
        assert driving.press(key)
        goal, now = driving.goals.nodes[0], driving.driver.now
        assert goal.position[:2] == pytest.approx(now["goal"][0, :2].tolist())
        assert math.remainder(2 * math.atan2(goal.wxyz[3], goal.wxyz[0]) - float(now["goal"][0, 2]), math.tau) < 1e-6
        assert tuple(goal.color) == rgb(GOAL)
        rho = float((now["goal"][0, :2] - now["state"][0, :2]).norm())
        assert f"goal {rho:.2f} m, " in driving.status.content
    assert driving.goals.image is None


def test_a_goal_image_is_shown_in_the_panel(page: Page, make_world: Callable[..., World]) -> None:
    driving = Driving(page, make_world("imagenav"))
    assert driving.press("N") and driving.goals.image is not None
    assert np.array_equal(driving.goals.image.image, enlarged(driving.driver.now["imagegoal"][0]))


def test_a_moving_target_is_shown_at_its_position_and_a_task_without_memory_shows_none(
    page: Page, world: World, make_world: Callable[..., World]
) -> None:
    driving = Driving(page, make_world("snake"))
    (apple,), target = driving.goals.nodes, driving.driver.now["target"][0]
    assert apple.position[:2] == pytest.approx(target[:2].tolist()) and "object" in driving.status.content
    plain = Driving(page, world)
    assert plain.goals.nodes == [] and "\n" not in plain.status.content


def test_a_recording_shows_the_goal_that_all_episodes_have_in_common(page: Page, world: World, tmp_path: Path) -> None:
    driving = Driving(page, world, takes=Takes(world, tmp_path, {}), wanted=1)
    (goal,), (mark,) = driving.goals.nodes, world.task.marks()
    assert goal.position[:2] == pytest.approx(mark.planar[:2].tolist())
    assert f"{mark.name} " in driving.status.content
