"""The drive task."""

import math

import pytest
import torch

from splatrl.envs.tasks import Drive, Outcome
from splatrl.motions import DriveMotion
from tests.envs.rooms import drive_env
from tests.envs.tasks.steps import judged
from tests.tiny import HEIGHT


def drive() -> Drive:
    """Make the drive task with at most 0.1 m and 18° per time step."""
    return Drive(DriveMotion(HEIGHT), (0.5, -0.2, 90.0))


@pytest.mark.parametrize(
    ("state", "there"),
    [
        ((0.6, -0.1, 90.0), True),
        ((0.4, -0.3, 72.0), True),
        ((0.6001, -0.2, 90.0), False),
        ((0.5, -0.3001, 90.0), False),
        ((0.5, -0.2, 108.0), True),
        ((0.5, -0.2, 108.1), False),
        ((0.5, -0.2, 71.9), False),
    ],
)
def test_the_goal_is_as_wide_as_the_longest_step(state: tuple[float, float, float], there: bool) -> None:
    x, y, yaw_deg = state
    assert drive().reached(torch.tensor([[x, y, math.radians(yaw_deg)]])).tolist() == [there]


def test_a_step_is_judged_by_collision_then_bounds_then_goal() -> None:
    east = Drive(DriveMotion(HEIGHT), (1.0, 0.0, 0.0))
    ahead = torch.tensor([[0.95, 0.0, 0.0], [1.05, 0.0, 0.0], [1.05, 0.0, 0.0], [0.0, 0.0, 0.0]])
    assert east.reached(ahead).tolist() == [True, True, True, False]
    verdict = judged(east, ahead, torch.tensor([False, False, True, False]))
    expected = [Outcome.GOAL, Outcome.OUT_OF_BOUNDS, Outcome.COLLISION, Outcome.RUNNING]
    assert verdict.outcome.flatten().tolist() == expected
    assert verdict.reward.flatten().tolist() == pytest.approx([50.0, -10.0, -10.0, -0.2])


def test_a_blocked_robot_keeps_its_position_and_heading() -> None:
    env = drive_env([3])
    td = env.reset()
    td["state"] = torch.tensor([[-0.5, 0.0, 0.0], [0.9, 0.0, 0.0], [-0.75, 1.0, 0.0]])
    action = torch.tensor([[0.5, math.pi / 2], [0.5, 0.0], [0.5, 0.0]])
    after = env.step(td.set("action", action))["next"]
    assert after["outcome"].flatten().tolist() == [Outcome.COLLISION, Outcome.OUT_OF_BOUNDS, Outcome.RUNNING]
    expected = torch.tensor([[-0.5, 0.0, 0.0], [0.9, 0.0, 0.0], [-0.5, 1.0, 0.0]])
    torch.testing.assert_close(after["state"], expected)
    assert after["free_fraction"][0] < 1 and (after["free_fraction"][1:] == 1).all()
