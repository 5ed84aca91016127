"""Disks that are full and folders that nobody may write to: commands work, or say one line that names the path."""

import os
import shlex
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from splatrl.commands import scene, train
from splatrl.scenes import cache, write_gaussians
from tests.tiny import tiny_gaussians

COMMANDS: dict[str, Callable[[], object]] = {"train": train.main, "scene": scene.main}
SMALL = (
    "train scene=garden/ device=cpu robot.height=0.5 landmarks.goal=[0.5,1.0,0.0] robot.image_width=16 "
    "robot.image_height=12 network.pool=1 robot.body.size=[0.3,0.3,0.2] task.motion.step=0.5 "
    "task.motion.lower=[-1.0,-1.5] task.motion.upper=[1.0,1.5] collector.total_frames=128 "
    "collector.frames_per_batch=128 env.num_envs=16 evaluation.batch_size=32 hydra.run.dir=run"
)


@pytest.fixture
def garden(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A scene's folder in the working folder, and an empty cache."""
    (tmp_path / "garden").mkdir()
    write_gaussians(tmp_path / "garden" / "splat.ply", tiny_gaussians())
    (tmp_path / "garden" / "scene.yaml").write_text("splat: splat.ply\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("SPLATRL_CACHE", str(tmp_path / "cache"))
    cache._warn_unwritable.cache_clear()
    return tmp_path / "garden"


def run(monkeypatch: pytest.MonkeyPatch, typed: str) -> None:
    words = shlex.split(typed)
    monkeypatch.setattr(sys, "argv", [f"splatrl-{words[0]}", *words[1:]])
    COMMANDS[words[0]]()


def listing(folder: Path) -> dict[str, tuple[int, int]]:
    return {str(path): (path.stat().st_size, path.stat().st_mtime_ns) for path in [folder, *folder.rglob("*")]}


def test_a_training_writes_nothing_into_its_scene_and_needs_no_cache(
    garden: Path, monkeypatch: pytest.MonkeyPatch, recwarn: pytest.WarningsRecorder
) -> None:
    Path("cache").write_text("a file, where no folder can be made")
    before = listing(garden)
    run(monkeypatch, SMALL)
    assert listing(garden) == before and Path("run/evaluation.json").exists()
    said = [str(warning.message) for warning in recwarn if "cannot keep caches here" in str(warning.message)]
    assert len(said) == 1 and said[0].startswith(str(garden.parent / "cache"))


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs /proc")
@pytest.mark.parametrize(
    ("typed", "path"), [(SMALL, "run/"), ("scene garden/splat.ply --height 0.5 --out mine", "mine")]
)
@pytest.mark.parametrize(("code", "reason"), [(28, "No space left on device"), (30, "Read-only file system")])
def test_a_full_or_read_only_disk_is_one_line_that_names_the_path(
    garden: Path, monkeypatch: pytest.MonkeyPatch, typed: str, path: str, code: int, reason: str
) -> None:
    synced = os.fsync

    def fails(descriptor: int) -> None:
        if path in os.readlink(f"/proc/self/fd/{descriptor}"):
            raise OSError(code, reason)
        synced(descriptor)

    monkeypatch.setattr(os, "fsync", fails)
    with pytest.raises(SystemExit) as ended:
        run(monkeypatch, typed)
    said = str(ended.value.code)
    assert said.startswith(f"splatrl-{typed.split()[0]}: ") and "\n" not in said
    assert f"cannot write: {reason}" in said and path in said
    assert not list(garden.parent.rglob("*.tmp"))
