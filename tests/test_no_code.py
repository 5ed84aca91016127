"""Files from strangers run no code; tests/configuration/test_targets.py checks what configs may name.

Each file would create a folder or file if its content were run, as the readers that most programs use would do.
"""

import json
import os
import pickle
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from splatrl.array_files import read_arrays
from splatrl.collision.point_clouds import read_points
from splatrl.configuration import run_config
from splatrl.datasets.folder import read_demonstrations
from splatrl.documents import read_json, read_yaml
from splatrl.envs.drawing.sprite import load_sprite
from splatrl.evaluation.clip_files import read_clips
from splatrl.images import open_video, read_photo
from splatrl.physics.dense import Dense
from splatrl.physics.mjcf import read_mjcf
from splatrl.scenes import read_scene
from splatrl.scenes.formats import read_gaussians
from splatrl.training import load_checkpoint
from tests.fuzzing.formats import around_demonstrations


class Maker:
    """Creates a folder when it is unpickled."""

    def __init__(self, made: Path) -> None:
        self.made = made

    def __reduce__(self) -> tuple[Callable[..., object], tuple[str]]:
        return os.mkdir, (str(self.made),)


def pickled_array(path: Path, made: Path, name: str) -> None:
    values = np.empty(1, object)
    values[0] = Maker(made)
    np.savez(path, **{name: values})  # type: ignore[arg-type]


def written_header(path: Path, made: Path, name: str) -> None:
    """Write an array whose header is a Python expression."""
    header = f"__import__('os').mkdir({str(made)!r})".encode().ljust(245) + b"\n"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr(f"{name}.npy", b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header)


def hidden_behind(path: Path, made: Path) -> None:
    """Write a checkpoint with two entries of one name, one harmful and one harmless: readers may take either."""
    torch.save({"state": torch.zeros(3)}, path)
    with zipfile.ZipFile(path) as archive:
        entries = [(entry.filename, archive.read(entry)) for entry in archive.infolist()]
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in entries:
            if name.endswith("data.pkl"):
                archive.writestr(name, pickle.dumps(Maker(made), 2))
            archive.writestr(name, content)


class Program(torch.nn.Module):
    """Creates a file when TorchScript loads it."""

    made: str
    training: bool

    def __init__(self, made: str) -> None:
        super().__init__()
        self.made = made

    @torch.jit.export
    def __getstate__(self) -> str:
        return self.made

    @torch.jit.export
    def __setstate__(self, made: str) -> None:
        self.made = made
        self.training = torch.from_file(made, True, 1).numel() > 1  # used, so that it is not optimised away


def scripted(path: Path, made: Path) -> None:
    """Write a TorchScript program, which torch.load would pass to its interpreter."""
    torch.jit.script(Program(str(made))).save(path)


def memory_mapped(folder: Path, made: Path, header: dict[str, object]) -> None:
    """Read demonstrations with a pickle where tensordict stores its own, and a header that may make it load that."""
    around_demonstrations(folder)
    (folder / "memmap" / "other.pickle").write_bytes(pickle.dumps({"extra": Maker(made)}))
    path = folder / "memmap" / "meta.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | header))
    read_demonstrations(folder)


def bare_pickle(path: Path, made: Path) -> None:
    path.write_bytes(pickle.dumps(Maker(made)))


def programmed_picture(path: Path, made: Path) -> None:
    """Write PostScript, for which Pillow starts Ghostscript."""
    path.write_text(f"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n(%pipe%mkdir {made}) (r) file\n%%EOF\n")


def comment_in_a_picture(path: Path, made: Path) -> None:
    """Write a GIF under another name, with a Python expression as its comment."""
    Image.new("P", (4, 4)).save(path, "GIF", comment=f"__import__('os').mkdir({str(made)!r})".encode())


def tagged(made: Path) -> str:
    return f"name: !!python/object/apply:os.mkdir [{made}]\n"


Write = Callable[[Path, Path], object]
Read = Callable[[Path], object]
WAYS: dict[str, tuple[str, Write, Read]] = {
    "a pickle in an array": ("a.npz", lambda path, made: pickled_array(path, made, "solid"), read_arrays),
    "a pickle in the weights of a gait": (
        "a.npz",
        lambda path, made: pickled_array(path, made, "weight0"),
        lambda path: Dense.load(path, 3, 2),
    ),
    "a pickle named as arrays": ("a.npz", bare_pickle, read_arrays),
    "an expression as an array's header": (
        "a.npz",
        lambda path, made: written_header(path, made, "solid"),
        read_arrays,
    ),
    "a pickle as a checkpoint": ("last.pt", bare_pickle, load_checkpoint),
    "a pickle in a checkpoint": ("last.pt", lambda path, made: torch.save({"a": Maker(made)}, path), load_checkpoint),
    "a pickle hidden behind a checkpoint's": ("last.pt", hidden_behind, load_checkpoint),
    "a program as a checkpoint": ("last.pt", scripted, load_checkpoint),
    "a tag in a scene": (
        "scene.yaml",
        lambda path, made: path.write_text(tagged(made)),
        lambda path: read_scene(path.parent),
    ),
    "a tag in a run": (
        "config.yaml",
        lambda path, made: path.write_text(tagged(made)),
        lambda path: run_config(path.parent),
    ),
    "a tag in YAML": ("a.yaml", lambda path, made: path.write_text(tagged(made)), read_yaml),
    "an expression in JSON": (
        "a.json",
        lambda path, made: path.write_text(f"__import__('os').mkdir({str(made)!r})"),
        read_json,
    ),
    "PostScript as a photo": ("a.jpg", programmed_picture, read_photo),
    "PostScript as a sprite": ("a.png", programmed_picture, load_sprite),
    "a picture of another kind": ("a.png", comment_in_a_picture, load_sprite),
    "a list of other files as a video": (
        "a.mp4",
        lambda path, made: path.write_text(f"ffconcat version 1.0\nfile subfile:{made}\n"),
        lambda path: open_video(path).__enter__(),
    ),
    "a stream that asks a server": (
        "a.mp4",
        lambda path, made: path.write_text("#EXTM3U\n#EXTINF:1,\nhttp://127.0.0.1:9/a.ts\n"),
        lambda path: open_video(path).__enter__(),
    ),
    "a pickle as a splat": ("a.ply", bare_pickle, read_gaussians),
    "a pickle as a point cloud": ("a.pcd", bare_pickle, read_points),
    "a formula as a label": (
        "labels.csv",
        lambda path, made: path.write_text(f"video,frame,actions\n=cmd|'/c mkdir {made}'!A1,0,forward\n"),
        lambda path: read_clips(path.parent, ["forward"]),
    ),
    "a plugin in a robot": (
        "a.xml",
        lambda path, made: path.write_text(f'<mujoco><extension><plugin plugin="{made}.so"/></extension></mujoco>'),
        read_mjcf,
    ),
}


@pytest.mark.parametrize("way", WAYS)
def test_a_file_is_refused_and_not_run(way: str, tmp_path: Path) -> None:
    name, write, read = WAYS[way]
    made, path = tmp_path / "made", tmp_path / "given" / name
    path.parent.mkdir()
    write(path, made)
    with pytest.raises((ValueError, FileNotFoundError)):
        read(path)
    assert not made.exists()


HEADERS: list[dict[str, object]] = [
    {"_type": "<class 'tensordict._td.TensorDict'>"},
    {"_type": "<class 'os.system'>"},
    {"_type": "<class 'tensordict.tensorclass.NonTensorData'>", "_is_non_tensor": True},
    {"extra": {"type": "non_tensor"}, "_non_tensordict_keys": ["extra"]},
]


@pytest.mark.parametrize("header", HEADERS)
def test_a_pickle_beside_demonstrations_is_not_loaded(header: dict[str, object], tmp_path: Path) -> None:
    made, folder = tmp_path / "made", tmp_path / "demos"
    folder.mkdir()
    try:
        memory_mapped(folder, made, header)
    except ValueError as error:
        assert str(folder) in str(error)
    assert not made.exists()


def test_other_readers_do_run_the_code_in_such_files(tmp_path: Path) -> None:
    made, path = tmp_path / "made", tmp_path / "a"
    bare_pickle(path, made)
    pickle.loads(path.read_bytes())
    assert made.exists()
    made.rmdir()
    torch.save({"a": Maker(made)}, path)
    torch.load(path, weights_only=False)
    assert made.exists()
    made.rmdir()
    scripted(path, made)
    torch.load(path, weights_only=False)
    assert made.exists()
    made.unlink()
    pickled_array(tmp_path / "a.npz", made, "solid")
    with np.load(tmp_path / "a.npz", allow_pickle=True) as arrays:
        arrays["solid"]
    assert made.exists()
