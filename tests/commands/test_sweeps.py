"""Sweeps of trainings: their folders, and how an interrupted one continues."""

import sys
from datetime import time
from pathlib import Path
from types import SimpleNamespace

import pytest
from omegaconf import DictConfig, OmegaConf

from splatrl.commands import train
from splatrl.configuration import run_configs


def sweep(monkeypatch: pytest.MonkeyPatch, *words: str) -> None:
    """Type a sweep of trainings, as if in a new process."""
    run_configs._new_folder.cache_clear()
    monkeypatch.setattr(sys, "argv", ["splatrl-train", "-m", *words])
    train.main()


def typed(folder: Path) -> list[str]:
    """Return the overrides that Hydra has recorded in a run folder."""
    return list(OmegaConf.load(folder / ".hydra" / "overrides.yaml"))


def test_two_sweeps_that_begin_in_the_same_second_get_a_folder_each(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folders = list[Path]()

    def trained(cfg: DictConfig, folder: Path) -> float:
        folders.append(folder)
        return 1.0

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(train, "train", trained)
    monkeypatch.setattr("hydra.core.utils.datetime", SimpleNamespace(now=lambda: time(12)))
    for seeds in ("0,1", "5"):
        sweep(monkeypatch, f"seed={seeds}")
    place = tmp_path / "multirun" / "1900-01-01"
    assert folders == [place / "12-00-00" / "0", place / "12-00-00" / "1", place / "12-00-00-2" / "0"]
    assert [typed(folder) for folder in folders] == [["seed=0"], ["seed=1"], ["seed=5"]]
    described = [
        OmegaConf.load(folder / "multirun.yaml").hydra for folder in (place / "12-00-00", place / "12-00-00-2")
    ]
    assert [list(one.overrides.task) for one in described] == [["seed=0,1"], ["seed=5"]]
    assert described[1].sweep.dir == "multirun/1900-01-01/12-00-00-2"
