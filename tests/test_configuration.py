"""Configs compose, build what they say, and explain what is wrong with them."""

from pathlib import Path

import pytest
import torch
from omegaconf import OmegaConf

from splatrl.build import build_trainer, build_world, make_env
from splatrl.configuration import check_overrides, conf_dir, load_config, resumed_config, run_config, save_config
from tests.envs.devices import pretend_device
from tests.tiny import tiny_overrides

TASKS = sorted((conf_dir() / "task").glob("*.yaml"))
SCENES = sorted((conf_dir() / "scene").glob("*.yaml"))
NOT_OF_TRAIN = {"scene", "task", "experiment"}
OF_GPUS = {Path("renderer/cuda"), Path("renderer/gsplat"), Path("collision/cuda")}
OPTIONS = sorted(
    path.relative_to(conf_dir()).with_suffix("")
    for path in conf_dir().rglob("*/*.yaml")
    if path.relative_to(conf_dir()).parts[0] not in NOT_OF_TRAIN
)


@pytest.mark.parametrize("option", [option for option in OPTIONS if option not in OF_GPUS], ids=str)
def test_every_option_of_every_group_builds_an_env_that_steps(option: Path, tmp_path: Path) -> None:
    task = "apple" if option.parent.name == "sprite" else "grid"
    env = make_env([*tiny_overrides(tmp_path, task), f"{option.parent.as_posix()}={option.name}"], batch_size=[2])
    assert env.rollout(2)["next", "reward"].shape[0] == 2


@pytest.mark.parametrize("option", sorted(OF_GPUS), ids=str)
def test_what_runs_on_gpus_alone_says_so(option: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    chosen = [*tiny_overrides(tmp_path), f"{option.parent}={option.name}"]
    with pytest.raises(ValueError, match=r"splatrl\..*: expected device=cuda, got device=cpu"):
        build_world(load_config(chosen))
    if option.name == "cuda":
        monkeypatch.setattr(world, "cuda_extra", lambda: False)
        with pytest.raises(ValueError, match=r"expected the extra cuda, .* pip install 'splatrl\[cuda\]'"):
            build_world(load_config(chosen))


def test_the_parts_for_a_gpu_are_those_of_its_nodes() -> None:
    """Those that ``auto`` names, and where a group is chosen by name that alone."""
    gpu, cpu = torch.device("cuda"), torch.device("cpu")
    cfg = load_config(["renderer.antialiased=false", "renderer.tolerance=0.25"])
    assert world._node(cfg.renderer, "views", gpu)._target_ == "splatrl.renderers.cuda.CudaRenderer"
    assert world._node(cfg.collision, "checker", gpu)._target_ == "splatrl.collision.cuda.CudaChecker"
    assert (cfg.renderer.gpu.antialiased, cfg.renderer.gpu.tolerance) == (False, 0.25)
    assert world._node(cfg.renderer, "views", cpu)._target_ == "splatrl.renderers.NativeRenderer"
    named = load_config(["renderer=native", "collision=fcl"])
    assert world._node(named.renderer, "views", gpu)._target_ == "splatrl.renderers.NativeRenderer"
    assert world._node(named.collision, "checker", gpu)._target_ == "splatrl.collision.FclChecker"


def test_a_config_of_before_there_were_gpus_still_builds(tmp_path: Path) -> None:
    cfg = load_config([*tiny_overrides(tmp_path), "renderer=native", "collision=native", "memory=stack"])
    del cfg.collector.cuda_graph, cfg.optim.compile
    cfg.transforms.stack._target_ = "torchrl.envs.CatFrames"
    folder = tmp_path / "run"
    folder.mkdir()
    save_config(cfg, folder)
    old = run_config(folder)
    trainer = build_trainer(old, build_world(old), folder)
    assert trainer.ppo.collect()["pixels"].shape[-1] == 12


def test_a_task_moves_with_its_env_and_the_plan_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pretend_device(monkeypatch)
    world = build_world(load_config(tiny_overrides(tmp_path)))
    assert world.env(2, device="meta").task.goal.device.type == "meta"
    assert world.task.goal.device.type == world.plan.motion.moves.device.type == "cpu"


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
