"""Clips of a scene that training never saw, and the scores of trained policies on them."""

from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from splatrl.building import build_world
from splatrl.configuration import load_config
from splatrl.evaluation.clip_files import read_clips
from splatrl.experiments import clip_scores
from splatrl.experiments.clip_scores import Watcher, altered, record_clips, score_experiment
from splatrl.motions import DriveMotion
from splatrl.runs import load_policy
from tests.experiments.trained import BEST, NAMES, config, three_runs, two_clips
from tests.tiny import HEIGHT


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return three_runs(tmp_path_factory.mktemp("runs"))


@pytest.fixture(scope="module")
def clips(runs: Path) -> Path:
    return two_clips(runs)


def test_a_run_is_scored_with_the_requested_checkpoint(runs: Path, clips: Path) -> None:
    labels = [list(clip.labels.values()) for clip in read_clips(clips, NAMES)]
    for checkpoint, action in ((None, 0), ("best", BEST)):
        found = Watcher.of_run(runs / "forward", checkpoint).score(clips)
        assert [one.frames for one in found] == [len(one) for one in labels]
        assert [one.matches for one in found] == [sum(action in label for label in one) for one in labels]


def test_recorded_clips_show_the_apple_unless_the_sprite_is_disabled(runs: Path, clips: Path, tmp_path: Path) -> None:
    bare = build_world(altered(config(runs, "transforms/sprite=none"), 0))
    record_clips(bare, tmp_path / "bare", count=2, height=18)
    for clip, without in zip(read_clips(clips, NAMES), read_clips(tmp_path / "bare", NAMES), strict=True):
        assert clip.labels == without.labels
        redness = [red(list(each.images())[-1]) for each in (clip, without)]
        assert redness[0] > redness[1] + 0.01


def red(image: Image.Image) -> float:
    """Return the fraction of clearly red pixels."""
    r, g, b = np.asarray(image).astype(int).transpose(2, 0, 1)
    return float(((r > 2 * g) & (r > 2 * b)).mean())


def test_an_experiment_is_scored_on_clips_that_are_recorded_once_per_scene(
    runs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    @dataclass
    class Run:
        scene: str
        folder: Path

    kept = clip_scores.record_clips
    recorded: list[Path] = []

    def record(world: object, folder: Path) -> list[Path]:
        recorded.append(folder)
        return kept(world, folder, count=2, height=12)

    monkeypatch.setattr(clip_scores, "record_clips", record)
    some = [Run("room", runs / "forward"), Run("room", runs / "back"), Run("other", runs / "forward")]
    rows = score_experiment(some, tmp_path)
    assert len(recorded) == 2
    assert sorted(path.name for path in (tmp_path / "clips").iterdir()) == ["other", "room"]
    assert [(row["run"], row["clip"]) for row in rows] == [
        (run, clip) for run in ("forward", "back", "forward") for clip in ("walk-00", "walk-01")
    ]
    assert all(0 <= row["matches"] <= row["frames"] for row in rows)
    (tmp_path / "clips" / "room" / "walk-09").mkdir()
    assert {row["clip"] for row in score_experiment(some[:1], tmp_path)} == {"walk-00", "walk-01"}
    assert len(recorded) == 3, "the scene may have changed since the last scoring"


def test_an_altered_scene_is_another_yard_and_is_rendered_in_another_way() -> None:
    own = load_config([])
    other = altered(own, 2)
    assert (own.scene.seed, own.scene.clutter, own.renderer.tolerance) == (0, 0, 0.5)
    assert (other.scene.seed, other.scene.clutter) == (1002, 3)
    assert (other.renderer.cpu.antialiased, other.renderer.cpu.tolerance) == (False, 0.0)
    assert (other.renderer.cuda.antialiased, other.renderer.cuda.tolerance) == (False, 0.0)
    reference = altered(load_config(["renderer=reference", "scene=file", "scene.path=a.ply"]), 0)
    assert reference.renderer.cpu.antialiased is False and "tolerance" not in reference.renderer
    assert "clutter" not in reference.scene


def test_a_task_without_named_actions_is_refused(runs: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    trained = load_policy(runs / "forward")
    driven = replace(trained, world=replace(trained.world, task=SimpleNamespace(motion=DriveMotion(HEIGHT))))
    monkeypatch.setattr(type(trained), "beginning", lambda self: trained.world.env(1).reset())
    monkeypatch.setattr(clip_scores, "load_policy", lambda *given, **more: driven)
    told = r"named actions, got DriveMotion; run_policy\.py of splatrl-export prints continuous actions$"
    with pytest.raises(ValueError, match=told):
        Watcher.of_run(runs / "forward")
