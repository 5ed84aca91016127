"""Episodes that a person drove survive whatever ends the recording, and the same recording continues from them."""

import errno
from pathlib import Path
from typing import Any, NoReturn

import pytest
import torch

from splatrl.datasets import planner_episodes
from splatrl.envs.world import World
from splatrl.viewer import takes as module
from splatrl.viewer.takes import Takes


def made(**settings: Any) -> dict[str, Any]:
    return {"settings": {"seed": 0, "out": "demos", **settings}, "scene": "a digest", "files": {}}


@pytest.fixture
def left(world: World, tmp_path: Path) -> Takes:
    """An interrupted recording of three episodes."""
    takes, frames = Takes(world, tmp_path, made()), planner_episodes(world, 3).frames.exclude("optimal")
    for number in range(3):
        takes.add(frames[frames["episode"] == number].exclude("episode", "frame"))
    return takes


def test_a_recording_continues_from_the_episodes_of_an_interrupted_one(left: Takes, tmp_path: Path) -> None:
    (tmp_path / "4.pt.0123abcd.tmp").write_bytes(b"half of an episode, in whose writing the recording was killed")
    again = Takes(left.world, tmp_path, made(out="elsewhere", episodes=5))
    one, other = (takes.demonstrations().frames for takes in (left, again))
    assert all(torch.equal(value, other[key]) for key, value in one.items(True, True))
    (tmp_path / "1.pt").unlink()  # by hand
    again = Takes(left.world, tmp_path, made())
    again.add(left.episodes[0])
    assert sorted(path.name for path in tmp_path.iterdir()) == ["2.pt", "3.pt", "4.pt"]
    again.forget()
    assert not tmp_path.exists()


def test_episodes_of_another_recording_or_damaged_ones_are_refused(left: Takes, tmp_path: Path) -> None:
    refused = r"1\.pt: expected an episode of this recording, got one that .*: seed: asked for 7, found 0; repeat its"
    with pytest.raises(ValueError, match=refused):
        Takes(left.world, tmp_path, made(seed=7))
    with pytest.raises(ValueError, match=r"1\.pt: .*: scene: its Gaussians or its free space differ; repeat"):
        Takes(left.world, tmp_path, made() | {"scene": "another digest"})
    (tmp_path / "2.pt").write_bytes((tmp_path / "2.pt").read_bytes()[:-500])
    with pytest.raises(ValueError, match=r"2\.pt: expected a complete checkpoint"):
        Takes(left.world, tmp_path, made())


def test_episodes_for_which_the_disk_has_no_room_are_written_with_the_next(
    left: Takes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(path: Path, state: object) -> NoReturn:
        raise OSError(errno.ENOSPC, "cannot write: No space left on device", str(path))

    with (
        monkeypatch.context() as patch,
        pytest.warns(UserWarning, match=r"No space left .*4\.pt'; until there is room"),
    ):
        patch.setattr(module, "save_checkpoint", full)
        left.add(left.episodes[0])
    left.add(left.episodes[1])
    assert len(Takes(left.world, tmp_path, made()).episodes) == len(left.episodes) == 5
