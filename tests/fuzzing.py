"""Damaged files of every format, made with their structure in mind; a seed and a number say which.

``python -m tests.fuzzing --count 10000 --seed 0`` tries that many of each format and prints what became of them. A
reader may return or raise a ValueError that names the file; anything else, a signal, or a file that takes long, is a
fault.
"""

import argparse
import functools
import gzip
import io
import json
import random
import re
import resource
import tempfile
import time
import warnings
import zipfile
import zlib
from collections import Counter
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
from splatrl.collision import Occupancy
from splatrl.collision.point_clouds import read_points
from splatrl.configuration import load_config, run_config
from splatrl.envs.drawing.sprite import load_sprite
from splatrl.evaluation.clip_files import read_clips, read_labels
from splatrl.files import refusing
from splatrl.images import read_photo
from splatrl.scenes.blocks import read_blocks
from splatrl.scenes.description import read_description
from splatrl.scenes.formats import read_gaussians
from splatrl.scenes.placement import nerfstudio_transform
from splatrl.training import load_checkpoint
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
    zip_bytes,
)

SLOW = 5.0
"""Seconds of a processor that a file may take."""
NUMBERS = [
    "-1",
    "0",
    "1",
    "1e400",
    "-1e400",
    "nan",
    "inf",
    "1e-310",
    "9" * 30,
    "4294967296",
    "0.5",
    "''",
    "null",
    "[]",
    "{}",
]
HEADERS = re.compile(
    r"header: |a header|magic: |version: |a ZIP bundle|File is not a zip|cannot identify|InvalidDataError|YAML|JSON|UTF"
)
"""Words of errors that come before the content of a file is reached."""


def damaged(content: bytes, rng: random.Random) -> bytes:
    """Overwrite, insert, remove, repeat or cut some bytes, more of them near the beginning; change numbers in texts."""
    result = bytearray(content)
    for _ in range(rng.randint(1, 4)):
        at = int(rng.random() ** rng.choice((1, 4)) * len(result))
        size = rng.choice((1, 1, 2, 4, 8, 64))
        kind = rng.randrange(7)
        if kind == 0:
            result[at : at + size] = rng.randbytes(size)
        elif kind == 1:
            result[at:at] = rng.randbytes(size)
        elif kind == 2:
            del result[at : at + size]
        elif kind == 3:
            result[at : at + size] = rng.choice((b"\x00", b"\xff", b"\x7f", b"\x80")) * size
        elif kind == 4:
            result[at:at] = result[at : at + 16 * size]
        elif kind == 5 and rng.random() < 0.3:
            del result[at:]
        else:
            numbers = list(re.finditer(rb"-?[0-9]+\.?[0-9]*", bytes(result[: 1 << 16])))
            if numbers:
                found = rng.choice(numbers)
                result[found.start() : found.end()] = rng.choice(NUMBERS).encode()
    return bytes(result)


@dataclass(frozen=True)
class Format:
    """Whole files of a format, how they are damaged and how they are read.

    Attributes:
        name: of the file.
        whole: makes the content of an undamaged file.
        read: reads the file; anything but a ValueError that names it is a fault.
        damage: of that content.
    """

    name: str
    whole: Callable[[random.Random], Any]
    read: Callable[[Path], object]
    damage: Callable[[Any, random.Random], bytes] = damaged


def _gaussians(path: Path) -> None:
    assert_valid(read_gaussians(path))


def _spz(rng: random.Random) -> bytes:
    version, degree = rng.choice((2, 3)), rng.randrange(4)
    return spz_bytes(*random_spz(version, degree), version, degree)


def _behind_gzip(content: bytes, rng: random.Random) -> bytes:
    return gzip.compress(damaged(gzip.decompress(content), rng), 1) if rng.random() < 0.7 else damaged(content, rng)


def _behind_zip(entries: dict[str, bytes], rng: random.Random) -> bytes:
    if rng.random() < 0.2:
        return damaged(zip_bytes(entries), rng)
    name = rng.choice(sorted(entries))
    return zip_bytes({**entries, name: damaged(entries[name], rng)})


@functools.cache
def _sog() -> dict[str, bytes]:
    return sog_entries(bands=1)[0]


def _unpacked(path: Path) -> None:
    for name, content in _sog().items():
        if name != "meta.json":
            (path.parent / name).write_bytes(content)
    _gaussians(path)


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


@functools.cache
def _checkpoint() -> dict[str, bytes]:
    stream = io.BytesIO()
    torch.save({"ppo": {"model": {"a": torch.arange(6.0)}, "frames": 3}, "history": [{"x": 0.5}], "best": 0.1}, stream)
    with zipfile.ZipFile(stream) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


@functools.cache
def _arrays() -> dict[str, bytes]:
    stream = io.BytesIO()
    named: dict[str, Any] = Occupancy(np.ones((3, 4, 5), bool), (1, 2, 3), 0.1).to_arrays()
    np.savez(stream, **named)
    with zipfile.ZipFile(stream) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def _occupancy(path: Path) -> None:
    with refusing(path, "an occupancy"):
        Occupancy.from_arrays(read_arrays(path, 1 << 20))


@functools.cache
def _config() -> bytes:
    return OmegaConf.to_yaml(load_config(["scene=backyard"])).encode()


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


def _image(kind: str, rng: random.Random) -> bytes:
    stream = io.BytesIO()
    pixels = np.random.default_rng(rng.randrange(1 << 32)).integers(0, 256, (9, 12, 4)).astype(np.uint8)
    Image.fromarray(pixels if kind == "PNG" else pixels[..., :3]).save(stream, kind)
    return stream.getvalue()


def _behind_checksums(png: bytes, rng: random.Random) -> bytes:
    """Damage the chunks of a PNG, each of which gets a checksum that is right."""
    result, at = png[:8], 8
    while at + 12 <= len(png):
        size = int.from_bytes(png[at : at + 4], "big")
        chunk = png[at + 4 : at + 8 + size]
        if rng.random() < 0.5:
            chunk = chunk[:4] + damaged(chunk[4:], rng)
        length = len(chunk) - 4 if rng.random() < 0.9 else rng.randrange(1 << 32)
        result += length.to_bytes(4, "big") + chunk + zlib.crc32(chunk).to_bytes(4, "big")
        at += 12 + size
    return result


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
    path.with_suffix(".csv").write_bytes(LABELS)
    for clip in read_clips(path.parent, ACTIONS):
        for _ in clip.images():
            pass


def _blocks(path: Path) -> None:
    try:
        read_blocks(path.parent)
    except FileNotFoundError as error:  # of a damaged name
        raise ValueError(str(error)) from error


FORMATS = {
    "ply": Format("a.ply", _ply, _gaussians),
    "compressed ply": Format("a.ply", _compressed, _gaussians),
    "spz": Format("a.spz", _spz, _gaussians, _behind_gzip),
    "spz 4": Format("a.spz", lambda rng: spz_4_bytes(*random_spz(3, 0), 0), _gaussians),
    "splat": Format("a.splat", lambda rng: rng.randbytes(32 * 4), _gaussians),
    "sog": Format("a.sog", lambda rng: _sog(), _gaussians, _behind_zip),
    "unpacked sog": Format("meta.json", lambda rng: _sog()["meta.json"], _unpacked),
    "ply cloud": Format("a.ply", _ply, read_points),
    "pcd cloud": Format("a.pcd", _pcd, read_points),
    "checkpoint": Format("last.pt", lambda rng: _checkpoint(), load_checkpoint, _behind_zip),
    "occupancy": Format("a.npz", lambda rng: _arrays(), _occupancy, _behind_zip),
    "run": Format("config.yaml", lambda rng: _config(), lambda path: run_config(path.parent)),
    "scene": Format("scene.yaml", lambda rng: SCENE, lambda path: read_description(path.parent)),
    "blocks": Format("blocks.yaml", lambda rng: BLOCKS, _blocks),
    "nerfstudio": Format("a.json", lambda rng: NERFSTUDIO, nerfstudio_transform),
    "labels": Format("a.csv", lambda rng: LABELS, lambda path: read_labels(path, ACTIONS)),
    "png": Format("a.png", functools.partial(_image, "PNG"), read_photo, _behind_checksums),
    "jpeg": Format("a.jpg", functools.partial(_image, "JPEG"), read_photo),
    "sprite": Format("a.png", functools.partial(_image, "PNG"), load_sprite, _behind_checksums),
    "video": Format("a.mp4", lambda rng: _film(), _clips),
}


def try_files(kind: Format, count: int, seed: int, folder: Path) -> Counter[str]:
    """Read damaged files of a format; counts those that were read, and those refused at the header or behind it.

    Raises:
        AssertionError: for a fault, with the number of the file; the file is left in the folder.
    """
    found: Counter[str] = Counter()
    path = folder / kind.name
    for number in range(count):
        rng = random.Random(f"{seed} {number}")
        path.write_bytes(kind.damage(kind.whole(rng), rng))
        began = time.process_time()
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                kind.read(path)
            found["read"] += 1
        except ValueError as error:
            assert str(path.parent) in str(error), (number, error)
            found["header" if HEADERS.search(str(error)) else "behind"] += 1
        except Exception as error:
            raise AssertionError(
                f"file {number}: expected a ValueError, got {type(error).__name__}: {error}"
            ) from error
        taken = time.process_time() - began
        assert taken < SLOW, f"file {number}: {taken:.1f} s"
    return found


def main() -> None:
    """Entry point of the command."""
    command = argparse.ArgumentParser(prog="python -m tests.fuzzing", description=__doc__)
    command.add_argument("formats", nargs="*", help=f"of {', '.join(FORMATS)}; by default all")
    command.add_argument("--count", type=int, default=1000, help="of files of each format")
    command.add_argument("--seed", type=int, default=0)
    options = command.parse_args()
    for name in options.formats or FORMATS:
        with tempfile.TemporaryDirectory() as folder:
            began = time.monotonic()
            found = try_files(FORMATS[name], options.count, options.seed, Path(folder))
        most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
        print(f"{name:<15} {dict(sorted(found.items()))}  {time.monotonic() - began:.1f} s, {most} MiB", flush=True)


if __name__ == "__main__":
    main()
