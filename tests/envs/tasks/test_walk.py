"""The walk task: a quadruped walks to a mark."""

import math
from typing import Any

import pytest
import torch

from splatrl.collision.nothing import NoChecker
from splatrl.envs.tasks import Outcome, Step, Verdict, Walk
from splatrl.envs.tasks.base import Anywhere
from splatrl.motions import Move, StridesMotion, WalkMotion
from splatrl.physics import RouteSettings, Terrain
from tests.envs.test_configured_tasks import ConfiguredContract

NOTHING: Any = NoChecker.__new__(NoChecker)
PLANE = torch.tensor([0.0, 0.0, 1.0, 0.05], dtype=torch.float64)
POST = torch.tensor([[0.0, 0.0, 0.25, 0.2, 0.2, 0.25]], dtype=torch.float64)


@pytest.fixture(autouse=True)
def cache(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SPLATRL_CACHE", str(tmp_path))


def walk(courses: int = 2, test_courses: int = 3, **settings: Any) -> Walk:
    """Make the task around a post."""
    motion = WalkMotion(path="quadruped", camera="eye", lower=(-2.0, -2.0), upper=(2.0, 2.0), threads=1)
    way = RouteSettings(waypoints=1, distance=(1.0, 1.5), clearance=0.4)
    task = Walk(motion, course=way, courses=courses, test_courses=test_courses, **settings)
    motion.stand_on(Terrain(PLANE, POST))
    task.generate_courses()
    return task


def anywhere(task: Walk) -> Anywhere:
    return Anywhere(lambda: task.motion.home, torch.Generator().manual_seed(0))


def at(task: Walk, away: float, turned: float = 0.0) -> torch.Tensor:
    """Return a robot [1, n] on the first course, ``away`` metres before its mark, facing ``turned`` radians off it."""
    x, y, _, yaw = task.places[0, 1].tolist()
    return task.motion.placed(torch.tensor([[x - away * math.cos(yaw), y - away * math.sin(yaw), yaw - turned]]))


def judged(task: Walk, before: torch.Tensor, after: torch.Tensor) -> Verdict:
    move = Move(after, task.motion.body_to_world(after), torch.ones(1), task.motion.inside(after))
    memory = task.begin(before, anywhere(task))
    return task.judge(Step(before, torch.zeros(1, 2), move, memory), anywhere(task))


def test_reaching_the_mark_is_a_success() -> None:
    task = walk()
    near = judged(task, at(task, 0.6), at(task, 0.49))
    assert near.outcome.item() == Outcome.GOAL and near.terminated.item() and task.goals_for_success == 1
    assert judged(task, at(task, 0.6), at(task, 0.51)).outcome.item() == Outcome.RUNNING


def test_a_fall_ends_an_episode_even_at_the_mark() -> None:
    task = walk()
    lying = at(task, 0.4)
    lying[0, task.motion.layout.position][2] = 0.15  # 0.1 m above the ground
    fallen = judged(task, at(task, 0.6), lying)
    assert fallen.outcome.item() == Outcome.COLLISION and fallen.terminated.item()


def test_the_teacher_finishes_the_test_courses() -> None:
    task = walk(courses=1, test_courses=4)
    begun = task.episodes(task.motion.states(), 4, 0)
    state, memory = begun["state"], {key: begun[key] for key in task.memory_spec}
    reached = torch.zeros(4, dtype=torch.bool)
    for _ in range(45):
        move = task.motion.move(state, task.teach(state, memory), NOTHING)
        verdict = task.judge(Step(state, torch.zeros(4, 2), move, memory), anywhere(task))
        reached |= (verdict.outcome == Outcome.GOAL).squeeze(1)
        assert not (verdict.terminated.squeeze(1) & ~reached).any()
        if reached.all():
            break
        state = move.state
    assert reached.all()


def test_the_teacher_turns_left_to_look_for_a_mark_out_of_view() -> None:
    task = walk()
    memory = task.begin(at(task, 1.0), anywhere(task))
    for turned, speed, turn in ((0.0, 0.6, 0.0), (math.pi, 0.0, 0.8), (-1.5, 0.0, 0.8), (-0.2, 0.5536, -0.4)):
        action = task.teach(at(task, 1.0, turned), memory)[0].tolist()
        assert action == pytest.approx([speed, turn], abs=1e-3)


def test_robots_begin_on_courses_facing_at_most_the_requested_angle_off_their_mark() -> None:
    task = walk(ahead_deg=10.0)
    state = task.start(task.motion.home.expand(64, -1), anywhere(task))
    planar, place = task.motion.planar(state), task.begin(state, anywhere(task))["next_place"].double()
    away = place[:, :2] - planar[:, :2]
    off = torch.atan2(away[:, 1], away[:, 0]) - planar[:, 2]
    assert 0.05 < torch.atan2(off.sin(), off.cos()).abs().max() < math.radians(10.0) + 1e-6
    assert (away.norm(dim=1) >= 1.0 - 1e-6).all() and (away.norm(dim=1) <= 1.5 + 1e-6).all()
    assert set(state[:, 0].tolist()) == {0.0, 1.0}


def test_other_motions_are_refused() -> None:
    with pytest.raises(ValueError, match=r"task\.motion: expected a legged robot that walks, got StridesMotion"):
        Walk(StridesMotion(path="quadruped", camera="eye", threads=1))  # type: ignore[arg-type]


class TestWalk(ConfiguredContract):
    @classmethod
    def overrides(cls) -> tuple[str, ...]:
        return ("walk",)
