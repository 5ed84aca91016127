"""Sweeps of trainings: their folders, and how an interrupted one continues."""

import json
import shlex
import sys
from datetime import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from hydra.conf import HydraConf
from hydra.core.plugins import Plugins
from omegaconf import DictConfig, OmegaConf

from splatrl.commands import entries, stopping, sweeps, train
from splatrl.configuration import load_config, run_configs, save_config, sweep_folders

WORDS = ["task=fps", "logger.video=false", "collector.total_frames=2048", "collector.frames_per_batch=1024"]
FINISHED = 0.25
"""Success rate of a run that is finished."""

Given = list[tuple[int, str | None, Path]]


@pytest.fixture
def given(monkeypatch: pytest.MonkeyPatch) -> Given:
    """Seed, ``resume`` and folder of each training that a sweep begins; none of them trains."""
    given = Given()

    def trained(cfg: DictConfig, folder: Path) -> float:
        given.append((cfg.seed, cfg.resume, folder))
        return 1.0

    monkeypatch.setattr(train, "train", trained)
    return given


@pytest.fixture
def results(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """What a sweeper gets from its jobs."""
    results, usual = list[float](), train.trained

    def trained(cfg: DictConfig, job: HydraConf) -> float:
        results.append(usual(cfg, job))
        return results[-1]

    monkeypatch.setattr(train, "trained", trained)
    return results


@pytest.fixture
def begun(tmp_path: Path) -> Path:
    """The folder of a sweep over seeds, of which 0 is finished, 1 has begun, and 2 was stopped before a checkpoint."""
    for seed in range(3):
        folder = tmp_path / "a sweep" / str(seed)
        (folder / "checkpoints").mkdir(parents=True)
        (folder / ".hydra").mkdir()
        (folder / ".hydra" / "overrides.yaml").write_text("what was typed")
        save_config(load_config([*WORDS, f"seed={seed}"]), folder)
        (folder / "progress.csv").write_text(f"frames\n{2048 if seed == 0 else 1024}\n")
        if seed < 2:
            (folder / "checkpoints" / "last.pt").touch()
    (tmp_path / "a sweep" / "0" / "evaluation.json").write_text(json.dumps({"success_rate": FINISHED}))
    (tmp_path / "a sweep" / "multirun.yaml").write_text("what was typed")
    return tmp_path / "a sweep"


def sweep(monkeypatch: pytest.MonkeyPatch, *words: str) -> None:
    """Type a sweep of trainings, as if in a new process."""
    run_configs._new_folder.cache_clear()
    monkeypatch.setattr(sys, "argv", ["splatrl-train"])
    entries.train(["-m", *words])


def typed(folder: Path) -> list[str]:
    """Return the overrides that Hydra has recorded in a run folder."""
    return list(OmegaConf.load(folder / ".hydra" / "overrides.yaml"))


def contents(folder: Path) -> dict[Path, bytes]:
    """Return all files below a folder."""
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_two_sweeps_that_begin_in_the_same_second_get_a_folder_each(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, given: Given
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("hydra.core.utils.datetime", SimpleNamespace(now=lambda: time(12)))
    for seeds in ("0,1", "5"):
        sweep(monkeypatch, f"seed={seeds}")
    place = tmp_path / "multirun" / "1900-01-01"
    folders = [place / "12-00-00" / "0", place / "12-00-00" / "1", place / "12-00-00-2" / "0"]
    assert given == [(seed, None, folder) for seed, folder in zip((0, 1, 5), folders, strict=True)]
    assert [typed(folder) for folder in folders] == [["seed=0"], ["seed=1"], ["seed=5"]]
    described = [OmegaConf.load(place / name / "multirun.yaml").hydra for name in ("12-00-00", "12-00-00-2")]
    assert [list(one.overrides.task) for one in described] == [["seed=0,1"], ["seed=5"]]
    assert described[1].sweep.dir == "multirun/1900-01-01/12-00-00-2"


def test_a_sweep_continues_in_its_folder_and_may_have_more_jobs(
    begun: Path, monkeypatch: pytest.MonkeyPatch, given: Given, results: list[float]
) -> None:
    before = contents(begun)
    sweep(monkeypatch, *WORDS, "seed=0,1,2,3", f"hydra.sweep.dir='{begun}'")
    assert given == [(1, str(begun / "1"), begun / "1"), (2, None, begun / "2"), (3, None, begun / "3")]
    assert results == [FINISHED, 1.0, 1.0, 1.0], "the sweeper gets the result of the finished run"
    assert typed(begun / "3")[-1] == "seed=3"
    now = contents(begun)
    assert all(now[path] == content for path, content in before.items() if path.parent != begun)


def test_a_sweep_whose_folder_holds_runs_of_other_settings_is_refused_before_anything_is_written(
    begun: Path, monkeypatch: pytest.MonkeyPatch, given: Given
) -> None:
    before = contents(begun)
    refused = rf"^splatrl-train: job #1: {begun}/1: expected no run, or one of the same .*: seed: asked for 3, found 1;"
    with pytest.raises(SystemExit, match=f"{refused} choose another folder with hydra.sweep.dir=$"):
        sweep(monkeypatch, *WORDS, "seed=0,3", f"hydra.sweep.dir='{begun}'")
    assert not given and contents(begun) == before


def test_a_job_whose_folder_holds_a_run_of_other_settings_is_refused_whatever_the_sweeper(
    begun: Path, monkeypatch: pytest.MonkeyPatch, given: Given, capsys: pytest.CaptureFixture[str]
) -> None:
    before = contents(begun / "1")
    monkeypatch.setattr(sweep_folders.SameSweep, "on_multirun_start", lambda *_, **__: None)
    with pytest.raises(SystemExit):
        sweep(monkeypatch, *WORDS, "seed=0,3,2", f"hydra.sweep.dir='{begun}'")
    assert "job #1: " in (said := capsys.readouterr().err) and "seed: asked for 3, found 1" in said
    assert [seed for seed, *_ in given] == [2] and contents(begun / "1").items() >= before.items()
    assert not list((begun / "1").rglob("resumed"))


def test_a_sweep_that_is_interrupted_says_how_all_of_it_continues(
    begun: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    given = list[int]()

    def interrupted(cfg: DictConfig, folder: Path) -> float:
        given.append(cfg.seed)
        raise KeyboardInterrupt

    monkeypatch.setattr(train, "train", interrupted)
    monkeypatch.chdir(begun.parent)
    words = [*WORDS, "seed=0,1,2", f"hydra.sweep.dir='{begun.name}'"]
    with pytest.raises(SystemExit):
        sweep(monkeypatch, *words)
    said = capsys.readouterr().err.splitlines()[-1].partition("; continue with: ")[2]
    again = ["splatrl-train", "-m", *words[:-1], f"hydra.sweep.dir='{begun}'"]
    assert shlex.split(said) == again
    monkeypatch.chdir("/")
    with pytest.raises(SystemExit):
        sweep(monkeypatch, *again[2:])
    assert given == [1, 1], "the command that is printed continues with the same job"


def test_a_process_of_a_launcher_says_how_its_own_job_continues(
    begun: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(cfg: DictConfig, folder: Path) -> float:
        raise KeyboardInterrupt

    monkeypatch.setattr(train, "train", interrupted)
    sweeps.TYPED.clear()
    monkeypatch.setattr(sys, "argv", ["splatrl-train", "-m", *WORDS, "seed=0,1,2", f"hydra.sweep.dir='{begun}'"])
    with pytest.raises(SystemExit):
        train.run_job()
    assert capsys.readouterr().err.endswith(f"; continue with: splatrl-train 'resume={begun}/1'\n")


@pytest.mark.parametrize(
    ("ended", "chosen"),
    [(KeyboardInterrupt(), []), (SystemExit(stopping.INTERRUPTED), ["hydra.sweep.dir='a sweep'"])],
)
def test_a_sweep_that_is_interrupted_while_others_run_its_jobs_says_how_it_continues(
    begun: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], ended: Any, chosen: list[str]
) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise ended

    monkeypatch.chdir(begun.parent)
    monkeypatch.setattr(Plugins, "instantiate_sweeper", interrupted)
    monkeypatch.setattr(sweeps, "BasicLauncher", SimpleNamespace(__name__="not what launches here"))
    with pytest.raises(SystemExit, match=f"^{stopping.INTERRUPTED}$"):
        sweep(monkeypatch, *WORDS, "seed=0,1,2", *chosen)
    place = f"'{begun}'" if chosen else next((begun.parent / "multirun").glob("*/*"))
    first, _, command = capsys.readouterr().err.splitlines()[-1].partition(", continue with: ")
    assert first.endswith("; jobs on a cluster run on; when they have ended or been cancelled")
    assert shlex.split(command) == ["splatrl-train", "-m", *WORDS, "seed=0,1,2", f"hydra.sweep.dir={place}"]


@pytest.mark.parametrize("alone", [True, False])
def test_a_sweep_that_crashes_says_how_it_continues_below_the_traceback(
    begun: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], alone: bool
) -> None:
    def killed(*_: object, **__: object) -> None:
        raise RuntimeError("a worker process was unexpectedly terminated")

    if alone:
        monkeypatch.setattr(train, "train", killed)
    else:
        monkeypatch.setattr(Plugins, "instantiate_sweeper", killed)
        monkeypatch.setattr(sweeps, "BasicLauncher", SimpleNamespace(__name__="not what launches here"))
    words = [*WORDS, "seed=0,1", f"hydra.sweep.dir='{begun}'"]
    with pytest.raises(SystemExit, match=r"^1$"):
        sweep(monkeypatch, *words)
    said = capsys.readouterr().err
    assert "RuntimeError: a worker process" in said
    first, _, command = said.splitlines()[-1].partition("continue with: ")
    assert first.startswith("the sweep failed; finished work is kept; ") and first.endswith("cancelled, ") != alone
    assert shlex.split(command) == ["splatrl-train", "-m", *words]


def test_runs_are_resumed_by_a_sweep(begun: Path, monkeypatch: pytest.MonkeyPatch, given: Given) -> None:
    runs = [begun / "0", begun / "1"]
    before = contents(begun)
    quoted = ",".join(f"'{run}'" for run in runs)
    sweep(monkeypatch, f"resume={quoted}", f"hydra.sweep.dir={begun.parent / 'resumed'}")
    assert given == [(seed, str(run), run) for seed, run in enumerate(runs)]
    assert contents(begun) == before
