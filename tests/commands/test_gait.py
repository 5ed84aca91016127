"""End-to-end tests of ``splatrl-gait``, with a run in the tiny room."""

import sys
from pathlib import Path

import pytest

from splatrl.building import build_trainer, build_world
from splatrl.commands import gait
from splatrl.configuration import load_config, save_config
from splatrl.motions.legs import FELT, JOINTS
from splatrl.physics.dense import Dense
from tests.tiny import tiny_overrides


def told(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> None:
    monkeypatch.setattr(sys, "argv", ["splatrl-gait", *map(str, arguments)])
    gait.main()


def test_a_run_becomes_a_file_of_weights(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sizes = ["env.num_envs=4", "collector.frames_per_batch=16", "collector.total_frames=16", "loss.mini_batch_size=16"]
    cfg = load_config([*tiny_overrides(tmp_path, "strides"), *sizes, "logger.num_test_episodes=2"])
    (tmp_path / "run").mkdir()
    save_config(cfg, tmp_path / "run")
    build_trainer(cfg, build_world(cfg), tmp_path / "run").fit()
    told(monkeypatch, tmp_path / "run")
    assert len(Dense.load(tmp_path / "run" / "gait.npz", FELT, JOINTS).layers) == 3


def test_a_folder_without_a_run_is_refused_in_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(SystemExit, match=r"^splatrl-gait: .*expected a run folder") as error:
        told(monkeypatch, tmp_path)
    assert "\n" not in str(error.value)
