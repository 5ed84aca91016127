"""Videos of a training show robots as fast as they are, and as many episodes as somebody waits for."""

import pytest

from splatrl.evaluation.pictures import shown, steps_a_second
from splatrl.motions import PhysicsMotion
from tests.tiny import tiny_motion


def test_robots_with_physics_are_shown_as_fast_as_they_are_and_others_at_a_pace_to_follow() -> None:
    pytest.importorskip("mujoco")
    speeds = [steps_a_second(PhysicsMotion("wheels", "eye", time_step=time, threads=1)) for time in (0.1, 0.2)]
    assert speeds == [10, 5] and steps_a_second(tiny_motion()) == 6


def test_long_episodes_are_shown_in_part_whether_or_not_they_end_early() -> None:
    assert shown([5, 5, 5, 5], 400) == [0, 1, 2, 3]
    assert shown([200, 3, 2, 200], 400) == [1, 3]
    assert shown([200, 200, 200, 3], 10) == [3]  # the farthest, to its end
