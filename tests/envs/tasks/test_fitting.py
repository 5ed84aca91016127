"""Motions and rewards that do not fit their task."""

import pytest
from hydra.errors import InstantiationException
from hydra.utils import instantiate

from splatrl.configuration import load_config
from splatrl.envs.tasks import OutcomeTask, Rewards

OUTCOMES = r"a reward for each outcome, got {}; type rewards@task.rewards=published or rewards@task.rewards=unit"


@pytest.mark.parametrize(
    ("task", "rewards", "message"),
    [
        ("grid", "push", OUTCOMES.format("PushRewards")),
        ("circle", "navigation", OUTCOMES.format("NavigationRewards")),
        ("snake", "course", OUTCOMES.format("CourseRewards")),
        ("pointnav", "unit", "the rewards of navigation, got Rewards; type rewards@task.rewards=navigation"),
        ("push", "published", "the rewards of pushing, got Rewards; type rewards@task.rewards=push"),
        ("gates", "strides", "the rewards of a course, got StridesRewards; type rewards@task.rewards=course"),
        ("strides", "course", "the rewards of strides, got CourseRewards; type rewards@task.rewards=strides"),
    ],
)
def test_rewards_of_another_kind_are_refused_with_those_that_fit(task: str, rewards: str, message: str) -> None:
    cfg = load_config([f"task={task}", f"rewards@task.rewards={rewards}"])
    with pytest.raises(InstantiationException) as refused:
        instantiate(cfg.task)
    assert str(refused.value.__cause__) == f"task.rewards: expected {message}"


def test_the_reward_of_each_outcome_is_that_of_its_name() -> None:
    task = instantiate(load_config(["task=grid"]).task, rewards=Rewards(4.0, 3.0, 2.0, 1.0))
    assert isinstance(task, OutcomeTask) and task.outcome_rewards.tolist() == [4.0, 3.0, 2.0, 1.0]
