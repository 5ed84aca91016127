"""Imitation by policies that also read sensors, whose readings are recorded, replayed and learned from."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from omegaconf import DictConfig

from splatrl.building import build_model, build_world
from splatrl.configuration import load_config
from splatrl.datasets import (
    Demonstrations,
    Imitation,
    check_imitation,
    planner_episodes,
    read_demonstrations,
    replay,
    write_demonstrations,
)
from splatrl.datasets.imitation import _together
from splatrl.envs.world import World
from splatrl.training import PPO, Cloner, CloningSettings, DaggerSettings, LossSettings, OptimSettings
from tests.tiny import LONG_STEPS, tiny_overrides

SENSORS = "sensors=[rgb,depth,gps,heading]"
LOSS = LossSettings(0.97, 0.9, 0.2, 1, 64, 0.5, 0.01, True, 0.1)
OPTIM = OptimSettings(1e-3, 1e-5, 0.5, True)


@pytest.fixture(scope="module")
def cfg(tmp_path_factory: pytest.TempPathFactory) -> DictConfig:
    return load_config([*tiny_overrides(tmp_path_factory.mktemp("room")), SENSORS, "memory=stack"])


@pytest.fixture(scope="module")
def world(cfg: DictConfig) -> World:
    return build_world(cfg)


@pytest.fixture(scope="module")
def shown(world: World) -> Demonstrations:
    return planner_episodes(world, 30)


def make_ppo(cfg: DictConfig, world: World) -> PPO:
    torch.manual_seed(0)
    env = world.env(16)
    return PPO(env, build_model(cfg, env), LOSS, OPTIM, 128, 10_000)


def test_sensor_readings_are_recorded_and_replayed(world: World, shown: Demonstrations, tmp_path: Path) -> None:
    write_demonstrations(tmp_path, shown)
    read = read_demonstrations(tmp_path)
    assert {"depth", "gps", "heading"} <= set(read.frames.keys())
    assert replay(world, read) == ([], len(shown))
    read.frames["heading"] = read.frames["heading"] + 1.0
    assert replay(world, read)[0] == [f"heading: differs in {len(shown):,} frames"]


def test_a_policy_learns_from_sensor_readings(cfg: DictConfig, world: World, shown: Demonstrations) -> None:
    ppo = make_ppo(cfg, world)
    cloner = Cloner(ppo.model, CloningSettings(25, 64, 1e-3, 0.5))
    assert cloner.reads == ("pixels", "depth", "gps", "heading")
    losses = [
        row["loss_cloning"] for row in Imitation(ppo, cloner, world, lambda: [shown], DaggerSettings(1, 128, 2), 0)()
    ]
    assert losses[0] < 1.0 and len(losses) == 2, "an untrained choice among six actions has a loss of 1.79"


def test_demonstrations_without_an_observation_that_the_policy_reads_are_refused(cfg: DictConfig, world: World) -> None:
    ppo = make_ppo(cfg, world)
    plain = build_world(load_config([*cfg_overrides(cfg), "memory=stack"]))
    shown = planner_episodes(plain, 2)
    cloner = Cloner(ppo.model, CloningSettings(1, 64, 1e-3, 0.5))
    with pytest.raises(ValueError, match=r"demos: expected depth as torch\.float32 \[12, 16, 1\] per frame, got none"):
        next(Imitation(ppo, cloner, world, lambda: [shown], DaggerSettings(0, 128, 1), 0)())


def test_demonstrations_with_other_actions_or_repeated_otherwise_are_refused(
    cfg: DictConfig, world: World, shown: Demonstrations
) -> None:
    ppo = make_ppo(cfg, world)
    cloner, once = Cloner(ppo.model, CloningSettings(1, 64, 1e-3, 0.5)), DaggerSettings(0, 128, 1)
    refused = r"demos: expected each action to be carried out once, .* \(transforms\.skip\), got 4 times"
    with pytest.raises(ValueError, match=refused):
        next(Imitation(ppo, cloner, world, lambda: [replace(shown, repeats=4)], once, 0)())
    others = replace(shown, action_names=("ahead", "stop"))
    with pytest.raises(ValueError, match=r"actions \+x, .* and ahead, stop; type task, robot and scene as they were"):
        next(Imitation(ppo, cloner, world, lambda: [others], once, 0)())


def test_teachers_that_a_task_does_not_have_are_refused(tmp_path: Path) -> None:
    words = [*tiny_overrides(tmp_path, "pointnav"), "task.nearest=0.3", "task.goals=2", "task.test_goals=2"]
    cfg = load_config([*words, "transforms/skip=four"])
    world = build_world(cfg)
    with pytest.raises(ValueError, match=r"dagger\.rounds: expected 0 with transforms/skip, .* teacher of PointNav"):
        check_imitation(world, DaggerSettings(1, 64, 1))
    with pytest.raises(
        ValueError, match=r"demos: expected null or a folder for a task without goal .* \(PointNav\), got 5"
    ):
        check_imitation(world, DaggerSettings(0, 64, 1), 5)


def cfg_overrides(cfg: DictConfig) -> list[str]:
    """Return the overrides of the same room without sensors."""
    return tiny_overrides(Path(cfg.scene.path).parent)


def test_a_task_that_continues_after_its_goals_has_no_planner_to_learn_from(tmp_path: Path) -> None:
    cfg = load_config([*tiny_overrides(tmp_path, "snake"), *LONG_STEPS, "demos=2", "dagger.rounds=1"])
    world = build_world(cfg)
    assert world.plan.field is not None and not world.planned
    with pytest.raises(ValueError, match="planner: expected a task whose episodes end at goal states, got Snake"):
        planner_episodes(world, 2)
    ppo = make_ppo(cfg, world)
    with pytest.raises(ValueError, match=r"dagger\.rounds: expected 0 for a task with neither goal .* \(Snake\)"):
        list(
            Imitation(
                ppo, Cloner(ppo.model, CloningSettings(1, 64, 1e-3, 0.5)), world, None, DaggerSettings(1, 64, 1), 0
            )()
        )


def test_frames_that_a_gpu_has_no_room_for_stay_on_the_cpu(monkeypatch: pytest.MonkeyPatch) -> None:
    parts = [{"pixels": torch.full((3, 2), value)} for value in (1.0, 2.0)]
    monkeypatch.setattr(torch.cuda, "mem_get_info", lambda device: (2 * 48, 10**9))  # twice what the frames take
    assert _together(parts, torch.device("cuda"))["pixels"].tolist() == [[1.0, 1.0]] * 3 + [[2.0, 2.0]] * 3
