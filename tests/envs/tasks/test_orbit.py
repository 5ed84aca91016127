"""The circle, polar plane and hemisphere tasks."""

import math
from pathlib import Path
from typing import Any

import pytest
import torch
from hydra.utils import instantiate

from splatrl import make_env
from splatrl.building import build_world
from splatrl.configuration import load_config
from splatrl.envs.tasks import Orbit, Outcome
from splatrl.motions import OrbitMotion
from splatrl.renderers import NativeRenderer
from tests.envs.tasks.steps import judged
from tests.tiny import tiny_overrides

ORIGIN = (0.75, 1.0, 0.5)
RUN, GOAL, HIT, OUT = Outcome.RUNNING, Outcome.GOAL, Outcome.COLLISION, Outcome.OUT_OF_BOUNDS


def orbit(azimuth_deg: float = 180.0, distance: float = 1.0, elevation_deg: float = 0.0, **settings: Any) -> Orbit:
    """Make the orbit task with 12 azimuths, 5 distances from 0.5 m and 4 elevations."""
    motion = OrbitMotion(ORIGIN, 30.0, 0.25, (0.5, 1.5), (0.0, 90.0))
    return Orbit(motion, azimuth_deg, distance, elevation_deg, **settings)


def test_the_goal_extends_one_step_along_each_coordinate() -> None:
    task = orbit()
    states = task.motion.states()
    there = states[task.reached(states)]
    assert sorted(set(there[:, 0].tolist())) == [5, 6, 7]
    assert sorted(set(there[:, 1].tolist())) == [1, 2, 3]
    assert sorted(set(there[:, 2].tolist())) == [0, 1] and len(there) == 3 * 3 * 2


@pytest.mark.parametrize("azimuth_deg", [0.0, 360.0, -360.0, 720.0])
def test_the_azimuth_of_the_goal_wraps_around(azimuth_deg: float) -> None:
    task = orbit(azimuth_deg)
    states = task.motion.states()
    assert sorted(set(states[task.reached(states)][:, 0].tolist())) == [0, 1, 11]


def test_a_goal_between_states_covers_two_values_of_each_coordinate() -> None:
    task = orbit(195.0, 1.125, 45.0)
    assert task.reached(task.motion.states()).sum() == 2 * 2 * 2


def test_the_goal_pose_is_at_its_distance_from_the_origin_and_looks_at_it() -> None:
    reach = 1.0 * math.cos(math.radians(60.0))
    goal = orbit(90.0, 1.0, 60.0).goal
    assert goal[:2].tolist() == pytest.approx([ORIGIN[0], ORIGIN[1] + reach])
    assert math.remainder(float(goal[2]) + math.pi / 2, math.tau) == pytest.approx(0.0)
    task = orbit(90.0, 1.0, 60.0)
    at_goal = task.motion.planar(torch.tensor([[3, 2, 2]]))[0]
    assert at_goal[:2].tolist() == pytest.approx(goal[:2].tolist())
    assert math.remainder(float(at_goal[2] - goal[2]), math.tau) == pytest.approx(0.0)


@pytest.mark.parametrize(
    ("next_state", "hit", "outcome", "reward"),
    [
        ([0, 2, 0], False, RUN, 0.0),
        ([6, 2, 0], False, GOAL, 1.0),
        ([6, 2, 0], True, HIT, -1.0),  # takes precedence over the goal
        ([6, 5, 0], False, OUT, -1.0),
        ([6, 2, -1], False, OUT, -1.0),  # takes precedence over the goal, one step away
        ([6, 5, 0], True, HIT, -1.0),  # takes precedence over the bounds
    ],
)
def test_a_step_is_judged_by_collision_then_range_then_goal(
    next_state: list[int], hit: bool, outcome: Outcome, reward: float
) -> None:
    task, ahead = orbit(), torch.tensor([next_state])
    verdict = judged(task, ahead, torch.tensor([hit]))
    assert verdict.outcome.tolist() == [[outcome]] and verdict.reward.tolist() == [[reward]]
    assert verdict.terminated.tolist() == [[outcome != RUN]] and verdict.reward.dtype == torch.float32


@pytest.mark.parametrize(
    ("name", "actions", "states"), [("circle", 2, 36), ("polar_plane", 4, 36 * 11), ("hemisphere", 6, 36 * 11 * 10)]
)
def test_the_configs_differ_in_the_coordinates_that_vary(name: str, actions: int, states: int) -> None:
    cfg = load_config([f"task={name}"])
    task = instantiate(cfg.task)
    assert task.motion.action_spec.n == actions and len(task.motion.states()) == states
    assert task.motion.origin.tolist() == pytest.approx(list(cfg.landmarks.object))
    assert task.reached(task.motion.states()).any()
    assert task.outcome_rewards.tolist() == [0.0, 1.0, -1.0, -1.0]


def test_an_env_goes_round_the_object(tmp_path: Path) -> None:
    env = make_env(tiny_overrides(tmp_path, "circle"), [2], 0)
    states = torch.tensor([[20, 0, 0], [17, 0, 0]])
    td = env.reset(env.reset().select("state").set("state", states), set_state=True)
    after = env.step(td.set("action", torch.tensor([0, 0])))["next"]
    assert after["state"].tolist() == [[21, 0, 0], [18, 0, 0]]
    assert after["outcome"].flatten().tolist() == [GOAL, RUN] and after["reward"].flatten().tolist() == [1.0, 0.0]
    assert after["pixels"].float().std() > 10


def test_a_blocked_goal_is_refused_with_the_keys_that_move_it(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"; try another task\.azimuth_deg, task\.distance or landmarks\.object, or a"):
        build_world(load_config([*tiny_overrides(tmp_path, "circle"), "task.azimuth_deg=0"]))


def test_the_goal_in_the_backyard_sees_past_the_wall() -> None:
    world = build_world(load_config(["task=circle", "device=cpu", "robot.image_width=24"]))
    motion = world.task.motion
    state = motion.states()[[22]]
    assert torch.allclose(motion.sphere(state), world.task.goal_sphere)
    view = NativeRenderer(world.scene.gaussians).render(world.robot.cameras(motion.body_to_world(state)))
    assert view.depth.median() > 1.0  # the wall is 0.2 m from other sides


@pytest.mark.parametrize("change", [{"azimuth_deg": math.nan}, {"distance": "1"}, {"elevation_deg": math.inf}])
def test_a_goal_that_is_not_a_finite_number_is_refused(change: dict[str, Any]) -> None:
    (key,) = change
    with pytest.raises(ValueError, match=rf"task\.{key}: expected a number from .*, got "):
        orbit(**change)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"distance": 1.8}, r"task\.distance: .* beyond task\.motion\.distance, 0\.5 to 1\.5, got 1\.8"),
        ({"distance": 0.2}, r"task\.distance: .* beyond task\.motion\.distance, 0\.5 to 1\.5, got 0\.2"),
        ({"elevation_deg": -31.0}, r"task\.elevation_deg: .* task\.motion\.elevation_deg, 0 to 90, got -31\.0"),
    ],
)
def test_a_goal_out_of_reach_is_refused_with_the_key_of_its_range(change: dict[str, float], told: str) -> None:
    with pytest.raises(ValueError, match=told):
        orbit(**change)
