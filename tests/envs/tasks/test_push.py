"""The push task."""

import math
from itertools import pairwise
from typing import Any

import pytest
import torch
from hydra.utils import instantiate

from splatrl.collision.nothing import NoChecker
from splatrl.configuration import load_config
from splatrl.envs.drawing import Shot
from splatrl.envs.tasks import Outcome, Push, PushRewards, Step, Verdict
from splatrl.envs.tasks.base import Anywhere
from splatrl.envs.teachers.pusher import pushing
from splatrl.geometry import planar_of
from splatrl.motions import DriveMotion, Move, PhysicsMotion
from splatrl.physics import Terrain
from splatrl.training import actor_critic
from splatrl.training.dagger import visited
from splatrl.training.learner import Learner
from splatrl.training.settings import LossSettings, OptimSettings
from tests.envs.contract import base_env
from tests.envs.test_configured_tasks import ConfiguredContract

MARK = (0.5, 0.5)


def push(**settings: Any) -> Push:
    """Make the task on level ground."""
    motion = PhysicsMotion("wheels", "eye", {"ball": "ball"}, ["ball"], threads=1)
    return Push(motion, **settings)


def states(task: Push, robot: tuple[float, float, float], ball: tuple[float, float]) -> torch.Tensor:
    """Return one state with the robot and the ball at the given places."""
    state = task.motion.placed(torch.tensor([robot]))
    state[:, task.ball.start : task.ball.start + 2] = torch.tensor([ball], dtype=torch.float64)
    return state


def judged(task: Push, before: torch.Tensor, after: torch.Tensor, free: float = 1.0) -> Verdict:
    """Return the verdict on robots and balls that went from one state to another."""
    move = Move(after, task.motion.body_to_world(after), torch.full((len(after),), free), task.motion.inside(after))
    memory = {"mark": torch.tensor([[*MARK, 0.02]]).expand(len(after), 3), "ball": before[:, task.ball][:, :3].float()}
    return task.judge(Step(before, torch.zeros(len(after), 2), move, memory), None)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("ball", "outcome"),
    [
        ((0.5, 0.36), Outcome.GOAL),
        ((0.4, 0.4), Outcome.GOAL),
        ((0.5, 0.34), Outcome.RUNNING),
        ((0.39, 0.39), Outcome.RUNNING),
        ((0.0, 1.51), Outcome.OUT_OF_BOUNDS),
        ((0.0, 1.49), Outcome.RUNNING),
    ],
)
def test_the_position_of_the_ball_decides_the_outcome(ball: tuple[float, float], outcome: Outcome) -> None:
    task = push()
    here = states(task, (0.0, 0.0, 0.0), ball)
    verdict = judged(task, here, here)
    assert verdict.outcome.item() == outcome
    assert verdict.terminated.item() == (outcome != Outcome.RUNNING)
    assert verdict.memory["ball"][0, :2].tolist() == pytest.approx(ball)


def test_a_robot_that_leaves_is_out_of_bounds_and_one_that_touches_something_goes_on() -> None:
    task = push()
    away, here = states(task, (1.51, 0.0, 0.0), (0.0, 0.0)), states(task, (-0.5, -0.5, 0.0), (0.0, 0.0))
    assert judged(task, away, away).outcome.item() == Outcome.OUT_OF_BOUNDS
    touching = judged(task, here, here, free=0.5)
    assert touching.outcome.item() == Outcome.RUNNING and not touching.terminated.item()
    assert touching.reward.item() == pytest.approx(-0.03)


def test_the_reward_is_the_sum_of_its_terms() -> None:
    task = push(rewards=PushRewards(progress=2.0, approach=0.0, touch=0.0, slack=-0.01, success=3.0, lost=-1.0))
    robot = (-0.5, 0.5, 0.0)
    nearer = judged(task, states(task, robot, (0.0, 0.5)), states(task, robot, (0.1, 0.5)))
    assert nearer.reward.item() == pytest.approx(2.0 * 0.1 - 0.01)
    there = judged(task, states(task, robot, (0.3, 0.5)), states(task, robot, (0.4, 0.5)))
    assert there.reward.item() == pytest.approx(2.0 * 0.1 - 0.01 + 3.0)
    lost = judged(task, states(task, robot, (-0.5, 0.5)), states(task, robot, (-1.6, 0.5)))
    assert lost.reward.item() == pytest.approx(2.0 * -1.1 - 0.01 - 1.0)


def test_going_round_the_ball_to_its_far_side_is_rewarded_as_an_approach() -> None:
    task = push(rewards=PushRewards(progress=0.0, approach=1.0, touch=0.0, slack=0.0))
    ball, angles = (0.0, 0.5), torch.linspace(0.0, math.pi, 5).tolist()
    ring = [states(task, (0.3 * math.cos(a), 0.5 + 0.3 * math.sin(a), 0.0), ball) for a in angles]
    rewards = [judged(task, here, there).reward.item() for here, there in pairwise(ring)]
    assert min(rewards) > 0 and sum(rewards) == pytest.approx(0.5)
    back = [judged(task, there, here).reward.item() for here, there in pairwise(ring)]
    assert sum(rewards) + sum(back) == pytest.approx(0.0, abs=1e-6), "there is nothing to gain by going to and fro"
    far, near = states(task, (-0.9, 0.5, 0.0), ball), states(task, (-0.6, 0.5, 0.0), ball)
    assert judged(task, far, near).reward.item() == pytest.approx(0.3)


def test_balls_and_marks_begin_within_the_requested_ranges() -> None:
    task = push(nearest=0.5, farthest=0.9, apart=0.4, ahead_deg=40.0, turn_deg=60.0)
    wall = torch.tensor([[0.0, 0.0, 0.2, 0.05, 0.3, 0.2]], dtype=torch.float64)
    task.motion.stand_on(Terrain(torch.tensor([0.0, 0.0, 1.0, -0.03], dtype=torch.float64), wall))
    task.places.find(task.motion.terrain)
    states = task.motion.states()[::3]
    robots = states[task.places.suit(planar_of(task.motion.body_to_world(states)))]
    episodes = task.episodes(robots, 300, 0)
    state, mark = episodes["state"], episodes["mark"].double()
    ball, robot = state[:, task.ball], task.motion.planar(state)
    away, way = ball[:, :2] - robot[:, :2], mark[:, :2] - ball[:, :2]
    off = (torch.atan2(away[:, 1], away[:, 0]) - robot[:, 2] + math.pi) % math.tau - math.pi
    cosine, far = torch.nn.functional.cosine_similarity(away, way), way.norm(dim=1)
    assert away.norm(dim=1).min() >= 0.399 and off.abs().max() <= math.radians(40.1)
    assert far.min() >= 0.499 and far.max() <= 0.901 and 0.499 <= cosine.min() < 0.6 and cosine.max() > 0.99
    torch.testing.assert_close(ball[:, 2], torch.full((300,), 0.06, dtype=torch.float64))
    torch.testing.assert_close(mark[:, 2], torch.full((300,), -0.01, dtype=torch.float64))
    for place in (ball, mark):
        beside = ((place[:, :2].abs() - wall[0, 3:5]).clamp_min(0)).norm(dim=1)
        assert beside.min() >= 0.399 and (place[:, :2].abs() <= 0.601).all()
    for one, other in ((ball, robot), (ball, mark)):
        between = 0.5 * (one[:, :2] + other[:, :2])
        assert ((between.abs() - wall[0, 3:5]).clamp_min(0)).norm(dim=1).min() > 0.2, "nothing stands between"
    again = task.episodes(robots, 300, 0)
    assert all(torch.equal(again[key], value) for key, value in episodes.items())


def test_a_ball_without_a_place_that_fits_is_ahead_if_it_can_be() -> None:
    task = push(ahead_deg=40.0, turn_deg=5.0)
    edge = torch.tensor([[0.15, 0.0, 0.0], [0.95, 0.95, 0.75]])  # at the second no ball is ahead
    state = task.motion.placed(edge)
    assert not task.places.suit(edge.double()).any()
    begun = task.start(state, Anywhere(lambda: state, torch.Generator().manual_seed(0)))
    away = begun[:, task.ball][:, :2] - edge[:, :2]
    off = (torch.atan2(away[:, 1], away[:, 0]) - edge[:, 2]).abs()
    assert off[0] <= math.radians(40.1) < off[1] and away.norm(dim=1).min() >= 0.399


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"nearest": 0.1}, "task.nearest: expected success_distance < nearest < farthest"),
        ({"ahead_deg": 200.0}, "task.ahead_deg: expected a number from 0.0 to 180.0"),
        ({"ball": "egg"}, "task.motion.things: expected 'egg' to have a free joint"),
        ({"clearance": 0.9}, "places for ball and mark: expected two at least 0.5 m apart"),
        ({"mark_rgb": (1.0, 0.0)}, "task.mark_rgb: expected red, green and blue"),
    ],
)
def test_invalid_settings_are_refused(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        push(**settings)


def test_an_area_with_too_many_places_for_a_ball_is_refused() -> None:
    area: Any = {"lower": [-500.0, -500.0], "upper": [500.0, 500.0], "spacing": 50.0}
    motion = PhysicsMotion("wheels", "eye", {"ball": "ball"}, ["ball"], threads=1, **area)
    with pytest.raises(ValueError, match=r"at most 16,777,216 places for ball and mark, got 400,040,001 \(20,001 × "):
        Push(motion)


def test_a_motion_without_physics_is_refused() -> None:
    with pytest.raises(ValueError, match=r"task\.motion: expected a motion with physics, got DriveMotion"):
        Push(DriveMotion(0.3))  # type: ignore[arg-type]


def test_a_robot_that_drives_at_the_ball_pushes_it_to_the_mark() -> None:
    task = push()
    state = states(task, (-0.4, 0.5, 0.0), (0.0, 0.5))
    memory = {"mark": torch.tensor([[*MARK, 0.02]]), "ball": state[:, task.ball][:, :3].float()}
    nothing: Any = NoChecker.__new__(NoChecker)
    anywhere: Any = Anywhere
    steps = 0
    while steps < 40:
        move = task.motion.move(state, torch.tensor([[0.5, 0.0]]), nothing)
        verdict = task.judge(Step(state, torch.zeros(1, 2), move, memory), anywhere)
        state, memory, steps = move.state, dict(verdict.memory), steps + 1
        if verdict.terminated.item():
            break
    assert verdict.outcome.item() == Outcome.GOAL and 10 < steps < 40


def test_a_ball_that_is_let_go_soon_stops() -> None:
    task = push(success_distance=0.1)
    state, motion = states(task, (-1.0, 0.0, 0.0), (0.0, 0.5)), task.motion
    first = int(motion.physics.model.joint("ball/free").dofadr[0])
    state[:, motion.layout.velocities][:, [first, first + 4]] = torch.tensor([0.6, 0.6 / 0.09]).double()
    nothing: Any = NoChecker.__new__(NoChecker)
    places = []
    for _ in range(40):
        state = task.motion.move(state, torch.zeros(1, 2), nothing).state
        places.append(state[0, task.ball][0].item())
    assert 0.4 < places[-1] < 0.6 and places[-1] - places[-10] < 0.01


def test_the_field_of_view_is_what_the_docs_say() -> None:
    robot = instantiate(load_config(["task=push"]).robot)
    assert round(robot.fov_deg) == 138
    high = 2.0 * math.atan(0.5 * robot.image_height / robot.K[1, 1].item())
    assert round(math.degrees(high)) == 105


class TestPush(ConfiguredContract):
    @classmethod
    def overrides(cls) -> tuple[str, ...]:
        coarse = ("task.motion.spacing=0.5", "task.motion.headings=4", "task.motion.threads=1")
        sensing = ("sensors=[rgb,depth,lidar,contact]", "sensors.lidar.beams=9", "sensors.lidar.elevation_deg=-15")
        return ("push", *coarse, *sensing, "task.clearance=0.3", "robot.body.size=[0.3,0.3,0.2]", "task.nearest=0.3")

    def test_an_episode_can_begin_at_a_given_state(self) -> None:
        env = self.make((3,))
        given = env.rollout(3, break_when_any_done=False)[:, -1]
        keys = ("state", "pixels", "depth", "lidar", "mark", "ball")
        seen = env.reset(given.select(*keys), set_state=True)
        assert all(torch.equal(seen[key], given[key]) for key in keys)
        assert (seen["level"] == -1).all() and not seen["done"].any()

    def test_a_robot_does_not_depend_on_the_others(self) -> None:
        batch, alone = self.make((19,)).rollout(1, break_when_any_done=False), self.make((1,))
        for row in (0, 9, 18):
            start = alone.reset(batch[row : row + 1, 0].select("state", "mark"), set_state=True)
            step = alone.step(start.set("action", batch["action"][row : row + 1, 0]))["next"]
            for key in ("pixels", "state", "reward", "done", "outcome", "free_fraction", "ball"):
                assert torch.equal(step[key], batch["next", key][row : row + 1, 0]), key

    def test_robot_ball_and_mark_are_drawn(self) -> None:
        env = base_env(self.make((8,)))
        td = env.reset()
        memory = {key: td[key] for key in ("mark", "ball")}
        parts = env.task.parts(td["state"], memory)
        assert parts.model[0].tolist() == [0, 1, 2, 3, 4, 5] and len(env.task.models) == 5
        torch.testing.assert_close(parts.model_to_world[:, 5, :3, 3], td["mark"])
        cameras = env.robot.cameras(env.task.motion.body_to_world(td["state"]))
        bare = env.drawing.draw(Shot(cameras)).pixels
        assert (bare != td["pixels"]).flatten(1).any(1).all(), "the robot sees its own bumper"
        assert not env.capturable

    def test_the_teacher_labels_the_states_that_a_policy_visits(self) -> None:
        env = self.make((4,))
        spec = env.observation_spec["pixels"].shape[1:]
        torch.manual_seed(0)
        model = actor_critic(spec, env.action_spec, pool=1)
        loss, optim = LossSettings(0.97, 0.9, 0.2, 1, 64, 0.5, 0.01, True, 0.1), OptimSettings(1e-3, 1e-5, 0.5, True)
        frames = visited(env, Learner(model, loss, optim), [self.world.plan], 12)
        assert frames["target"].shape == (12, 2) and frames["target"].isfinite().all()
        assert len(frames["target"].unique(dim=0)) > 4


def test_the_teacher_turns_left_while_it_sees_neither_ball_nor_mark() -> None:
    ball, mark = torch.tensor([[-0.5, -0.1]]).double(), torch.tensor([[-0.7, 0.6]]).double()
    yaw = torch.tensor([0.0, -2.0]).double()  # the shorter turn is one to the right
    robot = torch.stack([torch.zeros(2).double(), torch.zeros(2).double(), yaw], 1)
    blind, sees = pushing(robot, ball.expand(2, 2), mark.expand(2, 2), lambda places: torch.ones(len(places)).double())
    assert blind[0].abs() < 1e-6 and blind[1] > 1.5
    assert sees[0] > 0.3 and sees[1] < 0.0, "it sees the ball, and drives to where it can push"


def test_the_teacher_pushes_balls_to_marks() -> None:
    motion = PhysicsMotion("wheels", "eye", {"ball": "ball"}, ["ball"], 0.2, 0.01, threads=1)
    task = Push(motion)
    episodes = task.episodes(motion.states()[::37], 24, 0)
    state = episodes.pop("state")
    memory, succeeded = episodes, torch.zeros(24, dtype=torch.bool)
    nothing: Any = NoChecker.__new__(NoChecker)
    anywhere: Any = Anywhere
    for _ in range(task.max_steps):
        action = task.teach(state, memory)
        assert action is not None
        move = motion.move(state, action, nothing)
        verdict = task.judge(Step(state, action, move, memory), anywhere)
        state, memory = move.state, dict(verdict.memory)
        succeeded |= verdict.outcome.squeeze(1) == Outcome.GOAL
        if succeeded.float().mean() > 0.9:
            return
    raise AssertionError(f"{int(succeeded.sum())} of 24 balls came to their mark")
