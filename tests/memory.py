"""Peak memory of reading the worst files: those that claim, or unpack to, as much as they may.

``python -m tests.memory`` prints, for each kind, the size of the file, the memory that reading it took, and the ratio
of the two. Files are read in a separate process, whose peak memory the system counts (Linux).
"""

import ctypes
import gc
import gzip
import io
import json
import math
import struct
import sys
import tempfile
import warnings
import zipfile
import zlib
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import astuple, dataclass
from pathlib import Path

import av
import numpy as np
import torch

from splatrl.array_files import read_arrays
from splatrl.capture.recordings import colmap, record3d
from splatrl.collision.point_clouds import read_points
from splatrl.datasets.folder import read_demonstrations
from splatrl.documents import read_json, read_yaml
from splatrl.envs.drawing.sprite import load_sprite
from splatrl.evaluation.clip_files import film_images
from splatrl.evaluation.episode_sets import read_episodes
from splatrl.images import read_grey, read_photo
from splatrl.scenes.formats import read_gaussians
from splatrl.scenes.formats.limits import MAX_INFLATION, SLACK
from splatrl.training import load_checkpoint
from tests.fuzzing.formats import around_demonstrations
from tests.preloaded import start
from tests.scenes.samples import (
    compressed_ply_bytes,
    lying_zip,
    ply_bytes,
    ply_fields,
    sample_gaussians,
    sog_entries,
    spz_bytes,
    zip_bytes,
)

MIB = 1 << 20
NOISE = np.random.default_rng(0).bytes(MIB)
"""Incompressible bytes, which make a file large enough for what it claims."""


@dataclass(frozen=True)
class Costly:
    """A file that costs as much memory as it may.

    Attributes:
        name: file name.
        write: makes its content.
        read: reads the file, or refuses it.
        each: bytes of memory allowed per byte of the file.
        fixed: bytes of memory allowed in addition.
    """

    name: str
    write: Callable[[], bytes]
    read: Callable[[Path], object]
    each: float
    fixed: int = 48 * MIB

    def most(self, size: int) -> float:
        """Return the bytes of memory that a file of this size may take."""
        return self.each * size + self.fixed


def _ascii(values: str, header: str, rows: int) -> Callable[[], bytes]:
    return lambda: header.format(rows).encode() + values.encode() * rows


def _spz(degree: int) -> bytes:
    """Return as many Gaussians as the file may claim, which compress to almost nothing, with noise behind them."""
    held = MIB + 16 * 1024  # the noise, and the compressed Gaussians
    width = 20 + 3 * ((degree + 1) ** 2 - 1)
    count = int((MAX_INFLATION * held + SLACK) / width)
    payload = bytes(9 * count) + b"\xff" * count + bytes((width - 10) * count)
    return spz_bytes(payload + NOISE, count, 3, degree, flags=2)


def _sog() -> bytes:
    import imagecodecs

    count = int((MAX_INFLATION * MIB + SLACK) / 64)
    entries, _ = sog_entries(bands=0)
    meta, side = json.loads(entries["meta.json"]), int(np.ceil(count**0.5))
    texture = np.full((side, side, 4), 255, np.uint8)
    packed = imagecodecs.webp_encode(texture, lossless=True)
    names = [name for section in meta.values() if isinstance(section, dict) for name in section.get("files", ())]
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        archive.writestr("meta.json", json.dumps(meta | {"count": count}))
        for name in names:
            archive.writestr(name, packed)
        archive.writestr("noise", NOISE)
    return stream.getvalue()


def _bomb(name: str, compression: int) -> Callable[[], bytes]:
    """Return what makes an archive whose entry declares 100 bytes but unpacks to twice the memory that is allowed."""
    return lambda: lying_zip(name, bytes(96 * MIB), 100, compression)


def _compressed() -> bytes:
    values = np.random.default_rng(0).integers(0, 1 << 32, (256 * 256, 4)).astype(np.uint32)
    return compressed_ply_bytes(np.tile(np.linspace(-3.0, 3.0, 18), (256, 1)), values)


def _png(width: int, height: int, kind: int, channels: int, depth: int) -> bytes:
    """Return a picture of zeros, made without holding its pixels."""

    def chunk(name: bytes, content: bytes) -> bytes:
        return len(content).to_bytes(4, "big") + name + content + zlib.crc32(name + content).to_bytes(4, "big")

    size = width.to_bytes(4, "big") + height.to_bytes(4, "big")
    packer, row = zlib.compressobj(9), bytes(1 + width * channels * depth // 8)
    rows = b"".join([*(packer.compress(row) for _ in range(height)), packer.flush()])
    header = size + bytes([depth, kind, 0, 0, 0])
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", rows) + chunk(b"IEND", b"")


def _checkpoint() -> bytes:
    """Return a checkpoint whose pickle only makes lists."""
    stream = io.BytesIO()
    torch.save({"a": torch.zeros(1)}, stream)
    changed = io.BytesIO()
    with zipfile.ZipFile(stream) as archive, zipfile.ZipFile(changed, "w") as made:
        for name in archive.namelist():
            lists = b"\x80\x02(" + b"]" * (5 * MIB) + b"l."
            made.writestr(name, lists if name.endswith(".pkl") else archive.read(name))
    return changed.getvalue()


def _arrays(packed: bool) -> bytes:
    stream = io.BytesIO()
    (np.savez_compressed if packed else np.savez)(stream, a=np.zeros(16 * MIB, np.uint8))
    return stream.getvalue()


def _lying_arrays() -> bytes:
    """Return an archive whose array claims a terabyte but holds no data."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        header = b"{'descr': '|u1', 'fortran_order': False, 'shape': (1000000000000,), }\n"
        archive.writestr("a.npy", b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header)
    return stream.getvalue()


def _beside(name: str, path: Path) -> Path:
    """Return a folder beside a file; it is made on the first call."""
    folder = path.parent / name
    folder.mkdir(exist_ok=True)
    return folder


def _lzfse() -> bytes:
    import imagecodecs

    packed: bytes = imagecodecs.lzfse_encode(bytes(4 * record3d.MAX_DEPTH))
    return packed


def _read_lzfse(path: Path) -> object:
    side = math.isqrt(record3d.MAX_DEPTH)
    return record3d.read_depth_of(record3d.Files(path.parent), path.name, None, (side, side))


def _video(side: int) -> bytes:
    """Return a video of three blank frames of ``side`` × ``side`` pixels, which compress to almost nothing."""
    stream = io.BytesIO()
    with av.open(stream, "w", "mp4") as container:
        track = container.add_stream("mpeg4", 10)
        track.width, track.height, track.pix_fmt = side, side, "yuv420p"
        for _ in range(3):
            container.mux(track.encode(av.VideoFrame(side, side, "yuv420p")))
        container.mux(track.encode())
    return stream.getvalue()


def _read_film(path: Path) -> None:
    for _ in film_images(path):
        pass


IMAGES = 10_000
"""Images of the COLMAP model."""


def _colmap(count: int) -> bytes:
    image = struct.pack("<I7dI", 1, 1.0, *[0.0] * 6, 1)
    return struct.pack("<Q", count) + b"".join(image + b"%d\0" % number + bytes(8) for number in range(count))


def _read_colmap(path: Path) -> object:
    folder = _beside("model", path)
    (folder / "cameras.bin").write_bytes(struct.pack("<QIiQQ4d", 1, 1, 1, 12, 9, 10.0, 10.0, 6.0, 4.5))
    for number in range(IMAGES):
        (folder / f"{number}").touch()
    path.replace(folder / "images.bin")
    try:
        return colmap.read(folder)
    finally:
        (folder / "images.bin").replace(path)


FRAMES = 2000
"""Frames of the demonstrations, of 64 × 64 pixels each."""


def _read_memmap(path: Path) -> object:
    """Read demonstrations whose views are this file."""
    folder = _beside("demos", path)
    around_demonstrations(folder, FRAMES, 64)
    path.replace(folder / "memmap" / "pixels.memmap")
    try:
        return read_demonstrations(folder)
    finally:
        (folder / "memmap" / "pixels.memmap").replace(path)


FIELDS = tuple(ply_fields(sample_gaussians(1, 0)))
PLY = "ply\nformat ascii 1.0\nelement vertex {}\n" + "".join(f"property float {f}\n" for f in FIELDS) + "end_header\n"
CLOUD = "ply\nformat ascii 1.0\nelement vertex {}\n" + "".join(f"property float {f}\n" for f in "xyz") + "end_header\n"
PCD = "VERSION .7\nFIELDS x y z\nSIZE 1 1 1\nTYPE I I I\nCOUNT 1 1 1\nWIDTH {0}\nHEIGHT 1\nPOINTS {0}\nDATA "
COSTLY = {
    "ply": Costly("a.ply", lambda: ply_bytes(ply_fields(sample_gaussians(60_000, 0))), read_gaussians, 8),
    "ascii ply": Costly("a.ply", _ascii("1 " * (len(FIELDS) - 1) + "1\n", PLY, 100_000), read_gaussians, 12),
    "ascii ply, one line": Costly("a.ply", lambda: PLY.format(1).encode() + b"1" * 4 * MIB, read_gaussians, 16),
    "compressed ply": Costly("a.ply", _compressed, read_gaussians, 24, 160 * MIB),
    "spz": Costly("a.spz", lambda: _spz(0), read_gaussians, 180),
    "spz, degree 3": Costly("a.spz", lambda: _spz(3), read_gaussians, 120),
    "splat": Costly(
        "a.splat", lambda: (b"\x01\x01\x01\x3f" * 6 + b"\xff" * 4 + b"\x80\x80\x80\xff") * 100_000, read_gaussians, 12
    ),
    "sog": Costly("a.sog", _sog, read_gaussians, 180, 160 * MIB),
    "sog, deflate bomb": Costly("a.sog", _bomb("meta.json", zipfile.ZIP_DEFLATED), read_gaussians, 0),
    "sog, bzip2 bomb": Costly("a.sog", _bomb("meta.json", zipfile.ZIP_BZIP2), read_gaussians, 0),
    "r3d, deflate bomb": Costly("a.r3d", _bomb("metadata", zipfile.ZIP_DEFLATED), record3d.read, 0),
    "r3d, bzip2 bomb": Costly("a.r3d", _bomb("metadata", zipfile.ZIP_BZIP2), record3d.read, 0),
    "ascii cloud": Costly("a.ply", _ascii("1 1 1\n", CLOUD, 400_000), read_points, 16),
    "pcd": Costly("a.pcd", _ascii("\x01\x01\x01", PCD + "binary\n", 400_000), read_points, 32),
    "ascii pcd": Costly("a.pcd", _ascii("1 1 1\n", PCD + "ascii\n", 400_000), read_points, 24),
    "photo": Costly("a.png", lambda: _png(8192, 8192, 2, 3, 8), read_photo, 0, 900 * MIB),
    "transparent photo": Costly("a.png", lambda: _png(8192, 8192, 6, 4, 8), read_photo, 0, 900 * MIB),
    "grey photo of 16 bits": Costly("a.png", lambda: _png(8192, 8192, 0, 1, 16), read_photo, 0, 900 * MIB),
    "depth": Costly("a.png", lambda: _png(8192, 8192, 0, 1, 16), read_grey, 0, 480 * MIB),
    "sprite": Costly("a.png", lambda: _png(4096, 4096, 6, 4, 8), load_sprite, 0, 900 * MIB),
    "yaml": Costly("a.yaml", lambda: b"a: [" + b"[]," * 10_000 + b"]", read_yaml, 2000),
    "json": Costly("a.json", lambda: b"[" + b"[]," * (2 * MIB - 2) + b"[]]", read_json, 4, 200 * MIB),
    "json, more lists": Costly("a.json", lambda: b"[" + b"[]," * (2 * MIB) + b"[]]", read_json, 4),
    "json, numbers": Costly("a.json", lambda: b"[" + b"1.5," * (2 * MIB) + b"1]", read_json, 18),
    "episodes": Costly(
        "a.json.gz",
        lambda: gzip.compress(b"[" + b"[]," * (20 * MIB) + b"[]]"),
        lambda path: read_episodes(path, ["a"]),
        0,
    ),
    "lzfse": Costly("a.depth", _lzfse, _read_lzfse, 0, 120 * MIB),
    "video": Costly("a.mp4", lambda: _video(2048), _read_film, 0, 140 * MIB),
    "large video": Costly("a.mp4", lambda: _video(8176), _read_film, 0, 1600 * MIB),
    "colmap": Costly("a.bin", lambda: _colmap(IMAGES), _read_colmap, 24),
    "memmap": Costly("a.memmap", lambda: bytes(FRAMES * 64 * 64 * 3), _read_memmap, 1),
    "checkpoint": Costly("a.pt", _checkpoint, load_checkpoint, 4),
    "arrays": Costly("a.npz", lambda: _arrays(False), read_arrays, 2),
    "packed arrays": Costly("a.npz", lambda: _arrays(True), lambda path: read_arrays(path, 17 * MIB), 0),
    "arrays that lie": Costly("a.npz", _lying_arrays, read_arrays, 0),
}


@dataclass(frozen=True)
class Cost:
    """Cost of reading one file: its size in bytes, the bytes of memory that reading it took, and the outcome."""

    size: int
    memory: int
    outcome: str


def measured(kinds: Sequence[str]) -> dict[str, Cost]:
    """Write files of these kinds and read them one by one, in a new process."""
    with tempfile.TemporaryDirectory() as folder:
        reading = start("-m", "tests.memory", "--read", folder, *kinds)
        printed, _ = reading.communicate()
    assert reading.returncode == 0, printed
    return {kind: Cost(*cost) for kind, cost in json.loads(printed.splitlines()[-1]).items()}


def _resident(field: str) -> int:
    lines = dict(line.split(":") for line in Path("/proc/self/status").read_text().splitlines())
    return 1024 * int(lines[field].split()[0])


def _cost(kind: str, folder: Path) -> Cost:
    """Write a file and read it in this process, counting peak memory from the start of the reading."""
    path = folder / COSTLY[kind].name
    path.write_bytes(COSTLY[kind].write())
    gc.collect()
    ctypes.CDLL(None).malloc_trim(0)
    before, outcome = _resident("VmRSS"), "read"
    Path("/proc/self/clear_refs").write_text("5")
    try:
        COSTLY[kind].read(path)
    except ValueError as error:
        outcome = f"refused: {str(error).removeprefix(str(path))[:100]}"
    return Cost(path.stat().st_size, _resident("VmHWM") - before, outcome)


def _read(folder: Path, kinds: Sequence[str]) -> None:
    warnings.simplefilter("ignore")
    with suppress(ImportError):  # modules that readers import on first use are not part of a file's cost
        (folder / "a.sog").write_bytes(zip_bytes(sog_entries(bands=0)[0]))
        read_gaussians(folder / "a.sog")
    gc.freeze()  # do not scan all imported modules for garbage again for each kind
    print(json.dumps({kind: astuple(_cost(kind, folder)) for kind in kinds}))


def main() -> None:
    """Entry point of the command."""
    if sys.argv[1:2] == ["--read"]:
        _read(Path(sys.argv[2]), sys.argv[3:])
        return
    for kind, cost in measured(sys.argv[1:] or list(COSTLY)).items():
        within = "" if cost.memory <= COSTLY[kind].most(cost.size) else "  TOO MUCH"
        sizes = f"{cost.size / MIB:8.2f} MiB {cost.memory / MIB:8.1f} MiB {cost.memory / cost.size:9.1f}"
        print(f"{kind:20} {sizes}  {cost.outcome}{within}", flush=True)


if __name__ == "__main__":
    main()
