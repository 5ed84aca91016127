"""An experiment from beginning to end, with made-up trainings."""

import json
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from omegaconf import DictConfig, OmegaConf

from splatrl.experiments import Run, check_settings, conduct, report_all, score, train_all
from splatrl.files import alone_in
from splatrl.training import save_checkpoint
from tests.experiments.made_up import begin, finish, made_up

PROGRAM = ["python", "-m", "a.training"]


def keep_config(run: Run, **changes: Any) -> None:
    """Write the config that a training leaves, with some of its values changed."""
    OmegaConf.save(OmegaConf.create({**run.config, **changes}), run.folder / "config.yaml")


def test_a_folder_with_the_requested_settings_is_continued(tmp_path: Path) -> None:
    new, begun, finished, *_ = made_up(tmp_path).runs
    begin(begun, 40)
    finish(finished, 0.5)
    for run in (begun, finished):
        keep_config(run, threads=5)  # changes no result
    for fresh in (False, True):
        check_settings([new, begun, finished], fresh)
        assert not new.folder.exists() and begun.folder.exists() and finished.folder.exists()


def test_a_folder_with_other_settings_is_refused_or_deleted_if_fresh_is_set(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    experiment = made_up(tmp_path)
    other, same = experiment.runs[:2]
    for run in (other, same):
        begin(run, 40)
        keep_config(run)
    keep_config(other, seed=7)
    with pytest.raises(ValueError, match=rf"{other.folder} was .* other settings or files: seed: .*; .*fresh=true"):
        check_settings([same, other], fresh=False)
    assert other.folder.exists()
    with monkeypatch.context() as patched, pytest.raises(pytest.fail.Exception):
        patched.setattr(shutil, "rmtree", lambda _: pytest.fail("killed"))
        check_settings([same, other], fresh=True)
    assert same.folder.exists() and not other.folder.exists(), "or what is left of it could be taken for a run"
    monkeypatch.setattr(conduct, "train", lambda *_: [])
    train_all([experiment], 1, 1, PROGRAM)
    assert not [*experiment.folder.glob(".*")]


def test_a_folder_trained_in_a_scene_that_has_changed_is_refused_or_deleted_if_fresh_is_set(tmp_path: Path) -> None:
    runs = made_up(tmp_path).runs
    asked: list[str] = []

    def digest(cfg: DictConfig) -> str:
        asked.append(cfg.scene.path)
        return f"{cfg.scene.path} as it is now"

    for run in runs:
        finish(run, 0.5)
        keep_config(run)
        scene = f"{run.scene} as it is now" if run.scene == "yard" else "another hall"
        save_checkpoint(run.folder / "checkpoints" / "last.pt", {"made_with": {"scene": scene, "files": {}}})
    yards, halls = ([run for run in runs if run.scene == scene] for scene in ("yard", "hall"))
    with pytest.raises(ValueError, match=rf"{halls[0].folder} was .* files: scene: its Gaussians .*; .*fresh=true"):
        check_settings(runs, False, digest)
    check_settings(runs, True, digest)
    assert sorted(asked[-2:]) == ["hall", "yard"] and len(asked) == 4, "each scene is read once"
    assert all(run.folder.exists() for run in yards) and not any(run.folder.exists() for run in halls)


def test_a_folder_in_which_a_training_is_running_is_not_deleted(tmp_path: Path) -> None:
    run = made_up(tmp_path).runs[0]
    begin(run, 40)
    keep_config(run, seed=7)
    with alone_in(run.folder), pytest.raises(ValueError, match="another process is using"):
        check_settings([run], fresh=True)
    assert run.folder.exists()


def test_all_trainings_form_one_queue_and_unfinished_experiments_note_the_machine(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    todo, done = made_up(tmp_path / "todo"), made_up(tmp_path / "done")
    for run in done.runs:
        finish(run, 0.5)
    for experiment in (todo, done):
        experiment.folder.mkdir(parents=True, exist_ok=True)
        (experiment.folder / "scores.json").touch()
    asked: list[tuple[Any, ...]] = []

    def nothing(*arguments: Any) -> list[Run]:
        asked.append(arguments)
        return list(todo.runs[:1])

    monkeypatch.setattr(conduct, "train", nothing)
    assert train_all([todo, done], 3, 2, PROGRAM) == [todo.runs[0]]
    assert asked == [([*todo.runs, *done.runs], 3, 2, PROGRAM)]
    assert "machine" in json.loads((todo.folder / "machine.json").read_text())
    assert not (todo.folder / "scores.json").exists()  # they belonged to other trainings
    assert [path.name for path in done.folder.glob("*.json")] == ["scores.json"]


def test_an_experiment_is_scored_once_after_all_its_runs_are_finished(tmp_path: Path) -> None:
    experiment = made_up(tmp_path)
    asked: list[Path] = []

    def scored_by(runs: Sequence[Run], folder: Path) -> list[dict[str, Any]]:
        asked.append(folder)
        return [{"run": run.folder.name, "clip": "walk-00", "frames": 4, "matches": 3} for run in runs]

    for run in experiment.runs:
        assert not score(experiment, scored_by)
        finish(run, 0.5)
    assert score(experiment, scored_by)
    assert not score(experiment, scored_by)
    assert asked == [experiment.folder]
    rows = json.loads((experiment.folder / "scores.json").read_text())["scores"]
    assert [row["run"] for row in rows] == [run.folder.name for run in experiment.runs]
    fewer = replace(experiment, runs=experiment.runs[:1])
    assert score(fewer, scored_by), "scores of other runs say nothing of these"
    assert not score(fewer, scored_by)
    assert score(experiment, scored_by)


@pytest.mark.usefixtures("blank_curves")
def test_several_experiments_have_a_report_each_and_a_joint_report(tmp_path: Path) -> None:
    one, other = made_up(tmp_path / "a"), made_up(tmp_path / "b")
    for experiment in (one, other):
        finish(experiment.runs[0], 0.5)
    assert report_all([one], tmp_path, "an abacus") == [one.folder / "report.md"]
    reports = report_all([one, other], tmp_path, "an abacus")
    assert reports == [one.folder / "report.md", other.folder / "report.md", tmp_path / "report.md"]
    assert all("an abacus" in path.read_text() for path in reports)
