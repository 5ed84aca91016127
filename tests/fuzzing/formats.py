"""Every format of files from strangers: intact files, and functions that damage and read them."""

import functools
import gzip
import io
import json
import random
import struct
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import av
import numpy as np
import torch
from omegaconf import OmegaConf
from PIL import Image

from splatrl.array_files import read_arrays
from splatrl.capture.recordings import colmap, polycam, record3d, stray_scanner, transforms
from splatrl.capture.recordings.base import Recording, read_depth
from splatrl.capture.recordings.reading import check_recording
from splatrl.capture.truth import read_truth
from splatrl.collision import Occupancy
from splatrl.collision.point_clouds import read_points
from splatrl.configuration import load_config, run_config
from splatrl.datasets.folder import VERSION, read_demonstrations
from splatrl.envs.drawing.sprite import load_sprite
from splatrl.evaluation.clip_files import read_clips, read_labels
from splatrl.evaluation.episode_sets import read_episodes
from splatrl.files import refusing
from splatrl.images import read_photo
from splatrl.physics import read_mjcf
from splatrl.physics.robots import mjcf_path
from splatrl.scenes.blocks import read_blocks
from splatrl.scenes.description import read_description
from splatrl.scenes.formats import read_gaussians
from splatrl.scenes.gaussians import Gaussians
from splatrl.scenes.placement import nerfstudio_transform
from splatrl.training import load_checkpoint
from tests.fuzzing.damage import behind_checksums, behind_gzip, behind_zip, damaged
from tests.scenes.samples import (
    assert_valid,
    compressed_ply_bytes,
    ply_bytes,
    ply_fields,
    random_spz,
    sample_gaussians,
    sog_entries,
    spz_4_bytes,
    spz_bytes,
)

VARIANTS = 48
"""Intact files per format, which are made once."""


def _nothing(folder: Path) -> None:
    """Write no files around the damaged one."""


@dataclass(frozen=True)
class Format:
    """A file format: functions that make intact files, damage them and read them.

    Attributes:
        name: file name, within the folder that is read.
        whole: makes the content of an intact file.
        read: reads the file; any exception is a fault, except a ValueError that names this file or one around it.
        damage: damages that content.
        around: writes the files that must lie around this one.
    """

    name: str
    whole: Callable[[random.Random], Any]
    read: Callable[[Path], object]
    damage: Callable[[Any, random.Random], bytes] = damaged
    around: Callable[[Path], None] = _nothing

    @functools.cached_property
    def wholes(self) -> list[Any]:
        """Contents of intact files, as varied as the format allows."""
        return [self.whole(random.Random(number)) for number in range(VARIANTS)]


def _gaussians(path: Path) -> Gaussians:
    gaussians = read_gaussians(path)
    assert_valid(gaussians)
    return gaussians


def _spz(rng: random.Random) -> bytes:
    version, degree = rng.choice((2, 3)), rng.randrange(4)
    return spz_bytes(*random_spz(version, degree), version, degree)


@functools.cache
def _sog() -> dict[str, bytes]:
    return sog_entries(bands=1)[0]


def _beside_meta(folder: Path) -> None:
    for name, content in _sog().items():
        (folder / name).write_bytes(content)


def _ply(rng: random.Random) -> bytes:
    kind = rng.choice(("ascii", "binary_little_endian", "binary_big_endian"))
    return ply_bytes(ply_fields(sample_gaussians(4, rng.randrange(2))), kind)


def _compressed(rng: random.Random) -> bytes:
    values = np.random.default_rng(rng.randrange(1 << 32))
    chunks = np.linspace(-3.0, 3.0, 36).reshape(2, 18)
    return compressed_ply_bytes(chunks, values.integers(0, 1 << 32, (258, 4)).astype(np.uint32))


def _pcd(rng: random.Random) -> bytes:
    header = "VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 5\nHEIGHT 1\nPOINTS 5\nDATA "
    rows = np.arange(15, dtype="<f4")
    if rng.random() < 0.5:
        return header.encode() + b"binary\n" + rows.tobytes()
    return (header + "ascii\n" + "\n".join(" ".join(map(str, row)) for row in rows.reshape(5, 3))).encode()


def _entries(archive: bytes) -> dict[str, bytes]:
    with zipfile.ZipFile(io.BytesIO(archive)) as opened:
        return {name: opened.read(name) for name in opened.namelist()}


@functools.cache
def _checkpoint() -> dict[str, bytes]:
    stream = io.BytesIO()
    torch.save({"ppo": {"model": {"a": torch.arange(6.0)}, "frames": 3}, "history": [{"x": 0.5}], "best": 0.1}, stream)
    return _entries(stream.getvalue())


def _npz(**arrays: Any) -> dict[str, bytes]:
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    return _entries(stream.getvalue())


@functools.cache
def _arrays() -> dict[str, bytes]:
    return _npz(**Occupancy(np.ones((3, 4, 5), bool), (1, 2, 3), 0.1).to_arrays())


def _occupancy(path: Path) -> object:
    with refusing(path, "an occupancy"):
        return Occupancy.from_arrays(read_arrays(path, 1 << 20)).to_arrays()


@functools.cache
def _config() -> bytes:
    return OmegaConf.to_yaml(load_config(["scene=backyard"])).encode()


def _run(path: Path) -> None:
    run_config(path.parent)


SCENE = b"""splat: garden.ply
name: garden
world_from_splat: {axes: [x, -z, y], scale: 1.5, translation: [0.0, 0.0, 1.0]}
bounds: [[-1.0, -1.0, 0.0], [1.0, 1.0, 2.0]]
robot_height: 0.4
walk: [[-1.0, -1.0], [1.0, 1.0]]
goal: [0.1, 0.2, 90.0]
quality: {psnr: 30.5, frames: 12, sharp: true}
"""
BLOCKS = b"""name: town
bounds: [[-1.0, -1.0, 0.0], [1.0, 1.0, 2.0]]
goal: [0.1, 0.2, 90.0]
blocks:
  - {splat: blocks.yaml, bounds: [[-1.0, -1.0, 0.0], [0.0, 1.0, 2.0]]}
  - {splat: blocks.yaml, bounds: [[0, -1, 0], [1, 1, 2]], world_from_splat: {axes: [x, -z, y], scale: 1.5}}
"""
NERFSTUDIO = json.dumps({"transform": np.eye(4)[:3].tolist(), "scale": 0.5}).encode()
LABELS = b"frame,action\n0,forward\n1,left|right\n7,forward\n"
ACTIONS = ("forward", "left", "right")
EPISODES = {
    "episodes": [
        {
            "episode_id": "0",
            "scene_id": "yard",
            "start_position": [1.0, 0.4, -2.0],
            "start_rotation": [0.0, 0.0, 0.0, 1.0],
            "info": {"geodesic_distance": 3.0, "goal_yaw": 0.5},
            "goals": [{"position": [0.5, 0.4, 1.5], "radius": 0.2}],
        }
    ]
    * 2
}


def _image(kind: str, rng: random.Random) -> bytes:
    stream = io.BytesIO()
    pixels = np.random.default_rng(rng.randrange(1 << 32)).integers(0, 256, (9, 12, 4)).astype(np.uint8)
    Image.fromarray(pixels if kind == "PNG" else pixels[..., :3]).save(stream, kind)
    return stream.getvalue()


def _depth(rng: random.Random) -> bytes:
    stream = io.BytesIO()
    Image.fromarray(np.random.default_rng(rng.randrange(1 << 32)).integers(0, 6000, (9, 12)).astype(np.uint16)).save(
        stream, "PNG"
    )
    return stream.getvalue()


@functools.cache
def _film() -> bytes:
    stream = io.BytesIO()
    with av.open(stream, "w", "mp4") as container:
        track = container.add_stream("mpeg4", 10)
        track.width, track.height, track.pix_fmt = 32, 32, "yuv420p"
        for shade in range(5):
            frame = av.VideoFrame.from_ndarray(np.full((32, 32, 3), 40 * shade, np.uint8))
            container.mux(track.encode(frame))
        container.mux(track.encode())
    return stream.getvalue()


def _clips(path: Path) -> None:
    for clip in read_clips(path.parent, ACTIONS):
        for _ in clip.images():
            pass


def _blocks(path: Path) -> None:
    try:
        read_blocks(path.parent)
    except FileNotFoundError as error:  # a damaged name leads to no file
        raise ValueError(str(error)) from error


POSES = np.tile(np.eye(4), (3, 1, 1))
POSES[:, 0, 3] = np.arange(3)


def _images(folder: Path, names: tuple[str, ...]) -> None:
    folder.mkdir(parents=True)
    for name in names:
        Image.new("RGB", (12, 9)).save(folder / name)


def _transforms(rng: random.Random) -> bytes:
    frames = [{"file_path": f"images/{n}.png", "transform_matrix": pose.tolist()} for n, pose in enumerate(POSES)]
    lens = {"w": 12, "h": 9, "fl_x": 10.0, "fl_y": 10.0, "cx": 6.0, "cy": 4.5, "k1": rng.choice((0, 0.01))}
    return json.dumps({**lens, "orientation_override": "none", "frames": frames}).encode()


def _polycam(rng: random.Random) -> bytes:
    pose = {f"t_{i}{j}": float(POSES[0, i, j]) for i in range(3) for j in range(4)}
    return json.dumps({**pose, "fx": 10.0, "fy": 10.0, "cx": 6.0, "cy": 4.5, "width": 12, "height": 9}).encode()


def _around_polycam(folder: Path) -> None:
    _images(folder / "keyframes" / "images", ("0.jpg", "1.jpg"))
    (folder / "keyframes" / "cameras").mkdir()
    moved = json.loads(_polycam(random.Random(0))) | {"t_03": 1.0}
    (folder / "keyframes" / "cameras" / "1.json").write_text(json.dumps(moved))


ODOMETRY = b"""timestamp, frame, x, y, z, qx, qy, qz, qw, fx, fy, cx, cy
65764.2, 000000, 0.1, 0.2, 0.3, 0.0, 0.0, 0.0, 1.0, 10.0, 10.0, 16.0, 16.0
65764.3, 000001, 0.2, 0.2, 0.3, 0.0, 0.1, 0.0, 1.0, 10.1, 10.1, 16.0, 16.0
"""


def _around_stray(folder: Path) -> None:
    (folder / "rgb.mp4").write_bytes(_film())
    (folder / "camera_matrix.csv").write_text("10.0, 0.0, 16.0\n0.0, 10.0, 16.0\n0.0, 0.0, 1.0")


def _record3d(rng: random.Random) -> bytes:
    poses = [[0.0, 0.0, 0.0, 1.0, 0.1 * n, 0.2, 0.3] for n in range(3)]
    lens = {"w": 12, "h": 9, "dw": 4, "dh": 3, "fps": 10, "K": [10.0, 0, 0, 0, 10.0, 0, 6.0, 4.5, 1]}
    own = {"perFrameIntrinsicCoeffs": [[10.0, 10.0, 6.0, 4.5]] * 3} if rng.random() < 0.5 else {}
    start = {"initPose": [0.1, 0, 0, 1, 0, 0, 0], "frameTimestamps": [0.0, 0.1, 0.2]}
    return json.dumps({**lens, **own, **start, "poses": poses}).encode()


def _lzfse(rng: random.Random) -> bytes:
    import imagecodecs

    metres = np.random.default_rng(rng.randrange(1 << 32)).uniform(0.1, 5.0, (48, 64)).astype("<f4").round(1)
    packed: bytes = imagecodecs.lzfse_encode(metres.tobytes())
    return packed


def _sensed(path: Path) -> object:
    return record3d.read_depth_of(record3d.Files(path.parent), path.name, None, (48, 64))


@functools.cache
def _r3d() -> dict[str, bytes]:
    depth = _lzfse(random.Random(0))
    image = _image("JPEG", random.Random(0))
    metadata = json.loads(_record3d(random.Random(0))) | {"dw": 64, "dh": 48}
    named = {f"rgbd/{n}.{kind}": content for n in range(3) for kind, content in (("jpg", image), ("depth", depth))}
    return {"metadata": json.dumps(metadata).encode(), **named}


def _archive(path: Path) -> object:
    recording = record3d.read(path)
    check_recording(recording)
    pictures = [picture.image() for _, picture in recording.pictures(range(len(recording.shots)))]
    return [*pictures, *(shot.depth() for shot in recording.shots if shot.depth is not None)]


def _recorded(read: Callable[[Path], Recording], up: int = 0) -> Callable[[Path], None]:
    """Return a function that reads a file's folder, or the one ``up`` levels above it, as a recording."""

    def checked(path: Path) -> None:
        check_recording(read(path.parents[up]))

    return checked


CAMERAS = struct.pack("<QIiQQ4d", 1, 1, 1, 12, 9, 10.0, 10.0, 6.0, 4.5)
"""COLMAP's cameras.bin: one PINHOLE camera of 12 × 9 pixels."""


def _colmap_images(rng: random.Random) -> bytes:
    rows = [
        struct.pack("<I7dI", n + 1, 1.0, 0.0, 0.0, 0.0, *(-POSES[n, :3, 3]), 1)
        + f"{n}.png\0".encode()
        + struct.pack("<Q", 0)
        for n in range(3)
    ]
    return struct.pack("<Q", 3) + b"".join(rows)


def _around_colmap(folder: Path) -> None:
    (folder / "cameras.bin").write_bytes(CAMERAS)
    (folder / "images.bin").write_bytes(_colmap_images(random.Random(0)))
    (folder / "points3D.bin").write_bytes(struct.pack("<Q", 0))
    _images(folder / "images", ("0.png", "1.png", "2.png"))


@functools.cache
def _truth() -> dict[str, bytes]:
    return _npz(camera_to_world=POSES, time=np.arange(3.0), K=np.eye(3))


def _robot(rng: random.Random) -> bytes:
    return Path(mjcf_path(rng.choice(("ball", "car", "gate", "quadrotor", "wheels")))).read_bytes()


def _mesh(rng: random.Random) -> bytes:
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], "<f4")
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    rows = b"".join(bytes(12) + corners[face].tobytes() + bytes(2) for face in faces)
    return bytes(80) + struct.pack("<I", len(faces)) + rows


def _obj(rng: random.Random) -> bytes:
    return b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nvn 0 0 1\nvt 0 1\nf 1/1/1 3/1/1 2/1/1\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


def _around_mesh(folder: Path) -> None:
    for kind in ("stl", "obj"):
        (folder / f"{kind}.xml").write_text(
            f'<mujoco><asset><mesh name="a" file="a.{kind}"/></asset><worldbody><body><freejoint/>'
            '<geom type="mesh" mesh="a"/></body></worldbody></mujoco>'
        )


def _with_mesh(path: Path) -> None:
    read_mjcf(path.parent / f"{path.suffix[1:]}.xml")


def frames(count: int, side: int) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return what demonstrations store for each frame, and for the step that follows it."""
    last = np.arange(count)[:, None] == count - 1
    of_frames = {
        "episode": np.zeros(count, np.int64),
        "frame": np.arange(count),
        "pixels": np.zeros((count, side, side, 3), np.uint8),
        "action": np.zeros(count, np.int64),
        "state": np.zeros((count, 3), np.float32),
    }
    after = {
        "done": last,
        "terminated": last,
        "truncated": np.zeros((count, 1), bool),
        "reward": np.ones((count, 1), np.float32),
        "outcome": np.zeros((count, 1), np.int64),
        "success": np.zeros((count, 1), bool),
        "state": np.zeros((count, 3), np.float32),
    }
    return of_frames, after


def _header(values: dict[str, Any]) -> bytes:
    entries = {key: {"shape": list(each.shape), "dtype": f"torch.{each.dtype}"} for key, each in values.items()}
    return json.dumps({**entries, "next": {"type": "TensorDict"}, "shape": [2], "device": "cpu"}).encode()


def around_demonstrations(folder: Path, count: int = 2, side: int = 4) -> None:
    """Write a folder of demonstrations: ``count`` frames of ``side`` × ``side`` pixels."""
    (folder / "memmap" / "next").mkdir(parents=True)
    facts = {"version": VERSION, "fps": 10, "repeats": 1, "action_names": ["forward", "left"]}
    (folder / "demonstrations.json").write_text(json.dumps(facts))
    places = (folder / "memmap", folder / "memmap" / "next")
    for place, values in zip(places, frames(count, side), strict=True):
        (place / "meta.json").write_bytes(_header(values))
        for key, each in values.items():
            (place / f"{key}.memmap").write_bytes(each.tobytes())


FORMATS = {
    "ply": Format("a.ply", _ply, _gaussians),
    "compressed ply": Format("a.ply", _compressed, _gaussians),
    "spz": Format("a.spz", _spz, _gaussians, behind_gzip),
    "spz 4": Format("a.spz", lambda rng: spz_4_bytes(*random_spz(3, 0), 0), _gaussians),
    "splat": Format("a.splat", lambda rng: rng.randbytes(32 * 4), _gaussians),
    "sog": Format("a.sog", lambda rng: _sog(), _gaussians, behind_zip),
    "unpacked sog": Format("meta.json", lambda rng: _sog()["meta.json"], _gaussians, around=_beside_meta),
    "ply cloud": Format("a.ply", _ply, read_points),
    "pcd cloud": Format("a.pcd", _pcd, read_points),
    "checkpoint": Format("last.pt", lambda rng: _checkpoint(), load_checkpoint, behind_zip),
    "occupancy": Format("a.npz", lambda rng: _arrays(), _occupancy, behind_zip),
    "run": Format("config.yaml", lambda rng: _config(), _run),
    "scene": Format("scene.yaml", lambda rng: SCENE, lambda path: read_description(path.parent)),
    "blocks": Format("blocks.yaml", lambda rng: BLOCKS, _blocks),
    "nerfstudio": Format("a.json", lambda rng: NERFSTUDIO, nerfstudio_transform),
    "labels": Format("a.csv", lambda rng: LABELS, lambda path: read_labels(path, ACTIONS)),
    "episodes": Format(
        "a.json.gz",
        lambda rng: gzip.compress(json.dumps(EPISODES).encode()),
        lambda path: read_episodes(path, ["yard"]),
        behind_gzip,
    ),
    "demonstrations": Format(
        "memmap/meta.json",
        lambda rng: _header(frames(2, 4)[0]),
        lambda path: read_demonstrations(path.parents[1]).frames,
        around=around_demonstrations,
    ),
    "robot": Format("a.xml", _robot, read_mjcf),
    "stl": Format("a.stl", _mesh, _with_mesh, around=_around_mesh),
    "obj": Format("a.obj", _obj, _with_mesh, around=_around_mesh),
    "png": Format("a.png", functools.partial(_image, "PNG"), read_photo, behind_checksums),
    "jpeg": Format("a.jpg", functools.partial(_image, "JPEG"), read_photo),
    "sprite": Format("a.png", functools.partial(_image, "PNG"), load_sprite, behind_checksums),
    "depth": Format("a.png", _depth, read_depth, behind_checksums),
    "lzfse": Format("0.depth", _lzfse, _sensed),
    "video": Format(
        "a.mp4",
        lambda rng: _film(),
        _clips,
        around=lambda folder: (folder / "a.csv").write_bytes(LABELS) and None,
    ),
    "truth": Format("a.npz", lambda rng: _truth(), lambda path: read_truth(path.with_suffix(".mp4")), behind_zip),
    "transforms": Format(
        "transforms.json",
        _transforms,
        _recorded(transforms.read),
        around=lambda folder: _images(folder / "images", ("0.png", "1.png", "2.png")),
    ),
    "polycam": Format("keyframes/cameras/0.json", _polycam, _recorded(polycam.read, 2), around=_around_polycam),
    "stray scanner": Format("odometry.csv", lambda rng: ODOMETRY, _recorded(stray_scanner.read), around=_around_stray),
    "record3d": Format(
        "metadata",
        _record3d,
        _recorded(record3d.read),
        around=lambda folder: _images(folder / "rgbd", ("0.jpg", "1.jpg", "2.jpg")),
    ),
    "r3d": Format("a.r3d", lambda rng: _r3d(), _archive, behind_zip),
    "colmap cameras": Format("cameras.bin", lambda rng: CAMERAS, _recorded(colmap.read), around=_around_colmap),
    "colmap images": Format("images.bin", _colmap_images, _recorded(colmap.read), around=_around_colmap),
}
