"""The route task, and the car that drives it."""

import math
from pathlib import Path

import pytest
import torch
from tensordict import TensorDict

from splatrl.building import build_one_world
from splatrl.building.misfits import check_height
from splatrl.configuration import load_config
from splatrl.envs.tasks import Outcome, Route
from splatrl.envs.teachers.chauffeur import drive_to
from splatrl.motions import PhysicsMotion
from splatrl.physics import RouteSettings, Terrain
from tests.envs.tasks.courses import NOTHING, PLANE, CourseContract, cache, judged, wander
from tests.envs.test_configured_tasks import ConfiguredContract
from tests.tiny import bare_site, tiny_overrides

__all__ = ["cache"]

POST = torch.tensor([[0.0, 0.0, 0.25, 0.2, 0.2, 0.25]], dtype=torch.float64)


def car(terrain: Terrain | None = None) -> PhysicsMotion:
    motion = PhysicsMotion(
        "car", "eye", linear=(-0.5, 1.0), angular_deg=90.0, lower=(-2.0, -2.0), upper=(2.0, 2.0), threads=1
    )
    if terrain is not None:
        motion.stand_on(terrain)
    return motion


def route(courses: int = 2, test_courses: int = 3, motion: PhysicsMotion | None = None) -> Route:
    """Make the task around a post, with routes of three waypoints."""
    chosen = RouteSettings(waypoints=3)
    motion = motion or car()
    motion.stand_on(Terrain(PLANE, POST))
    task = Route(motion, course=chosen, courses=courses, test_courses=test_courses)
    task.generate_courses()
    return task


def at(task: Route, number: int, waypoint: int, away: float) -> torch.Tensor:
    """Return a car's state [1, n] on a route, ``away`` metres before a waypoint; waypoint 0 is the first."""
    x, y, _, yaw = task.places[number, 1 + waypoint].tolist()
    state = task.motion.placed(torch.tensor([[x - away * math.cos(yaw), y - away * math.sin(yaw), yaw]]).double())
    state[0, 0] = number
    return state


@pytest.mark.parametrize("steering", [0.4, 0.2, -0.4])
def test_a_car_turns_on_the_circle_given_by_its_steering_angle(steering: float) -> None:
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


def test_a_car_without_a_command_stands_still_on_its_springs() -> None:
    motion = car()
    state = motion.placed(torch.tensor([[0.3, -0.2, 1.0]]))
    for _ in range(20):
        state = motion.move(state, torch.zeros(1, 2), NOTHING).state
    assert motion.planar(state)[0].tolist() == pytest.approx([0.3, -0.2, 1.0], abs=0.01)
    assert state[0, motion.layout.position][2].item() == pytest.approx(0.2, abs=0.01)


def test_waypoints_count_only_in_order_and_the_last_one_ends_the_episode() -> None:
    task = route()
    near = judged(task, at(task, 1, 0, 0.4), at(task, 1, 0, 0.19))
    assert near.outcome.item() == Outcome.GOAL and near.memory["passed"].item() == 1 and not near.terminated.item()
    assert near.memory["next_place"][0, :2].tolist() == pytest.approx(task.places[1, 2, :2].tolist())
    assert judged(task, at(task, 1, 0, 0.4), at(task, 1, 0, 0.21)).outcome.item() == Outcome.RUNNING
    early = judged(task, at(task, 1, 2, 0.4), at(task, 1, 2, 0.1), passed=0)
    assert early.memory["passed"].item() == 0
    last = judged(task, at(task, 1, 2, 0.4), at(task, 1, 2, 0.1), passed=2)
    assert last.outcome.item() == Outcome.GOAL and last.terminated.item()
    assert task.goals_for_success == 3


def test_touching_and_leaving_end_an_episode_and_reach_no_waypoint() -> None:
    task = route()
    crash = judged(task, at(task, 0, 0, 0.3), at(task, 0, 0, 0.0), free=0.9)
    assert crash.outcome.item() == Outcome.COLLISION and crash.terminated.item() and crash.memory["passed"].item() == 0
    for x, outcome in ((2.05, Outcome.RUNNING), (2.15, Outcome.OUT_OF_BOUNDS)):
        state = at(task, 0, 0, 0.5)
        state[0, task.motion.layout.position][0] = x
        assert judged(task, state, state).outcome.item() == outcome


def test_a_motion_settles_knowing_the_leeway_and_that_courses_are_variants(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    task, told = Route(car(), courses=1, test_courses=1, leeway=0.4), []
    monkeypatch.setattr(task.motion, "settle", lambda site, fits: told.append(site) or fits)
    site = bare_site()
    task.settle(site, lambda poses: torch.ones(len(poses)).bool())
    assert site.leeway == 0.0 and [(each.leeway, each.varies) for each in told] == [(0.4, False)]


def test_nobody_is_told_to_change_the_height_of_a_car(tmp_path: Path) -> None:
    task = route()
    assert task.ways_out == "try another landmarks.goal, or a smaller robot.body"
    bottom = ((-1.0, -1.0, 0.5), (1.0, 1.0, 2.0))
    with pytest.raises(ValueError, match=r"scene\.bounds: expected a bottom below the robot, at 0\.25 m, got 0\.5 m"):
        check_height(bottom, task)
    wide = ["robot=wheels", "robot.body.size=[3.0,3.0,0.3]", "motion@task.motion=physics"]
    with pytest.raises(
        ValueError, match=r"expected free poses.*; try another landmarks\.goal, or a smaller robot\.body"
    ):
        build_one_world(load_config([*tiny_overrides(tmp_path, "drive"), *wide]))


def test_the_reward_is_progress_plus_a_bonus_per_waypoint() -> None:
    task = route()
    nearer = judged(task, at(task, 0, 0, 0.6), at(task, 0, 0, 0.5))
    assert nearer.reward.item() == pytest.approx(0.1 - 0.01, abs=1e-6)
    reached = judged(task, at(task, 0, 0, 0.3), at(task, 0, 0, 0.1))
    assert reached.reward.item() == pytest.approx(0.3 + 1.0 - 0.01, abs=1e-6)


def test_two_waypoints_are_shown_and_none_after_the_last() -> None:
    task = route()
    state = at(task, 1, 0, 0.5)
    own = len(task.motion.models)
    parts = task.parts(state, {"passed": torch.tensor([[1]])})
    assert parts.model[0, -2:].tolist() == [own + 1, own + 2]
    for part, waypoint in ((-2, 2), (-1, 3)):
        assert parts.model_to_world[0, part, :2, 3].tolist() == pytest.approx(task.places[1, waypoint, :2].tolist())
    assert task.parts(state, {"passed": torch.tensor([[2]])}).model[0, -2:].tolist() == [own + 1, -1]


def test_a_robot_with_other_actions_is_refused() -> None:
    motion = PhysicsMotion("quadrotor", "eye", linear=(-1.0, 1.0), angular_deg=90.0, threads=1)
    with pytest.raises(
        ValueError, match=r"task\.motion: expected two actions, speed and steering angle or turn rate, got 4"
    ):
        Route(motion)


def test_a_car_that_only_drives_ahead_finishes_no_route() -> None:
    assert wander(route(), 60, (0.7, 0.0)).max() < 3


class TestRoute(ConfiguredContract, CourseContract):
    taught = 120

    @classmethod
    def overrides(cls) -> tuple[str, ...]:
        return ("route",)

    def course(self, courses: int = 2, test_courses: int = 3) -> Route:
        return route(courses, test_courses)

    def test_an_episode_that_begins_with_places_passed_succeeds_at_the_last(self) -> None:
        env, task = self.make((1,)), self.world.task
        state = at(task, 0, 1, 0.22)
        now = env.reset(TensorDict({"state": state, "passed": torch.tensor([[1]])}, [1]), set_state=True)
        assert now["goals"].item() == 1 and not now["success"].item()
        for _ in range(4):
            after = env.step(now.set("action", torch.tensor([[1.0, 0.0]])))["next"]
            now = after.clone()
            if after["terminated"]:
                break
        assert after["outcome"].item() == Outcome.GOAL and after["goals"].item() == 2 and after["success"].item()


def test_a_robot_that_turns_on_the_spot_is_taught_turn_rates() -> None:
    robot, goal = torch.zeros(2, 3).double(), torch.tensor([[0.3, 0.1], [-0.3, 0.1]]).double()
    limits = torch.tensor([[-0.25, -1.5], [0.5, 1.5]])
    ahead, behind = drive_to(robot, robot[:, :2], goal, None, limits)
    assert (ahead[1] / ahead[0]).item() == pytest.approx(2 * 0.1 / (0.3**2 + 0.1**2))  # of the circle through the goal
    assert behind.tolist() == [0.0, 1.5]
    motion = PhysicsMotion("wheels", "eye", lower=(-2.0, -2.0), upper=(2.0, 2.0), threads=1)
    task = route(motion=motion)
    last, goal = task.places[:1, :2].unbind(1)
    x, y, _, yaw = goal[0].tolist()
    state = motion.placed(torch.tensor([[x - math.cos(yaw), y - math.sin(yaw), yaw + 0.4]]).double())
    rates = drive_to(motion.planar(state), last[:, :2], goal[:, :2], None, motion.limits)
    assert torch.equal(task.teach(state, {"passed": torch.tensor([[0]])}), rates)


def test_routes_are_drawn_on_level_ground_too(tmp_path: Path) -> None:
    world = build_one_world(load_config([*tiny_overrides(tmp_path, "route"), "task.motion.ground=level"]))
    assert world.env(2).rollout(2)["next", "reward"].shape[0] == 2
    steps = world.task.places.diff(dim=1)[..., :2].norm(dim=-1)
    assert (steps > 0).all()
