"""Evaluations of robots with physics meet the same variety of physics as training does."""

from pathlib import Path

import pytest
import torch
from tensordict import TensorDictBase

from splatrl.building import build_world
from splatrl.configuration import load_config
from splatrl.datasets import planner_episodes
from splatrl.envs.world import World
from splatrl.evaluation.rollouts import run_episodes
from splatrl.evaluation.starts import spread_starts
from tests.tiny import tiny_overrides

pytest.importorskip("mujoco")
WHEELS = ["robot=wheels", "motion@task.motion=physics", "task.motion.threads=1", "task.motion.variation.models=4"]
WHEELS += ["task.motion.variation.friction=[0.3,2.0]", "task.motion.variation.motor=[0.3,1.0]"]
WHEELS += ["task.motion.lower=[0.0,0.4]"]  # paths are planned in a sixth of the room


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> World:
    folder: Path = tmp_path_factory.mktemp("room")
    return build_world(load_config([*tiny_overrides(folder, "drive"), *WHEELS]))


def test_starts_obey_the_models_of_the_bank_whatever_is_drawn_elsewhere(world: World) -> None:
    motion, chosen = world.task.motion, spread_starts(world, 32)
    assert motion.model_of(chosen.state).unique().tolist() == [0, 1, 2, 3]
    torch.rand(3)
    assert torch.equal(spread_starts(world, 32).state, chosen.state)
    fewer = spread_starts(world, 16).state
    assert torch.equal(motion.model_of(fewer), motion.model_of(chosen.state)[:16]), "a row's model depends on the row"


def test_episodes_are_the_same_at_any_batch_size(world: World) -> None:
    def ahead(td: TensorDictBase) -> TensorDictBase:
        return td.set("action", torch.tensor([[0.5, 0.5]]).expand(td.shape[0], 2))

    starts = spread_starts(world, 12)
    one, other = (run_episodes(world.env(rows), ahead, starts.state, scene=starts.scene) for rows in (3, 12))
    assert torch.equal(one.outcome, other.outcome) and torch.equal(one.episode_return, other.episode_return)
    assert torch.equal(one.start, starts.state)


def test_demonstrations_of_the_planner_obey_them_too(world: World) -> None:
    shown = planner_episodes(world, 12)
    models = world.task.motion.model_of(shown.frames["state"])
    assert models.unique().tolist() == [0, 1, 2, 3]
    for first, count in zip(shown.starts.tolist(), shown.lengths.tolist(), strict=True):
        assert models[first : first + count].unique().numel() == 1
