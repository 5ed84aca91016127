"""Videos of a training show physics in real time, and no more episodes than fit into a limited number of frames."""

import pytest

from splatrl.evaluation.pictures import shown, steps_a_second
from splatrl.motions import PhysicsMotion
from tests.tiny import tiny_motion


def test_robots_with_physics_are_shown_in_real_time_and_others_at_a_fixed_pace() -> None:
    pytest.importorskip("mujoco")
    speeds = [steps_a_second(PhysicsMotion("wheels", "eye", time_step=time, threads=1)) for time in (0.1, 0.2)]
    assert speeds == [10, 5] and steps_a_second(tiny_motion()) == 6


def test_a_video_shows_fewer_episodes_if_all_would_not_fit_at_the_longest_length() -> None:
    assert shown([5, 5, 5, 5], 400) == [0, 1, 2, 3]
    assert shown([200, 3, 2, 200], 400) == [1, 3]
    assert shown([200, 200, 200, 3], 10) == [3]  # the last one, in full
