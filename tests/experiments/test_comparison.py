"""Comparisons of made-up run folders, and ``splatrl-compare``."""

import csv
import json
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

from splatrl.commands import compare
from splatrl.experiments import compared, run_folders
from splatrl.experiments.report import _curves
from splatrl.experiments.results import entries

FRAMES = 80


def train(folder: Path, success: float, seed: int, *typed: str, **settings: Any) -> None:
    """Write what a finished training leaves."""
    given = dict(word.split("=", 1) for word in typed if word.startswith("scene"))
    name, number = given.get("scene", "backyard"), int(given.get("scene.seed", 0))
    config = {
        "seed": seed,
        "device": "auto",
        "collector": {"total_frames": FRAMES, "frames_per_batch": 40},
        "curriculum": {"first": None},
        "logger": {"video": True},
        "scene": {"_target_": f"splatrl.{name}", "seed": number},
        **settings,
    }
    for name in ("checkpoints", ".hydra"):
        (folder / name).mkdir(parents=True)
    (folder / "config.yaml").write_text(yaml.safe_dump(config))
    (folder / ".hydra" / "overrides.yaml").write_text(yaml.safe_dump([f"seed={seed}", *typed]))
    figures = {"success_rate": success, "success_rate_argmax": success, "frames": FRAMES, "wall_seconds": 4.0}
    (folder / "evaluation.json").write_text(json.dumps(figures))
    with (folder / "progress.csv").open("w", newline="") as stream:
        csv.writer(stream).writerows([["frames", "test_success"], [40, 0.5], [FRAMES, success]])


@pytest.fixture
def sweep(tmp_path: Path) -> Path:
    """Four trainings, as of ``-m seed=0,1 memory=none,gru``."""
    for number, success in enumerate((0.60, 0.90, 0.62, 0.91)):
        kind, seed = ("none", "gru")[number % 2], number // 2
        common = ("task=fps", "collector.total_frames=80", "logger.video=true")
        train(tmp_path / "sweep" / str(number), success, seed, f"memory={kind}", *common, network={"memory": kind})
    return tmp_path / "sweep"


def stopped(_: object, path: Path) -> None:
    """Write half of a figure."""
    path.touch()
    raise KeyboardInterrupt


def told(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> None:
    monkeypatch.setattr(sys, "argv", ["splatrl-compare", *map(str, arguments)])
    compare.main()


def test_the_trainings_of_a_sweep_are_arms_with_seeds_named_after_what_differs(sweep: Path) -> None:
    experiment = compared(run_folders([sweep, sweep / "1"]), sweep / "comparison")  # the second is known already
    found = [(entry.scene, entry.label, entry.seeds()) for entry in entries(experiment)]
    assert found == [("backyard", "memory=none", "0–1"), ("backyard", "memory=gru", "0–1")]
    assert list(experiment.marks) == [40, 80] and not experiment.left_out


def test_arms_that_were_typed_alike_are_told_apart_by_their_settings(tmp_path: Path) -> None:
    for number, rate in enumerate((0.1, 0.1, 0.2)):
        train(tmp_path / str(number), 0.5, number, optim={"lr": rate})
    train(tmp_path / "3", 0.5, 0, "scene=yard", "scene.seed=7", optim={"lr": 0.1})
    train(tmp_path / "4", 0.5, 0, "scene=yard", "scene.seed=7", "robot=round", optim={"lr": 0.1}, robot="round")
    found = [
        (entry.scene, entry.label, entry.seeds()) for entry in entries(compared(run_folders([tmp_path]), tmp_path))
    ]
    assert found == [
        ("backyard", "optim.lr=0.1", "0–1"),
        ("backyard", "optim.lr=0.2", "2"),
        ("yard:7", "defaults", "0"),
        ("yard:7", "robot=round", "0"),
    ]


def test_scenes_are_told_apart_by_their_settings_and_not_by_what_was_typed(tmp_path: Path) -> None:
    def scene(path: str) -> dict[str, Any]:
        return {"_target_": "splatrl.read_scene", "path": path}

    long = "あ" * 80
    train(tmp_path / "0", 0.5, 0, "scene=file", "scene.path='/a/garden'", scene=scene("/a/garden"))
    train(tmp_path / "1", 0.5, 1, "robot.height=0.4", "scene=file", "scene.path='garden'", scene=scene("/a/garden"))
    train(tmp_path / "2", 0.5, 0, scene=scene("/b/garden"))  # from a folder without what was typed
    train(tmp_path / "3", 0.5, 0, "scene=many", "scene.paths=[x/,y/]", scene={"places": [1, 2], "paths": ["/x", "/y"]})
    train(tmp_path / "4", 0.5, 0, scene=scene(f"/a/{long}1"))
    train(tmp_path / "5", 0.5, 0, scene=scene(f"/a/{long}2"))
    experiment = compared(run_folders([tmp_path]), tmp_path)
    found = entries(experiment)
    gardens = [(f"garden, path=/{folder}/garden", "the only arm") for folder in "ab"]
    assert [(entry.scene, entry.label) for entry in found] == [
        ("2 scenes", "the only arm"),
        *gardens,
        *((f"{long}{number}", "the only arm") for number in (1, 2)),
    ]
    assert [len(entry.runs) for entry in found] == [1, 2, 1, 1, 1]
    names = [curve.path.name for curve in _curves(found, tmp_path)]
    assert len({*names}) == len(names) and max(len(name.encode()) for name in names) < 255


def test_a_word_that_sets_what_all_arms_have_does_not_name_an_arm(tmp_path: Path) -> None:
    height = {"robot": {"height": 0.4}}
    train(tmp_path / "0", 0.5, 0, "curriculum=none", network={"memory": 0}, **height)  # a sweep's words lack proposals
    train(tmp_path / "1", 0.5, 0, "robot.height=0.4", "memory=gru", network={"memory": 8}, **height)
    found = entries(compared(run_folders([tmp_path]), tmp_path))
    assert [entry.label for entry in found] == ["curriculum=none", "memory=gru"]


def test_a_training_counts_once_and_only_if_it_is_finished(sweep: Path) -> None:
    train(sweep / "again", 0.60, 0, network={"memory": "none"}, device="cpu")
    train(sweep / "begun", 0.60, 2, network={"memory": "none"}, logger={"video": False, "test_interval": 7})
    (sweep / "begun" / "evaluation.json").unlink()
    experiment = compared(run_folders([sweep]), sweep / "comparison")
    assert len(experiment.runs) == 4
    assert experiment.left_out == (
        f"{sweep / 'again'} is left out: it is the same training as {sweep / '0'}.",
        f"{sweep / 'begun'} is left out: it is not finished, or not evaluated.",
    )


@pytest.mark.usefixtures("blank_curves")
def test_the_command_prints_the_table_and_what_won_and_repeats(
    sweep: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with monkeypatch.context() as patched, pytest.raises(SystemExit):
        patched.setattr("splatrl.experiments.report.learning_curves", stopped)
        told(monkeypatch, sweep)
    told(monkeypatch, sweep)  # the folder that is there is known to be a comparison's
    told(monkeypatch, sweep)
    printed = capsys.readouterr().out
    assert "| backyard | memory=gru | 0–1 | **90.5 ± 0.7 %** |" in printed
    assert (
        "**backyard, 80 frames**: memory=gru won with 90.5 ± 0.7 %, against memory=none 61.0 ± 1.4 % (p = " in printed
    )
    text = (sweep / "comparison" / "report.md").read_text()
    assert "Question" not in text and "Run on" not in text
    assert json.loads((sweep / "comparison" / "report.json").read_text())["arms"][1]["seeds"] == [0, 1]


def test_what_cannot_be_compared_is_refused_in_one_line(sweep: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(SystemExit, match=r"^splatrl-compare: .*checkpoints: expected a run folder, or a folder that"):
        told(monkeypatch, sweep / "0" / "checkpoints")
    with pytest.raises(
        SystemExit, match=r"^splatrl-compare: .*: expected a new folder, or that of an earlier comparison"
    ):
        told(monkeypatch, sweep, "--out", sweep / "0")
    for number in range(4):
        (sweep / str(number) / "progress.csv").unlink()
    with pytest.raises(SystemExit, match="expected at least one finished training, found none"):
        told(monkeypatch, sweep)
    assert not (sweep / "comparison").exists()
    for damaged in ("{seed: 1}", "{seed: me, scene: [], logger: {}, collector: {}}"):
        (sweep / "2" / "config.yaml").write_text(damaged)
        with pytest.raises(SystemExit, match=r"config\.yaml: expected the config of a training, got"):
            told(monkeypatch, sweep)
