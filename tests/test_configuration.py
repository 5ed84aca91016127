"""Configs compose, build what they say, and explain what is wrong with them."""

from pathlib import Path

import pytest
from omegaconf import OmegaConf

from splatrl.configuration import (
    build_world,
    check_overrides,
    conf_dir,
    load_config,
    make_env,
    resumed_config,
    run_config,
    save_config,
)
from tests.tiny import tiny_overrides

TASKS = sorted((conf_dir() / "task").glob("*.yaml"))
SCENES = sorted((conf_dir() / "scene").glob("*.yaml"))
NOT_OF_TRAIN = {"scene", "task", "experiment"}
OPTIONS = sorted(
    path.relative_to(conf_dir()).with_suffix("")
    for path in conf_dir().rglob("*/*.yaml")
    if path.relative_to(conf_dir()).parts[0] not in NOT_OF_TRAIN
)


@pytest.mark.parametrize("option", OPTIONS, ids=str)
def test_every_option_of_every_group_builds_an_env_that_steps(option: Path, tmp_path: Path) -> None:
    task = "apple" if option.parent.name == "sprite" else "grid"
    env = make_env([*tiny_overrides(tmp_path, task), f"{option.parent.as_posix()}={option.name}"], batch_size=[2])
    assert env.rollout(2)["next", "reward"].shape[0] == 2


@pytest.mark.parametrize("path", TASKS, ids=lambda path: path.stem)
def test_every_task_builds_an_env_that_steps(path: Path, tmp_path: Path) -> None:
    env = make_env(tiny_overrides(tmp_path, path.stem), batch_size=[2])
    assert env.rollout(2)["next", "reward"].shape[0] == 2


@pytest.mark.parametrize("path", SCENES, ids=lambda path: path.stem)
def test_every_scene_composes_and_sets_the_goal_and_the_height(path: Path) -> None:
    cfg = load_config([f"scene={path.stem}"])
    assert cfg.scene._target_ == "splatrl.load_scene"
    if path.stem != "file":
        assert len(cfg.task.goal) == 3
        assert cfg.task.motion.height == cfg.robot.height > 0


def test_the_kitchen_is_the_task_that_figures_are_compared_on(shared_scenes: Path) -> None:
    world = build_world(load_config(["scene=kitchen", f"scene.path={shared_scenes / 'kitchen' / 'kitchen.spz'}"]))
    assert world.robot.body.size == (0.4, 0.4, 0.1)
    assert world.robot.height == 1.05
    assert world.task.motion.shape == (11, 11, 16)
    assert world.task.goal.tolist() == [0.4, 0.4, 0.0]
    assert len(world.plan.start_rows) > 500


def test_a_mistyped_key_stops_with_the_valid_ones() -> None:
    with pytest.raises(SystemExit, match=r"loss.gama: no such key, did you mean loss.gamma\?\n.*clip_epsilon"):
        check_overrides("train", ["scene=backyard", "loss.gama=0.9"])
    with pytest.raises(SystemExit, match=r"sede: no such key, did you mean seed\?\n.*collector"):
        check_overrides("train", ["sede=1"])
    with pytest.raises(SystemExit, match=r"valid keys of evaluation\.seed: none"):
        check_overrides("train", ["evaluation.seed.x=1"])


def test_a_value_that_nobody_gave_is_named(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"expected a value for scene\.path; give it as scene\.path=\.\.\."):
        build_world(load_config(["scene=kitchen"]))


@pytest.mark.parametrize("argument", ["task.goal=[0.0", "scene=kitchn"])
def test_grammar_and_the_options_of_groups_are_left_to_hydra(argument: str) -> None:
    check_overrides("train", [argument])


def test_right_overrides_pass_sweeps_and_hydra_options_among_them() -> None:
    check_overrides("train", ["-m", "seed=0,1", "curriculum=distance,none", "hydra.run.dir=x", "+extra=1", "~logger"])
    check_overrides("train", ["scene=kitchen", "scene.path=/a/b.spz", "--cfg", "job"])


def test_a_resumed_config_is_the_saved_one_with_single_keys_changed(tmp_path: Path) -> None:
    save_config(load_config(["loss.gamma=0.9"]), tmp_path)
    cfg = resumed_config(tmp_path, [f"resume={tmp_path}", "collector.total_frames=7"])
    assert (cfg.loss.gamma, cfg.collector.total_frames) == (0.9, 7)
    with pytest.raises(ValueError, match="expected changes of single keys, got scene=kitchen"):
        resumed_config(tmp_path, ["scene=kitchen"])


def test_a_saved_config_finds_its_scene_from_elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    save_config(load_config(["scene=file", "scene.path=scenes/garden.ply"]), tmp_path)
    assert run_config(tmp_path).scene.path == str(tmp_path / "scenes" / "garden.ply")
    save_config(load_config(), tmp_path)
    assert run_config(tmp_path).scene.path == "backyard"


def test_a_folder_without_a_run_is_named(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=f"{tmp_path}: expected a run folder"):
        run_config(tmp_path)


def test_a_saved_config_keeps_its_interpolations(tmp_path: Path) -> None:
    save_config(load_config(), tmp_path)
    assert OmegaConf.to_container(run_config(tmp_path))["task"]["motion"]["height"] == "${robot.height}"
