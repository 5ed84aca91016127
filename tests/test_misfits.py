"""Goals that no robot can reach."""

import pytest
from hydra.utils import instantiate

from splatrl.configuration import load_config
from splatrl.misfits import check_goal


def test_a_goal_among_the_robots_that_none_reaches_is_not_said_to_lie_outside() -> None:
    task = instantiate(load_config(["motion@task.motion=orbit"]).task)
    with pytest.raises(ValueError) as refused:
        check_goal(task, task.reached(task.motion.states()))
    assert str(refused.value) == (
        "task.goal: expected a pose that robots can reach, got [0.6, 0.4]; type another landmarks.goal, or another "
        "motion@task.motion"
    )
