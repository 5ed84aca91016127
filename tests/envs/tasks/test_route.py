"""The route task, and the car that drives it."""

import math
from typing import Any

import pytest
import torch

from splatrl.collision.nothing import NoChecker
from splatrl.envs.tasks import Outcome, Route, Step, Verdict
from splatrl.envs.tasks.base import Anywhere
from splatrl.motions import Move, PhysicsMotion
from splatrl.motions.physics import FIRST
from splatrl.physics import RouteSettings, Terrain
from tests.envs.test_configured_tasks import ConfiguredContract

NOTHING: Any = NoChecker.__new__(NoChecker)
PLANE = torch.tensor([0.0, 0.0, 1.0, 0.05], dtype=torch.float64)
POST = torch.tensor([[0.0, 0.0, 0.25, 0.2, 0.2, 0.25]], dtype=torch.float64)


@pytest.fixture(autouse=True)
def cache(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SPLATRL_CACHE", str(tmp_path))


def car(terrain: Terrain | None = None) -> PhysicsMotion:
    motion = PhysicsMotion(
        "car", "eye", linear=(-0.5, 1.0), angular_deg=90.0, lower=(-2.0, -2.0), upper=(2.0, 2.0), threads=1
    )
    if terrain is not None:
        motion.settle(terrain)
    return motion


def route(routes: int = 2, test_routes: int = 3, **settings: Any) -> Route:
    """The task around a post, with routes of three waypoints."""
    chosen = RouteSettings(waypoints=3)
    task = Route(car(Terrain(PLANE, POST)), route=chosen, routes=routes, test_routes=test_routes, **settings)
    task.settle()
    return task


def anywhere(task: Route, count: int = 1) -> Anywhere:
    return Anywhere(lambda: task.motion.home.expand(count, -1), torch.Generator().manual_seed(0))


def at(task: Route, number: int, waypoint: int, away: float) -> torch.Tensor:
    """A car [1, n] on a route, ``away`` metres before a waypoint along its way; 0 is the first."""
    x, y, yaw = task.places[number, 1 + waypoint].tolist()
    state = task.motion.placed(torch.tensor([[x - away * math.cos(yaw), y - away * math.sin(yaw), yaw]]).double())
    state[0, 0] = number
    return state


def judged(task: Route, before: torch.Tensor, after: torch.Tensor, passed: int = 0, free: float = 1.0) -> Verdict:
    move = Move(after, task.motion.body_to_world(after), torch.tensor([free]), task.motion.inside(after))
    memory = {"passed": torch.tensor([[passed]]), "waypoint": torch.zeros(1, 3)}
    return task.judge(Step(before, torch.zeros(1, 2), move, memory, torch.zeros(0)), anywhere(task))


@pytest.mark.parametrize("steering", [0.4, 0.2, -0.4])
def test_a_car_turns_on_the_circle_of_its_steering(steering: float) -> None:
    motion = car()
    state, poses = motion.placed(torch.zeros(1, 3)), []
    for _ in range(60):
        state = motion.move(state, torch.tensor([[0.5, steering]]), NOTHING).state
        poses.append(motion.planar(state)[0])
    way = torch.stack(poses[30:])
    step = way.diff(dim=0)
    turn = torch.atan2(step[:, 2].sin(), step[:, 2].cos()).sum()
    radius = step[:, :2].norm(dim=1).sum() / turn.abs()
    assert turn * steering > 0
    assert radius.item() == pytest.approx(0.22 / math.tan(abs(steering)), rel=0.12)  # tyres slip a little


def test_a_car_that_is_told_nothing_stands_and_its_springs_hold_it() -> None:
    motion = car()
    state = motion.placed(torch.tensor([[0.3, -0.2, 1.0]]))
    for _ in range(20):
        state = motion.move(state, torch.zeros(1, 2), NOTHING).state
    assert motion.planar(state)[0].tolist() == pytest.approx([0.3, -0.2, 1.0], abs=0.01)
    assert state[0, FIRST + 2].item() == pytest.approx(0.2, abs=0.01)


def test_waypoints_count_in_their_order_and_the_last_one_ends_the_episode() -> None:
    task = route()
    near = judged(task, at(task, 1, 0, 0.4), at(task, 1, 0, 0.19))
    assert near.outcome.item() == Outcome.GOAL and near.memory["passed"].item() == 1 and not near.terminated.item()
    assert near.memory["waypoint"][0, :2].tolist() == pytest.approx(task.places[1, 2, :2].tolist())
    assert judged(task, at(task, 1, 0, 0.4), at(task, 1, 0, 0.21)).outcome.item() == Outcome.RUNNING
    early = judged(task, at(task, 1, 2, 0.4), at(task, 1, 2, 0.1), passed=0)
    assert early.memory["passed"].item() == 0
    last = judged(task, at(task, 1, 2, 0.4), at(task, 1, 2, 0.1), passed=2)
    assert last.outcome.item() == Outcome.GOAL and last.terminated.item()
    assert task.goals_for_success == 3


def test_touching_and_leaving_end_an_episode_and_reach_nothing() -> None:
    task = route()
    crash = judged(task, at(task, 0, 0, 0.3), at(task, 0, 0, 0.0), free=0.9)
    assert crash.outcome.item() == Outcome.COLLISION and crash.terminated.item() and crash.memory["passed"].item() == 0
    for x, outcome in ((2.05, Outcome.RUNNING), (2.15, Outcome.OUT_OF_BOUNDS)):
        state = at(task, 0, 0, 0.5)
        state[0, FIRST] = x
        assert judged(task, state, state).outcome.item() == outcome


def test_reward_is_progress_and_waypoints() -> None:
    task = route()
    nearer = judged(task, at(task, 0, 0, 0.6), at(task, 0, 0, 0.5))
    assert nearer.reward.item() == pytest.approx(0.1 - 0.01, abs=1e-6)
    reached = judged(task, at(task, 0, 0, 0.3), at(task, 0, 0, 0.1))
    assert reached.reward.item() == pytest.approx(0.2 + 1.0 - 0.01, abs=1e-6)


def test_a_driver_that_knows_the_state_finishes_routes_that_no_one_trained_on() -> None:
    task = route(routes=1, test_routes=6)
    begun = task.episodes(task.motion.states(), 6, 0)
    state, memory = begun["state"], {key: begun[key] for key in task.memory_spec}
    assert state[:, 0].tolist() == [1, 2, 3, 4, 5, 6]
    outcomes: dict[int, int] = {}
    for _ in range(120):
        action = task.teach(state, memory)
        move = task.motion.move(state, action, NOTHING)
        verdict = task.judge(Step(state, action, move, memory, torch.zeros(0)), anywhere(task, 6))
        for row in verdict.terminated.squeeze(1).nonzero().flatten().tolist():
            outcomes.setdefault(row, int(verdict.outcome[row]))
        state, memory = move.state, dict(verdict.memory)
    assert outcomes == dict.fromkeys(range(6), int(Outcome.GOAL))


def test_a_car_that_drives_ahead_finishes_nothing() -> None:
    task = route(routes=6)
    state = task.start(task.motion.home.expand(6, -1), anywhere(task, 6))
    memory = task.begin(state, anywhere(task, 6))
    for _ in range(60):
        move = task.motion.move(state, torch.tensor([[0.7, 0.0]]).expand(6, 2), NOTHING)
        memory = task.judge(Step(state, torch.zeros(6, 2), move, memory, torch.zeros(0)), anywhere(task, 6)).memory
        state = move.state
    assert memory["passed"].max() < 3


def test_two_waypoints_are_shown_and_none_after_the_last() -> None:
    task = route()
    state = at(task, 1, 0, 0.5)
    own = len(task.motion.models)
    parts = task.parts(state, {"passed": torch.tensor([[1]])})
    assert parts.model[0, -2:].tolist() == [own + 1, own + 2]
    for part, waypoint in ((-2, 2), (-1, 3)):
        assert parts.model_to_world[0, part, :2, 3].tolist() == pytest.approx(task.places[1, waypoint, :2].tolist())
    assert task.parts(state, {"passed": torch.tensor([[2]])}).model[0, -2:].tolist() == [own + 1, -1]


def test_training_and_tests_drive_different_routes() -> None:
    task = route(routes=2, test_routes=3)
    driven = task.start(task.motion.home.expand(64, -1), anywhere(task, 64))[:, 0]
    assert set(driven.tolist()) == {0.0, 1.0}
    assert set(task.episodes(task.motion.states(), 9, 0)["state"][:, 0].tolist()) == {2.0, 3.0, 4.0}


def test_a_robot_with_other_actions_is_refused() -> None:
    motion = PhysicsMotion("quadrotor", "eye", linear=(-1.0, 1.0), angular_deg=90.0, threads=1)
    with pytest.raises(ValueError, match=r"task\.motion: expected a speed and a steering angle, got 4 actions"):
        Route(motion)


class TestRoute(ConfiguredContract):
    @classmethod
    def overrides(cls) -> tuple[str, ...]:
        return ("route",)
