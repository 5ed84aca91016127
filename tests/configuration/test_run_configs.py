"""The configs of run folders: saved, found again and resumed."""

import re
from pathlib import Path

import pytest
from omegaconf import OmegaConf

from splatrl.building import build_trainer, build_world
from splatrl.configuration import (
    command_line,
    load_config,
    resumed_config,
    run_config,
    save_config,
)
from splatrl.configuration.search_path import composed
from tests.tiny import tiny_overrides


def test_a_run_is_built_again_from_its_saved_config(tmp_path: Path) -> None:
    save_config(load_config([*tiny_overrides(tmp_path), "memory=stack"]), tmp_path)
    saved = run_config(tmp_path)
    trainer = build_trainer(saved, build_world(saved), tmp_path)
    assert trainer.ppo.collect()["pixels"].shape[-1] == 12


def test_a_resumed_config_is_the_saved_one_with_single_keys_changed(tmp_path: Path) -> None:
    save_config(load_config(["loss.gamma=0.9"]), tmp_path)
    cfg = resumed_config(tmp_path, [f"resume={tmp_path}", "collector.total_frames=7"])
    assert (cfg.loss.gamma, cfg.collector.total_frames) == (0.9, 7)
    with pytest.raises(ValueError, match=r"expected overrides of single keys, .*, got scene=kitchen"):
        resumed_config(tmp_path, ["scene=kitchen"])


def test_a_resumption_changes_the_keys_of_the_runs_own_task_and_scene(tmp_path: Path) -> None:
    save_config(load_config(["task=apple", "scene=file", f"scene.path={tmp_path}/garden.ply"]), tmp_path)
    changes = ["scene.path=moved.ply", "task.red_share=0.2", "+loss.gamma=0.9", "++task.motion.step=0.2"]
    words = command_line("train", [f"resume={tmp_path}", *changes])
    assert composed(words, "train").resume == str(tmp_path)  # as Hydra does before the command begins
    cfg = resumed_config(tmp_path, words)
    assert (cfg.scene.path, cfg.task.red_share, cfg.loss.gamma, cfg.task.motion.step) == ("moved.ply", 0.2, 0.9, 0.2)
    assert set(cfg) == set(load_config())
    with pytest.raises(SystemExit, match=r"task\.red_shares: no such key, did you mean task\.red_share\?"):
        command_line("train", [f"resume={tmp_path}", "task.red_shares=0.2"])
    with pytest.raises(SystemExit, match=r"task\.red_share: expected a number such as 0\.3, got 'x'"):
        command_line("train", [f"resume={tmp_path}", "task.red_share=x"])


@pytest.mark.parametrize(
    "word", ["~loss.gamma", "+loss.gamme=0.9", "++task.red_share=0.2", "+transforms/latency=varied"]
)
def test_a_resumption_neither_adds_nor_deletes_keys(word: str, tmp_path: Path) -> None:
    save_config(load_config(), tmp_path)
    with pytest.raises(ValueError, match=rf"^resume=.*: expected .*, got \+*{re.escape(word.lstrip('+'))}$"):
        resumed_config(tmp_path, [f"resume={tmp_path}", word])


def test_a_sweep_of_resumptions_may_run_on_a_cluster(tmp_path: Path) -> None:
    save_config(load_config(), tmp_path)
    assert resumed_config(tmp_path, [f"resume={tmp_path}", "+launcher=ray"]) == resumed_config(tmp_path, [])


def test_a_saved_config_finds_its_scene_from_any_working_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    save_config(load_config(["scene=file", "scene.path=scenes/garden.ply"]), tmp_path)
    assert run_config(tmp_path).scene.path == str(tmp_path / "scenes" / "garden.ply")
    save_config(load_config(), tmp_path)
    assert "path" not in run_config(tmp_path).scene


def test_a_folder_without_a_run_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=f"{tmp_path}: expected a run folder"):
        run_config(tmp_path)


def test_a_saved_config_keeps_its_interpolations(tmp_path: Path) -> None:
    save_config(load_config(), tmp_path)
    assert OmegaConf.to_container(run_config(tmp_path))["task"]["motion"]["height"] == "${robot.height}"
