"""The commands from the outside: a run folder, a kill, a resume and an evaluation."""

import json
import subprocess
import sys
import time
from pathlib import Path

import pytest
import torch

from splatrl.commands import train
from splatrl.training import load_checkpoint
from tests.tiny import tiny_overrides

SETTINGS = [
    "collector.total_frames=1280",
    "collector.frames_per_batch=128",
    "env.num_envs=16",
    "loss.mini_batch_size=64",
    "loss.ppo_epochs=2",
    "checkpoint.interval=256",
    "logger.test_interval=512",
    "logger.num_test_episodes=8",
    "evaluation.batch_size=32",
]


def command(module: str, *arguments: str) -> subprocess.Popen[str]:
    line = [sys.executable, "-m", f"splatrl.commands.{module}", *arguments]
    return subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


def finish(process: subprocess.Popen[str]) -> str:
    output, _ = process.communicate(timeout=300)
    assert process.returncode == 0, output
    return output


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    return tiny_overrides(tmp_path_factory.mktemp("scene"))


@pytest.fixture(scope="module")
def run(scene: list[str], tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    folder = tmp_path_factory.mktemp("run")
    return folder, finish(command("train", *scene, *SETTINGS, f"hydra.run.dir={folder}"))


def test_a_run_leaves_figures_pictures_and_checkpoints(run: tuple[Path, str]) -> None:
    folder, output = run
    files = {path.name for path in folder.iterdir()}
    pictures = {"learning_curve.png", "starts.png", "success_map.png", "rollouts.mp4"}
    assert pictures | {"config.yaml", "progress.csv", "evaluation.json", "checkpoints"} <= files
    assert not [path for path in folder.rglob("*") if "tmp" in path.name]
    assert "success 0." in output or "success 1." in output
    assert str(folder) in output
    summary = json.loads((folder / "evaluation.json").read_text())
    keys = {"success_rate", "success_rate_argmax", "spl", "collision_rate", "frames", "wall_seconds", "episodes"}
    assert keys <= summary.keys()
    assert summary["frames"] == 1280
    assert summary["episodes"] == summary["start_poses"] > 0
    assert 0 <= summary["spl"] <= summary["success_rate"] <= 1


def test_a_killed_run_goes_on_as_if_nothing_had_happened(
    run: tuple[Path, str], scene: list[str], tmp_path: Path
) -> None:
    killed = command("train", *scene, *SETTINGS, f"hydra.run.dir={tmp_path}")
    last = tmp_path / "checkpoints" / "last.pt"
    while not last.exists() and killed.poll() is None:
        time.sleep(0.01)
    killed.kill()
    killed.wait()
    frames = load_checkpoint(last)["ppo"]["frames"]
    assert 0 < frames < 1280
    finish(command("train", f"resume={tmp_path}"))
    whole, resumed = (load_checkpoint(folder / "checkpoints" / "last.pt") for folder in (run[0], tmp_path))
    for key, value in whole["ppo"]["model"].items():
        assert torch.equal(value, resumed["ppo"]["model"][key]), key
    assert torch.equal(whole["ppo"]["torch_rng"], resumed["ppo"]["torch_rng"])
    assert torch.equal(whole["ppo"]["carried"]["pixels"], resumed["ppo"]["carried"]["pixels"])
    assert [row["frames"] for row in resumed["history"]] == [row["frames"] for row in whole["history"]]
    figures = [json.loads((folder / "evaluation.json").read_text()) for folder in (run[0], tmp_path)]
    assert figures[0] | {"wall_seconds": 0} == figures[1] | {"wall_seconds": 0}


def test_evaluating_again_gives_the_same_figures(run: tuple[Path, str]) -> None:
    folder, _ = run
    before = json.loads((folder / "evaluation.json").read_text())
    (folder / "evaluation.json").unlink()
    finish(command("evaluate", f"run={folder}", "video=false"))
    assert json.loads((folder / "evaluation.json").read_text()) == before


def test_a_resume_of_nothing_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["splatrl-train", f"resume={tmp_path / 'nowhere'}"])
    with pytest.raises(SystemExit) as ended:
        train.main()
    assert ended.value.code != 0
    assert "expected a run folder" in capsys.readouterr().err
