"""The strides task: a quadruped follows commands without vision."""

from typing import Any

import pytest
import torch

from splatrl.collision.nothing import NoChecker
from splatrl.envs.tasks import Outcome, Step, Strides, Verdict
from splatrl.envs.tasks.base import Anywhere
from splatrl.motions import Move, StridesMotion, WalkMotion
from splatrl.motions.legs import JOINTS
from tests.envs.test_configured_tasks import ConfiguredContract

NOTHING: Any = NoChecker.__new__(NoChecker)


def task(**settings: Any) -> Strides:
    """Make a task with two commands of 0.1 s each."""
    return Strides(StridesMotion(path="quadruped", camera="eye", threads=1, commands=2, span=0.1), **settings)


def begun(of: Strides, count: int = 1) -> torch.Tensor:
    return of.start(
        of.motion.home.expand(count, -1), Anywhere(lambda: of.motion.home, torch.Generator().manual_seed(0))
    )


def judged(of: Strides, before: torch.Tensor, after: torch.Tensor, strides: int = 0, error: float = 0.0) -> Verdict:
    move = Move(after, of.motion.body_to_world(after), torch.ones(1), of.motion.inside(after))
    memory = {"strides": torch.tensor([[strides]]), "error": torch.tensor([[error]])}
    return of.judge(Step(before, torch.zeros(1, JOINTS), move, memory), None)  # type: ignore[arg-type]


def moving(of: Strides, ahead: float, aside: float, turn: float) -> torch.Tensor:
    """Return an upright, moving robot [1, n] that is commanded to go 0.5 m/s ahead and turn at 0.3 rad/s."""
    state = of.motion.commanded(of.motion.placed(torch.tensor([[0.0, 0.0, 0.7]])), torch.tensor([[0.5, 0.3] * 2]))
    yaw, velocity = torch.tensor(0.7).double(), state[0, of.motion.layout.velocity]
    velocity[0] = ahead * yaw.cos() - aside * yaw.sin()
    velocity[1] = ahead * yaw.sin() + aside * yaw.cos()
    state[0, of.motion.layout.angular_velocity][2] = turn
    return state


def test_the_reward_is_highest_for_the_commanded_velocity() -> None:
    of = task()
    right = moving(of, 0.5, 0.0, 0.3)
    assert judged(of, right, right).reward.item() == pytest.approx(1.5)
    for wrong in ((0.2, 0.0, 0.3), (0.5, 0.3, 0.3), (0.5, 0.0, -0.3)):
        assert judged(of, right, moving(of, *wrong)).reward.item() < 1.3
    told = right.clone()
    told[:, of.motion.physics.size : of.motion.physics.size + JOINTS] = 0.5
    expected = 1.5 - 0.02 * 12 * 0.25 - 0.01 * 12 * 0.25
    assert judged(of, right, told).reward.item() == pytest.approx(expected)


def test_a_fall_ends_an_episode_with_a_penalty() -> None:
    of = task()
    for change in ({2: 0.1}, {3: 0.3, 4: 0.954}):
        lying = of.motion.placed(torch.zeros(1, 3))
        for column, value in change.items():
            lying[0, of.motion.layout.pose][column] = value
        verdict = judged(of, lying, lying)
        assert verdict.terminated.item() and verdict.outcome.item() == Outcome.COLLISION
        assert verdict.reward.item() == pytest.approx(-5.0)


def test_success_is_decided_after_the_last_command_by_the_mean_error() -> None:
    of = task()
    off = moving(of, 0.5, 0.4, 0.3)
    assert of.max_steps == 10
    assert not judged(of, off, off, strides=8).terminated.item()
    assert judged(of, off, off, strides=9, error=1.6 - 0.01).outcome.item() == Outcome.GOAL
    late = judged(of, off, off, strides=9, error=1.6 + 0.01)
    assert late.outcome.item() == Outcome.RUNNING and not late.terminated.item()  # the env truncates it
    assert late.memory["error"].item() == pytest.approx(2.01, abs=1e-4) and late.memory["strides"].item() == 10


def test_episodes_begin_perturbed_at_any_phase_of_the_trot_with_commands_in_range() -> None:
    of = task(forward=(0.3, 0.6), shaken=0.05)
    states = begun(of, 200)
    commands = states[:, -4:].view(-1, 2, 2)
    assert commands[..., 0].min() >= 0.3 and commands[..., 0].max() <= 0.6 and commands[..., 1].abs().max() <= 0.8
    assert commands[..., 0].std() > 0.05 and not torch.equal(commands[:, 0], commands[:, 1])
    phase, off = of.motion.trot_time(states), (states - of.motion.home)[:, of.motion.layout.joints].abs()
    assert 0.04 < off.max() <= 0.05
    assert 0.25 < phase.max() < 1 / 3 and phase.min() < 0.1
    assert not of.motion.fallen(states).any()


def test_commands_follow_one_another_in_time() -> None:
    of = task()
    state = of.motion.commanded(of.motion.placed(torch.zeros(3, 3)), torch.tensor([[0.1, 0.2, 0.3, 0.4]] * 3))
    state[:, 1] = torch.tensor([0.0, 0.15, 9.0])
    assert torch.allclose(of.motion.command(state), torch.tensor([[0.1, 0.2], [0.3, 0.4], [0.3, 0.4]]).double())


def test_each_command_lasts_its_span_from_the_start_of_the_episode() -> None:
    of = Strides(StridesMotion(path="quadruped", camera="eye", threads=1, commands=2, span=0.2))
    state = begun(of, 256)
    commands = state[:, -4:].unflatten(1, (2, 2))
    assert torch.equal(of.motion.command(state), commands[:, 0])
    state = state[:1]
    for stride in range(11):
        assert torch.equal(of.motion.command(state), commands[:1, stride // 10]), stride
        state = of.motion.move(state, torch.zeros(1, JOINTS), NOTHING).state


def test_other_motions_are_refused() -> None:
    with pytest.raises(
        ValueError,
        match=r"task\.motion: expected legs controlled joint by joint, got WalkMotion; type motion@task.motion=strides",
    ):
        Strides(WalkMotion(path="quadruped", camera="eye", gait=None, threads=1))  # type: ignore[arg-type]


class TestStrides(ConfiguredContract):
    limit = ()  # its episodes end with their commands
    steps = 22

    @classmethod
    def overrides(cls) -> tuple[str, ...]:
        return ("strides",)
