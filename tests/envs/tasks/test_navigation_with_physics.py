"""Point-goal and image-goal navigation of robots with physics: stops, ends, measures, files and teachers."""

import itertools
import math
from pathlib import Path

import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs import EnvBase

from splatrl.building import build_one_world
from splatrl.configuration import load_config
from splatrl.envs.tasks import Outcome, PointNav
from splatrl.envs.tasks.base import Memory
from splatrl.envs.world import World
from splatrl.evaluation.rollouts import knowing, run_episodes
from splatrl.evaluation.starts import given_episodes, save_episodes, spread_starts
from splatrl.motions import PhysicsMotion
from tests.envs.contract import seeded_rollout
from tests.envs.tasks.test_navigation import walk
from tests.tiny import tiny_overrides

pytest.importorskip("mujoco")
WHEELS = ("robot=wheels", "motion@task.motion=physics", "task.motion.threads=1", "task.motion.variation.models=2")
FEW = ("task.goals=8", "task.test_goals=4", "task.nearest=0.3", "task.cell=0.1", "task.motion.headings=4")


def navigation(folder: Path, task: str, *changes: str) -> World:
    """Build a world of the tiny room in which a robot on wheels navigates."""
    room = [word for word in tiny_overrides(folder, task) if not word.startswith("robot.body")]
    return build_one_world(load_config([*room, *WHEELS, *FEW, *changes]))


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> World:
    sensors = ("sensors=[pointgoal,imagegoal]", "task.success_distance=0.3", "task.leeway=0.15", "task.max_steps=100")
    return navigation(tmp_path_factory.mktemp("room"), "imagenav", *sensors)


def begin(env: EnvBase, start: list[float], goal: list[float]) -> TensorDict:
    """Begin an episode of one robot at rest from a start to a goal, which is added to the task's goals."""
    state = env.task.motion.nearest(torch.tensor([start]).double())
    env.task, memory = env.task.with_goals(state, torch.tensor([goal]), torch.zeros(1, dtype=torch.int64))
    return env.reset(TensorDict({"state": state, **memory}, [1]), set_state=True)


def test_every_step_is_a_function_of_what_it_returns_alone_and_in_a_batch(world: World) -> None:
    batch, alone = seeded_rollout(world.env(4, seed=3), 5, 0), world.env(1)
    for step in batch[:, ::2].flatten():
        now = alone.reset(step.unsqueeze(0).exclude("next").clone(), set_state=True)
        after = alone.step(now.clone().set("action", step["action"].unsqueeze(0)))["next"]
        for key in (*world.told, "pixels", "state"):
            assert torch.equal(now[key][0], step[key]), key
        for key in (*world.told, "pixels", "state", "reward", "terminated", "outcome"):
            assert torch.equal(after[key][0], step["next", key]), key


def test_an_episode_that_drives_ahead_and_stops_has_the_measures_worked_out_by_hand(world: World) -> None:
    env = world.env(1)
    td = begin(env, [0.8, -1.0, math.pi / 2], [0.8, 0.0, math.pi / 2])
    assert td["start_distance"].item() == pytest.approx(1.0, abs=1e-4)
    after = walk(env, td, [(0.4, 0.0)] * 24 + [(0.02, 0.1)])  # stops while it still rolls, as in Habitat
    y = [-1.0] + [env.task.motion.planar(one["state"])[0, 1].item() for one in after]
    assert 0.8 < y[-1] + 1.0 < 0.97
    assert [int(one["outcome"]) for one in after] == [Outcome.RUNNING] * 24 + [Outcome.GOAL]
    path, last = sum(abs(b - a) for a, b in itertools.pairwise(y)), after[-1]
    assert last["path_length"].item() == pytest.approx(path, abs=1e-3)
    assert last["distance_to_goal"].item() == pytest.approx(-y[-1], abs=1e-3)
    assert last["reward"].item() == pytest.approx(y[-1] - y[-2] - 0.01 + 2.5, abs=1e-3)
    assert last["collisions"].item() == 0 and last["success"].item()

    def as_above(td: TensorDictBase) -> TensorDictBase:
        return td.set("action", torch.where(td["step_count"] < 24, torch.tensor([0.4, 0.0]), torch.tensor([0.02, 0.1])))

    memory = {key: td[key] for key in env.task.memory_spec}
    found = run_episodes(env, as_above, td["state"], memory=memory).navigation()
    assert found["spl"] == pytest.approx(1.0) and found["distance_to_goal"] == pytest.approx(-y[-1], abs=1e-3)
    assert found["soft_spl"] == pytest.approx(1.0 + y[-1], abs=1e-3)


def test_an_episode_ends_where_the_robot_is_farther_from_the_bounds_than_the_leeway(world: World) -> None:
    env = world.env(1)
    after = walk(env, begin(env, [0.8, -1.2, 1.5 * math.pi], [0.8, 0.0, 0.0]), [(0.5, 0.0)] * 14)
    y = torch.stack([env.task.motion.planar(one["state"])[0, 1] for one in after])
    gone = torch.tensor([bool(one["terminated"]) for one in after])
    assert torch.equal(gone, y < -1.65) and gone.any() and (y[~gone] < -1.5).any()
    outcome = [Outcome.OUT_OF_BOUNDS if end else Outcome.RUNNING for end in gone.tolist()]
    assert [int(one["outcome"]) for one in after] == outcome and after[0]["outcome"].item() == Outcome.RUNNING
    assert not any(bool(one["success"]) for one in after)


def test_contact_is_counted_and_does_not_end_an_episode(world: World) -> None:
    env = world.env(1)
    after = walk(env, begin(env, [0.5, 0.0, math.pi], [0.8, 1.0, 0.0]), [(0.5, 0.0)] * 8)  # towards the block
    assert after[-1]["collisions"].item() > 0 and not any(bool(one["done"]) for one in after)


def test_the_goal_image_is_the_view_of_the_robot_that_stands_there_with_its_own_body(world: World) -> None:
    env = world.env(6)
    td = env.reset()
    there = env.task.motion.layout.with_model(env.task.motion.nearest(td["goal"].double()), td["state"][:, 0])
    arrived = env.reset(td.clone().set("state", there), set_state=True)
    assert torch.equal(td["imagegoal"], arrived["pixels"]) and not torch.equal(td["imagegoal"], td["pixels"])


def test_episodes_are_written_with_the_places_of_robots_and_read_as_states_at_rest(
    world: World, tmp_path: Path
) -> None:
    chosen, path = spread_starts(world, 6), tmp_path / "episodes.json.gz"
    assert world.task.motion.model_of(chosen.state).unique().tolist() == [0, 1]
    save_episodes(path, world, chosen, world.task.goal_radius)
    _, again = given_episodes(world, path)
    torch.testing.assert_close(again.state[:, 1:], chosen.state[:, 1:], atol=1e-6, rtol=0)
    for key in ("goal", "start_distance"):
        torch.testing.assert_close(again.memory[key], chosen.memory[key], atol=1e-4, rtol=0)


def test_a_teacher_that_turns_by_any_angle_reaches_all_goals(world: World) -> None:
    chosen, env = spread_starts(world, 3), world.env(3)

    def teach(state: Tensor, memory: Memory) -> Tensor:
        return PointNav.teach(env.task, state, memory)

    found = run_episodes(env, knowing(env, teach), chosen.state, memory=chosen.memory)
    assert found.success.all() and found.navigation()["spl"] > 0.9


def test_robots_that_take_other_actions_are_refused() -> None:
    motion = PhysicsMotion("car", "eye", linear=(-0.5, 1.0), angular_deg=90.0, threads=1)
    with pytest.raises(
        ValueError, match=r"a motion that can stop \(.*<velocity> servos, .*got PhysicsMotion; type mot"
    ):
        PointNav(motion)
