"""The walk task: a quadruped walks to a mark."""

import math
from typing import Any

import pytest
import torch

from splatrl.collision.nothing import NoChecker
from splatrl.envs.tasks import Outcome, Step, Verdict, Walk
from splatrl.envs.tasks.base import Anywhere
from splatrl.motions import Move, StridesMotion, WalkMotion
from splatrl.motions.physics import FIRST
from splatrl.physics import RouteSettings, Terrain
from tests.envs.test_configured_tasks import ConfiguredContract

NOTHING: Any = NoChecker.__new__(NoChecker)
PLANE = torch.tensor([0.0, 0.0, 1.0, 0.05], dtype=torch.float64)
POST = torch.tensor([[0.0, 0.0, 0.25, 0.2, 0.2, 0.25]], dtype=torch.float64)


@pytest.fixture(autouse=True)
def cache(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SPLATRL_CACHE", str(tmp_path))


def walk(ways: int = 2, test_ways: int = 3, **settings: Any) -> Walk:
    """The task around a post."""
    motion = WalkMotion(path="quadruped", camera="eye", lower=(-2.0, -2.0), upper=(2.0, 2.0), threads=1)
    task = Walk(motion, way=RouteSettings(1, (1.0, 1.5), 0.0, 0.4), ways=ways, test_ways=test_ways, **settings)
    motion.settle(Terrain(PLANE, POST))
    task.settle()
    return task


def judged(task: Walk, before: torch.Tensor, after: torch.Tensor, free: float = 1.0) -> Verdict:
    move = Move(after, task.motion.body_to_world(after), torch.tensor([free]), task.motion.inside(after))
    memory = {"goal": torch.tensor([[1.0, 1.0, 0.0]])}
    return task.judge(Step(before, torch.zeros(1, 2), move, memory, torch.zeros(0)), None)  # type: ignore[arg-type]


def at(task: Walk, x: float, y: float, yaw: float = 0.0) -> torch.Tensor:
    return task.motion.placed(torch.tensor([[x, y, yaw]]))


def test_the_mark_ends_an_episode_and_the_reward_is_progress() -> None:
    task = walk()
    near = judged(task, at(task, 0.4, 1.0), at(task, 0.51, 1.0))
    assert near.outcome.item() == Outcome.GOAL and near.terminated.item()
    assert near.reward.item() == pytest.approx(0.11 + 3.0 - 0.01, abs=1e-5)
    still = judged(task, at(task, 0.4, 1.0), at(task, 0.49, 1.0))
    assert still.outcome.item() == Outcome.RUNNING and not still.terminated.item()
    touched = judged(task, at(task, 0.4, 1.0), at(task, 0.49, 1.0), free=0.5)
    assert still.reward.item() - touched.reward.item() == pytest.approx(0.1, abs=1e-5)


def test_falls_and_leaving_end_an_episode() -> None:
    task = walk()
    lying = at(task, 0.51, 1.0)
    lying[0, FIRST + 2] = 0.15  # 0.1 m above the ground
    assert judged(task, at(task, 0.4, 1.0), lying).outcome.item() == Outcome.COLLISION
    outside = judged(task, at(task, 2.2, 1.0), at(task, 2.31, 1.0))
    assert outside.outcome.item() == Outcome.OUT_OF_BOUNDS and outside.terminated.item()
    assert judged(task, at(task, 2.2, 1.0), at(task, 2.29, 1.0)).outcome.item() == Outcome.RUNNING


def test_a_teacher_walks_the_ways_that_no_one_trained_on() -> None:
    task = walk(ways=1, test_ways=4)
    begun = task.episodes(task.motion.states(), 4, 0)
    state, memory = begun["state"], {"goal": begun["goal"]}
    assert torch.equal(memory["goal"], task.places[1:, 1].float())
    reached = torch.zeros(4, dtype=torch.bool)
    for _ in range(45):
        move = task.motion.move(state, task.teach(state, memory), NOTHING)
        verdict = task.judge(Step(state, torch.zeros(4, 2), move, memory, torch.zeros(0)), None)  # type: ignore[arg-type]
        assert not (verdict.terminated & (verdict.outcome != Outcome.GOAL)).any()
        reached |= (verdict.outcome == Outcome.GOAL).squeeze(1)
        state = move.state
    assert reached.all()


def test_a_mark_that_is_not_seen_is_looked_for_to_the_left() -> None:
    task = walk()
    memory = {"goal": torch.tensor([[1.0, 1.0, 0.0]])}
    for yaw, speed, turn in ((0.0, 0.6, 0.0), (math.pi, 0.0, 0.8), (math.pi / 2, 0.0, 0.8), (0.2, 0.5536, -0.4)):
        action = task.teach(at(task, -1.0, 1.0, yaw), memory)[0].tolist()
        assert action == pytest.approx([speed, turn], abs=1e-3)


def test_robots_begin_at_ways_and_look_anywhere_or_at_their_mark() -> None:
    task = walk(ahead_deg=10.0)
    anywhere = Anywhere(lambda: task.motion.home, torch.Generator().manual_seed(0))
    state = task.start(task.motion.home.expand(64, -1), anywhere)
    goal = task.begin(state, anywhere)["goal"].double()
    planar = task.motion.planar(state)
    away = goal[:, :2] - planar[:, :2]
    off = torch.atan2(away[:, 1], away[:, 0]) - planar[:, 2]
    assert 0.05 < torch.atan2(off.sin(), off.cos()).abs().max() < math.radians(10.0) + 1e-6
    assert len(goal.unique(dim=0)) == 2
    assert (away.norm(dim=1) >= 1.0).all() and (away.norm(dim=1) <= 1.5).all()


def test_the_mark_is_in_the_picture() -> None:
    task = walk()
    parts = task.parts(at(task, 0.0, 1.5), {"goal": torch.tensor([[1.0, 1.0, 0.0]])})
    assert parts.model[0, -1].item() == len(task.models)
    assert parts.model_to_world[0, -1, :3, 3].tolist() == pytest.approx([1.0, 1.0, 0.35])


def test_other_motions_are_refused() -> None:
    with pytest.raises(ValueError, match=r"task\.motion: expected legs that walk, got StridesMotion"):
        Walk(StridesMotion(path="quadruped", camera="eye", threads=1))  # type: ignore[arg-type]


class TestWalk(ConfiguredContract):
    @classmethod
    def overrides(cls) -> tuple[str, ...]:
        return ("walk",)
