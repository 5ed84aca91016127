import json
import sys
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from omegaconf import DictConfig
from PIL import Image

from splatrl import clips_command
from splatrl.build import build_model, build_world
from splatrl.commands.clips import action_names, altered, main, record_clips, score_experiment
from splatrl.configuration import load_config, save_config
from splatrl.evaluation.clip_files import read_clips
from splatrl.scenes import write_gaussians
from splatrl.training import save_checkpoint
from tests.tiny import HEIGHT, tiny_gaussians

NAMES = ("forward", "back", "left", "right")


def config(folder: Path, *more: str) -> DictConfig:
    """Of the sim2real task in the tiny room, in its north-east."""
    path = folder / "tiny.ply"
    if not path.exists():
        write_gaussians(path, tiny_gaussians())
    return load_config(
        [
            "scene=file",
            f"scene.path={path}",
            "task=sim2real",
            "collision=none",
            f"robot.height={HEIGHT}",
            "robot.image_width=16",
            "robot.image_height=12",
            "task.motion.step=0.25",
            "task.motion.angle_step_deg=30.0",
            "task.motion.lower=[-1.0,-1.5]",
            "task.motion.upper=[1.0,1.5]",
            "task.motion.spacing=0.25",
            "landmarks.object=[0.7,1.0,0.5]",
            "network.pool=1",
            *more,
        ]
    )


def save_run(folder: Path, cfg: DictConfig, seed: int) -> Path:
    """A run folder as if trained: a policy of random weights, that always prefers one action."""
    (folder / "checkpoints").mkdir(parents=True)
    save_config(cfg, folder)
    torch.manual_seed(seed)
    model = build_model(cfg, build_world(cfg).env(1))
    for name in ("last", "best"):
        logits = model.get_policy_head().module[0].module
        logits.bias.data = torch.zeros(4).index_fill(0, torch.tensor([seed if name == "last" else 3]), 4.0)
        save_checkpoint(folder / "checkpoints" / f"{name}.pt", {"ppo": {"model": model.state_dict()}})
    return folder


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three run folders: two that see one frame and go forward or back, and one that sees four and turns left."""
    folder = tmp_path_factory.mktemp("runs")
    cfg = config(folder)
    for seed, name in enumerate(("forward", "back")):
        save_run(folder / name, cfg, seed)
    save_run(folder / "stacked", config(folder, "memory=stack"), 2)
    return folder


@pytest.fixture(scope="module")
def clips(runs: Path) -> Path:
    """Three recorded clips."""
    record_clips(build_world(altered(config(runs), 0)), runs / "clips", count=3, height=18)
    return runs / "clips"


def command(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> None:
    monkeypatch.setattr(sys, "argv", ["splatrl-clips", *arguments])
    main()


def share(clips: Path, action: int) -> float:
    labels = [label for clip in read_clips(clips, NAMES) for label in clip.labels.values()]
    return sum(action in label for label in labels) / len(labels)


def test_runs_are_set_side_by_side(
    runs: Path, clips: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    names = [str(runs / name) for name in ("forward", "back", "stacked")]
    command(monkeypatch, f"run=[{','.join(names)}]", f"clips={clips}")
    printed = capsys.readouterr().out
    page = (clips / "clips.md").read_text()
    assert page in printed
    lines = [line for line in page.splitlines() if line.startswith("|")]
    assert lines[0] == f"| clip | frames | {' | '.join(names)} |"
    assert [line.split(" | ")[0] for line in lines[2:]] == ["| walk-00", "| walk-01", "| walk-02", "| total"]
    content = json.loads((clips / "clips.json").read_text())
    for action, name in enumerate(names):
        assert content[name]["rate"] == pytest.approx(share(clips, action))
        assert f"{content[name]['rate']:.3f}" in lines[-1]
        assert sum(one["frames"] for one in content[name]["clips"]) == int(lines[-1].split(" | ")[1])
    assert 0 < content[names[0]]["rate"] != content[names[1]]["rate"]


def test_clips_can_be_recorded_and_scored_at_once_with_another_checkpoint_and_output(
    runs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    record, output = tmp_path / "new", tmp_path / "report" / "here"
    command(
        monkeypatch,
        f"run={runs / 'forward'}",
        f"record={record}",
        f"clips={record}",
        f"output={output}",
        "checkpoint=best",
        "count=2",
        "height=24",
        "hand.frames=2",
    )
    found = read_clips(record, NAMES)
    assert [clip.name for clip in found] == ["walk-00", "walk-01"]
    assert {image.size for clip in found for image in clip.images()} == {(32, 24)}
    content = json.loads((output / "clips.json").read_text())
    assert content[str(runs / "forward")]["rate"] == pytest.approx(share(record, 3))
    assert not (record / "clips.md").exists()


def test_the_apple_hangs_in_recorded_clips_where_the_task_has_it(runs: Path, clips: Path, tmp_path: Path) -> None:
    cfg = config(runs)
    cfg.transforms.sprite = {}
    record_clips(build_world(altered(cfg, 0)), tmp_path / "bare", count=3, height=18)
    for clip, bare in zip(read_clips(clips, NAMES), read_clips(tmp_path / "bare", NAMES), strict=True):
        assert clip.labels == bare.labels
        redness = [red(list(each.images())[-1]) for each in (clip, bare)]
        assert redness[0] > redness[1] + 0.01


def red(image: Image.Image) -> float:
    """Share of clearly red pixels."""
    r, g, b = np.asarray(image).astype(int).transpose(2, 0, 1)
    return float(((r > 2 * g) & (r > 2 * b)).mean())


def test_an_experiment_is_scored_on_clips_of_each_scene_that_are_recorded_once(
    runs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    @dataclass
    class Run:
        scene: str
        folder: Path

    kept = clips_command.record_clips
    recorded: list[Path] = []

    def record(world: object, folder: Path) -> list[Path]:
        recorded.append(folder)
        return kept(world, folder, count=2, height=12)

    monkeypatch.setattr(clips_command, "record_clips", record)
    some = [Run("room", runs / "forward"), Run("room", runs / "back"), Run("other", runs / "forward")]
    rows = score_experiment(some, tmp_path)
    assert len(recorded) == 2
    assert sorted(path.name for path in (tmp_path / "clips").iterdir()) == ["other", "room"]
    assert [(row["run"], row["clip"]) for row in rows] == [
        (run, clip) for run in ("forward", "back", "forward") for clip in ("walk-00", "walk-01")
    ]
    assert all(0 <= row["matches"] <= row["frames"] for row in rows)
    score_experiment(some[:1], tmp_path)
    assert len(recorded) == 2


def test_the_altered_scene_is_another_yard_and_another_way_to_draw_any_scene() -> None:
    own = load_config([])
    other = altered(own, 2)
    assert (own.scene.seed, own.scene.clutter, own.renderer.tolerance) == (0, 0, 0.5)
    assert (other.scene.seed, other.scene.clutter) == (1002, 3)
    assert (other.renderer.antialiased, other.renderer.tolerance) == (False, 0.0)
    reference = altered(load_config(["renderer=reference", "scene=file", "scene.path=a.ply"]), 0)
    assert reference.renderer.antialiased is False and "tolerance" not in reference.renderer.views
    assert "clutter" not in reference.scene


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["run=a"], "clips: expected a folder of clips, or record"),
        (["run=[a,a]", "clips=c"], "run: expected different run folders, got a, a"),
        (["run=[]", "clips=c"], "run: expected different run folders, got none"),
        (["clips=c"], "expected a value for run"),
        (["run=nowhere", "clips=c"], "expected a run folder"),
    ],
)
def test_what_is_missing_is_said(monkeypatch: pytest.MonkeyPatch, arguments: list[str], message: str) -> None:
    monkeypatch.setenv("HYDRA_FULL_ERROR", "1")
    with pytest.raises((ValueError, FileNotFoundError), match=message):
        command(monkeypatch, *arguments)


def test_a_wrong_key_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(SystemExit, match="clip: no such key, did you mean clips"):
        command(monkeypatch, "run=a", "clip=c")


def test_a_task_without_named_actions_is_refused() -> None:
    motion = SimpleNamespace()
    with pytest.raises(ValueError, match="expected actions with names, got SimpleNamespace"):
        action_names(SimpleNamespace(task=SimpleNamespace(motion=motion)))
