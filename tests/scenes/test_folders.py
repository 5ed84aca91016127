"""The folder of a scene holds the files of one scene, whenever its writing is interrupted."""

import os
import shutil
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch

from splatrl.scenes import folders, read_scene, splitting, whole, write_gaussians
from splatrl.scenes.folders import AS_IT_IS, SceneFolder
from splatrl.scenes.scene import Scene
from tests.tiny import tiny_gaussians

BOUNDS = (-2.0, -2.0, 0.0), (2.0, 2.0, 1.0)


def tiny_scene(shift: float = 0.0) -> Scene:
    """Return a scene, moved along x."""
    gaussians = tiny_gaussians()
    gaussians.means[:, 0] += shift
    return Scene("tiny", gaussians, BOUNDS)


def split(folder: Path, size: float, force: bool = False, small: bool = False, shift: float = 0.0) -> None:
    """Split a scene into a folder."""
    SceneFolder(folder, small, size, force).write(tiny_scene(shift), BOUNDS, {})


def described(folder: Path, file: Path, scale: float, force: bool = False) -> None:
    """Write the scene of a splat file into a folder."""
    SceneFolder(folder, force=force).describe(file, "tiny", AS_IT_IS | {"scale": scale}, BOUNDS, {})


def contents(folder: Path) -> dict[str, bytes]:
    """Return the files of a folder, by name."""
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def stopping_at(call: int, function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function that is interrupted at one of its calls, the first of which is 1."""
    calls = []

    def stopped(*arguments: Any, **named: Any) -> Any:
        calls.append(arguments)
        if len(calls) == call:
            raise KeyboardInterrupt
        return function(*arguments, **named)

    return stopped


def test_a_split_that_is_interrupted_leaves_the_earlier_one_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    split(tmp_path / "town", 1.5)
    before = contents(tmp_path / "town")
    with monkeypatch.context() as patch:
        patch.setattr(splitting, "write_gaussians", stopping_at(3, write_gaussians))
        with pytest.raises(KeyboardInterrupt):
            split(tmp_path / "town", 1.0, force=True, shift=0.2)
    assert contents(tmp_path / "town") == before


def test_a_first_split_that_was_interrupted_can_be_typed_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = SceneFolder(tmp_path / "town", block=1.0)
    with monkeypatch.context() as patch:
        patch.setattr(splitting, "write_gaussians", stopping_at(3, write_gaussians))
        patch.setattr(shutil, "rmtree", lambda *_, **__: None)  # a killed process removes nothing
        with pytest.raises(KeyboardInterrupt):
            folder.write(tiny_scene(), BOUNDS, {})
    folder.check(tmp_path / "tiny.ply")
    folder.write(tiny_scene(), BOUNDS, {})
    split(tmp_path / "other", 1.0)
    assert contents(tmp_path / "town") == contents(tmp_path / "other"), "and nothing is left of the first try"


@pytest.mark.parametrize("call", [1, 4])
def test_while_files_are_replaced_a_folder_is_no_scene(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: int
) -> None:
    """Neither files of two splits nor a new splat with the frame of the old one are taken for a scene."""
    split(tmp_path / "town", 1.5)
    write_gaussians(tmp_path / "tiny.ply", tiny_gaussians())
    described(tmp_path / "garden", tmp_path / "tiny.ply", 1.0)
    with monkeypatch.context() as patch:
        patch.setattr(whole, "os", SimpleNamespace(replace=stopping_at(call, os.replace)))
        with pytest.raises(KeyboardInterrupt):
            split(tmp_path / "town", 1.0, force=True, shift=0.2)
    with pytest.raises((FileNotFoundError, ValueError)):
        read_scene(tmp_path / "town")
    with monkeypatch.context() as patch:
        patch.setattr(folders, "write_description", stopping_at(1, folders.write_description))
        write_gaussians(tmp_path / "tiny.ply", tiny_scene(0.5).gaussians)
        with pytest.raises(KeyboardInterrupt):
            described(tmp_path / "garden", tmp_path / "tiny.ply", 2.0, force=True)
    torch.testing.assert_close(read_scene(tmp_path / "garden").gaussians.means, tiny_gaussians().means)


@pytest.mark.parametrize("small", [False, True])
def test_a_split_replaces_all_blocks_of_an_earlier_one(tmp_path: Path, small: bool) -> None:
    split(tmp_path / "town", 1.0)
    (tmp_path / "town" / "notes.txt").write_text("mine")
    split(tmp_path / "town", 2.0, force=True, small=small)
    split(tmp_path / "other", 2.0, small=small)
    assert contents(tmp_path / "town") == contents(tmp_path / "other") | {"notes.txt": b"mine"}


def test_blocks_never_replace_the_splat_that_is_split(tmp_path: Path) -> None:
    source = tmp_path / "around.ply"
    write_gaussians(source, tiny_gaussians())
    for force in (False, True):
        with pytest.raises(FileExistsError, match=r"--split: expected a splat whose name no block has, got .*around"):
            SceneFolder(tmp_path, block=1.0, force=force).check(source)


def test_a_description_without_new_files_is_replaced_in_one_step(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_gaussians(tmp_path / "tiny.ply", tiny_gaussians())
    described(tmp_path, tmp_path / "tiny.ply", 1.0)
    before = contents(tmp_path)
    monkeypatch.setattr(whole, "os", SimpleNamespace(replace=stopping_at(1, os.replace)))
    with pytest.raises(KeyboardInterrupt):
        described(tmp_path, tmp_path / "tiny.ply", 2.0, force=True)
    assert contents(tmp_path) == before
