"""End-to-end tests of ``splatrl-experiment``."""

import functools
import json
import os
import shlex
import signal
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest
from omegaconf import OmegaConf

from splatrl.building import build_world
from splatrl.capture.folder import write_scene
from splatrl.commands.experiment import TRAIN, experiment, main
from splatrl.configuration import load_config
from splatrl.experiments import Run, conduct, recapture, running
from splatrl.scenes import write_gaussians
from splatrl.training import load_checkpoint
from tests.capture.rooms import ABOVE, tiny_capture
from tests.commands.test_train import SETTINGS
from tests.preloaded import Process, start
from tests.tiny import tiny_gaussians, tiny_overrides

Command = Callable[..., None]

pytestmark = pytest.mark.usefixtures("blank_curves")


@pytest.fixture
def command(monkeypatch: pytest.MonkeyPatch) -> Command:
    def call(*arguments: str) -> None:
        monkeypatch.setattr(sys, "argv", ["splatrl-experiment", *arguments])
        monkeypatch.setattr("signal.signal", lambda *_: None)
        main()

    return call


@pytest.mark.usefixtures("unmade_yards")
def test_every_experiment_composes_and_states_its_budget(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    trained: list[str] = []

    def nothing(runs: Sequence[Run], jobs: int, threads: int, program: Sequence[str]) -> list[Run]:
        assert jobs == 2 and program == TRAIN
        trained.extend(run.folder.name for run in runs)
        return []

    monkeypatch.setattr(conduct, "train", nothing)
    (tmp_path / "kitchen.spz").touch()
    kitchen = f"kitchen={tmp_path / 'kitchen.spz'}"
    words = ["name=all", f"folder={tmp_path}", kitchen, "jobs=2", "experiments.loop.prepare=null"]
    experiment(load_config(words, "experiment"))
    assert len(trained) == 25 + 8 + 6 + 24 + 5 + 8 + 16 + 6
    assert "kitchen-gru-s0" in trained
    said = capsys.readouterr().out
    assert "98 of 98 trainings to do" in said
    for name in ("grid", "fps", "apple", "sim2real", "loop", "generalise", "demonstrations", "weather"):
        assert f"{name:<14} " in said
        assert (tmp_path / name / "report.md").is_file()
    assert (tmp_path / "report.md").is_file()


STOPPED = """
import functools
from splatrl.commands import experiment
from splatrl.experiments import conduct, running
from tests.preloaded import start

def begin(run, cores, program):
    return start(*running.command(run, program)[1:])

conduct.train = functools.partial(running.train, begin=begin)
experiment.main()
"""
"""Runs ``splatrl-experiment``, with libraries already imported in its trainings."""


def test_ctrl_c_keeps_what_was_trained_and_says_how_to_continue(tmp_path: Path) -> None:
    settings = [setting for setting in SETTINGS if not setting.startswith("collector.total_frames")]
    settings += ["logger.video=false", "evaluation.starts=8"]
    quoted = ",".join(f"'{override}'" for override in [*tiny_overrides(tmp_path), *settings])
    words = ["name=grid", f"folder={tmp_path}/asked for", f"scene_overrides.backyard=[{quoted}]", "seeds=[3]", "jobs=1"]
    words += ["~experiments.grid.arms.none", "~experiments.grid.arms.long", "frames=100000"]
    run = os.environ.get("PYTEST_XDIST_TESTRUNUID", str(os.getpid()))  # the program uses this run's interpreter
    process = start("-c", STOPPED, *words, env=os.environ | {"PYTEST_XDIST_TESTRUNUID": run})
    last = tmp_path / "asked for" / "grid" / "backyard-distance-s3" / "checkpoints" / "last.pt"
    while not last.exists() and process.poll() is None:
        time.sleep(0.01)
    process.send_signal(signal.SIGINT)
    output, _ = process.communicate(timeout=120)
    assert process.returncode == 130, output
    (line,) = [line for line in output.splitlines() if line.startswith("stopped")]
    again = line.removeprefix("stopped; finished work is kept; continue with: ")
    assert shlex.split(again) == ["splatrl-experiment", *words]
    assert 0 < load_checkpoint(last)["ppo"]["frames"] < 100000


def test_a_training_is_run_reported_and_not_run_again(
    tmp_path: Path, command: Command, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def begin(run: Run, cores: int, program: Sequence[str]) -> Process:
        return start(*running.command(run, program)[1:])

    monkeypatch.setattr(conduct, "train", functools.partial(running.train, begin=begin))
    settings = [setting for setting in SETTINGS if not setting.startswith("collector.total_frames")]
    settings += ["logger.video=false", "evaluation.starts=8"]
    quoted = ",".join(f"'{override}'" for override in [*tiny_overrides(tmp_path), *settings])
    folder = tmp_path / "experiments"
    words = ["name=grid", f"folder={folder}", f"scene_overrides.backyard=[{quoted}]", "seeds=[3]", "jobs=1"]
    words += ["~experiments.grid.arms.none", "~experiments.grid.arms.long"]
    command(*words, "frames=300")
    said = capsys.readouterr()
    assert "1 of 1 trainings to do, 256 frames" in said.out
    assert "kitchen is left out" in said.err and "recaptured" not in said.err  # no arm names the other one
    run = folder / "grid" / "backyard-distance-s3"
    figures = json.loads((run / "evaluation.json").read_text())
    assert (figures["frames"], figures["seed"]) == (256, 3)
    report = (folder / "grid" / "report.md").read_text()
    assert "| backyard | with curriculum | 3 |" in report
    assert "backyard-distance-s3/starts.png" in report
    written = (run / "evaluation.json").stat().st_mtime_ns
    command(*words, "frames=300", "jobs=2")
    assert "0 of 1 trainings to do" in capsys.readouterr().out
    assert (run / "evaluation.json").stat().st_mtime_ns == written
    with pytest.raises(SystemExit) as refused:
        command(*words, "frames=384")
    assert str(run) in str(refused.value)
    assert "collector.total_frames: asked for 384, found 300" in str(refused.value)
    assert "fresh=true" in str(refused.value)
    (splat,) = tmp_path.glob("*.ply")
    faded = tiny_gaussians()
    faded.opacities *= 0.9
    write_gaussians(splat, faded)
    with pytest.raises(SystemExit) as refused:
        command(*words, "frames=300")
    assert f"{run} was trained with other settings or files: scene: its Gaussians" in str(refused.value)
    assert (run / "evaluation.json").stat().st_mtime_ns == written


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ([], "sim2real, loop, generalise, weather, demonstrations, all, got nothing"),
        (["name=gird"], "got gird"),
        (
            ["name=grid", "scenes=[cellar]"],
            "expected names from yards, unseen_yards, backyard, kitchen, recaptured, or existing paths, got cellar",
        ),
        (["name=grid", "scenes=[kitchen]"], "found none; type kitchen=<path of its file>"),
        (["name=grid", "scenes=[]"], "scenes: expected at least one, got none"),
        (
            ["name=grid", "scenes=[cellar]", '+scene_overrides.cellar=["scene=a/cellar"]'],
            "scenes=cellar: expected a scene that exists, found none; make a/cellar first",
        ),
        (["name=grid", "seeds=[0,0]"], "seeds: expected different ones, got [0, 0]"),
        (["name=grid", "seeds=[true]"], "seeds: expected whole numbers in brackets such as [0,1], got [True]"),
        (["name=grid", "sedes=[0]"], "did you mean seeds"),
        (["name=grid", "~experiments.grid.arms"], "experiments.grid: expected the keys arms, "),
        (
            ["name=grid", "experiments.grid.arms.none.scenes=[cellar]"],
            "arms.none.scenes: expected names from yards, unseen_yards, backyard, kitchen, recaptured, got cellar; "
            "define it by '+scene_overrides.cellar=",
        ),
    ],
)
def test_a_mistake_is_reported_before_anything_is_trained(command: Command, words: list[str], said: str) -> None:
    with pytest.raises(SystemExit) as refused:
        command(*words)
    assert said in str(refused.value)


def test_a_failed_training_is_named_at_the_end(
    tmp_path: Path, command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(conduct, "train", lambda runs, *_: [runs[0]])
    with pytest.raises(SystemExit) as ended:
        command("name=grid", f"folder={tmp_path}", "scenes=[backyard]", "seeds=[0]")
    assert str(tmp_path / "grid" / "backyard-distance-s0") in str(ended.value)
    assert (tmp_path / "grid" / "report.md").is_file()


def test_a_run_with_changed_settings_is_restarted_only_if_fresh_is_set(
    tmp_path: Path, command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(conduct, "train", lambda *_: [])
    run = tmp_path / "grid" / "backyard-none-s0"
    (run / "checkpoints").mkdir(parents=True)
    (run / "checkpoints" / "last.pt").touch()
    OmegaConf.save(load_config(["curriculum=none"]), run / "config.yaml")
    words = ["name=grid", f"folder={tmp_path}", "scenes=[backyard]", "seeds=[0]"]
    with pytest.raises(SystemExit, match="asked for 30000, found"):
        command(*words)
    assert run.exists()
    command(*words, "fresh=true")
    assert not run.exists()


def test_arms_are_trained_in_a_captured_place_that_is_given(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    trained: list[Run] = []

    def nothing(runs: Sequence[Run], *_: object) -> list[Run]:
        trained.extend(runs)
        return []

    monkeypatch.setattr(conduct, "train", nothing)
    garden = tmp_path / "my garden"
    write_scene(garden, tiny_gaussians(), tiny_capture(tmp_path / "images"))
    for name in ("grid", "fps"):
        words = [f"name={name}", f"folder={tmp_path / 'out'}", f"scenes=['{garden}/',backyard]", "seeds=[0]", "jobs=1"]
        experiment(load_config(words, "experiment"))
    names = {run.folder.name for run in trained}
    assert {"my garden-distance-s0", "my garden-none-s0", "my garden-gru-s0", "backyard-distance-s0"} <= names
    assert "backyard-gru-s0" not in names  # the named scenes only select from those of an arm
    config = next(run.config for run in trained if run.folder.name == "my garden-none-s0")
    assert config["scene"]["path"] == str(garden) and config["robot"]["height"] == ABOVE
    assert build_world(
        load_config(next(run.overrides for run in trained if run.scene == "my garden"))
    ).plan.starts.any()


def test_missing_scenes_are_refused(tmp_path: Path) -> None:
    for scenes, message in (("[garden/]", "or existing paths, got garden/"), ("[recaptured]", "name=loop")):
        with pytest.raises(ValueError, match=message):
            experiment(load_config(["name=grid", f"folder={tmp_path}/none", f"scenes={scenes}"], "experiment"))


def test_an_experiment_is_prepared_first_unless_only_a_report_is_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[tuple[Path, list[str]]] = []
    monkeypatch.setattr(conduct, "train", lambda *_: [])
    monkeypatch.setattr(recapture, "recapture", lambda folder, scenes: made.append((folder, list(scenes))))
    words = ["name=loop", f"folder={tmp_path}", "jobs=1"]
    (tmp_path / "loop").mkdir()
    experiment(load_config([*words, "report_only=true"], "experiment"))
    assert not made
    experiment(load_config(words, "experiment"))
    assert made == [(tmp_path / "loop", ["yards", "unseen_yards", "backyard", "recaptured"])]
