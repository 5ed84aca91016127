"""Reads Niantic's SPZ, versions 1 to 4: quantised Gaussians, stored one attribute after another.

Versions 1 to 3 are a single gzip stream, with any vendor records at its end; version 4 has an uncompressed header,
vendor records, a table of contents, and one Zstandard stream per attribute. The format is described at
https://github.com/nianticlabs/spz. Positions and harmonics keep the axes of the file (x right, y up, z back if its
writer follows the format's advice); the order and signs of the harmonics are those of 3DGS, with the colour channel
varying fastest.
"""

import gzip
import math
import struct
import warnings
import zlib
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from splatrl.extras import require
from splatrl.scenes.formats.limits import MOST_HARMONICS, check_inflation, warn_of_fourth_degree
from splatrl.scenes.gaussians import Gaussians, checked_gaussians

MAGIC = b"NGSP"
HEADER = struct.Struct("<4sIIBBBB")
HEADER_4 = struct.Struct("<4sIIBBBBI12x")
"""Like ``HEADER``, with the number of streams in place of the reserved byte, then the table of contents' offset."""
ENTRY = struct.Struct("<QQ")
"""Entry of the table of contents: packed and unpacked size of a stream, bytes."""
COLOR_SCALE = 0.15  # scale of the degree-0 harmonics: colours slightly out of range still fit a byte
BLOCK = 1 << 16
"""Gaussians decoded per batch."""
PIECE = 1 << 20
"""Maximum number of bytes unpacked at a time."""
ANTIALIASED = 0x1  # flag: trained with antialiasing
HAS_EXTENSIONS = 0x2  # flag: vendor records may follow the attributes
RECORD = struct.Struct("<II")
"""Start of a vendor record: its type, and the size of its content in bytes."""
SH_RANGE = 0xADBE0001
"""Type of Adobe's record with the range of the harmonics above degree 0."""
CONTENTS = {SH_RANGE: struct.Struct("<BBff"), 0xADBE0002: struct.Struct("<fff")}
"""Contents of known vendor records; the second one limits the camera of a viewer."""
SH_BITS = 2
"""Bytes of the first content of ``SH_RANGE``: how many bits the harmonics were rounded to, without their range."""
MOST_RECORDS = 1 << 16
"""Bytes of vendor records that are read; real ones have a few dozen."""

Bytes = NDArray[np.uint8]


class Header(NamedTuple):
    """Fields of the first 16 bytes."""

    magic: bytes
    version: int
    points: int
    sh_degree: int
    fractional_bits: int
    flags: int
    reserved: int

    @property
    def widths(self) -> dict[str, int]:
        """Bytes per Gaussian of each attribute, in file order."""
        position = 6 if self.version == 1 else 9
        rotation = 3 if self.version <= 2 else 4
        harmonics = 3 * ((self.sh_degree + 1) ** 2 - 1)
        return {"positions": position, "alphas": 1, "colors": 3, "scales": 3, "rotations": rotation, "sh": harmonics}


def read_spz(path: Path, max_inflation: float) -> Gaussians:
    """Read an SPZ file. Harmonics of degree 4 are left out, with a warning.

    Raises:
        ValueError: for another version, a damaged stream, or a size that does not match the header.
    """
    with path.open("rb") as stream:
        version_4 = stream.read(len(MAGIC)) == MAGIC
        stream.seek(0)
        header, payload, records = (_join if version_4 else _unpack)(path, stream, max_inflation)
    middle, step = _harmonics_scale(path, records, header.version)
    columns: dict[str, Bytes] = {}
    start = 0
    for name, width in header.widths.items():
        columns[name] = payload[start : start + width * header.points].reshape(header.points, width)
        start += width * header.points
    if header.sh_degree > 3:
        warn_of_fourth_degree(path)
    count, harmonics = header.points, 1 + min((header.sh_degree + 1) ** 2 - 1, MOST_HARMONICS)
    means, quats = np.empty((count, 3), np.float32), np.empty((count, 4), np.float32)
    scales, sh = np.empty((count, 3), np.float32), np.empty((count, harmonics, 3), np.float32)
    rotations = _first_three if header.version <= 2 else _smallest_three
    for first in range(0, count, BLOCK):
        rows = slice(first, first + BLOCK)
        means[rows] = _positions(columns["positions"][rows], header.fractional_bits)
        quats[rows] = rotations(columns["rotations"][rows])
        scales[rows] = np.exp(columns["scales"][rows] / np.float32(16.0) - np.float32(10.0))
        sh[rows, 0] = (columns["colors"][rows] / np.float32(255.0) - np.float32(0.5)) / np.float32(COLOR_SCALE)
        rest = columns["sh"][rows].reshape(len(scales[rows]), -1, 3)[:, : harmonics - 1]
        sh[rows, 1:] = (rest - middle) * step
    return checked_gaussians(
        str(path),
        means=torch.from_numpy(means),
        quats=torch.from_numpy(quats),
        scales=torch.from_numpy(scales),
        opacities=torch.from_numpy(columns["alphas"][:, 0] / np.float32(255.0)),
        sh=torch.from_numpy(sh),
    )


def _unpack(path: Path, stream: BinaryIO, max_inflation: float) -> tuple[Header, Bytes, bytes]:
    """Unpack header, attributes and vendor records of versions 1 to 3: no more than declared, if that is plausible."""
    held = path.stat().st_size
    inflater = zlib.decompressobj(wbits=16 + zlib.MAX_WBITS)
    try:
        start = _inflated(inflater, stream, HEADER.size)
        if len(start) < HEADER.size:
            raise ValueError(f"{path}: header: expected {HEADER.size} bytes, got {len(start)}")
        header = _checked(path, Header(*HEADER.unpack(start.tobytes())), (1, 2, 3))
        promised = sum(header.widths.values()) * header.points
        check_inflation(path, "numPoints", promised, held, max_inflation)
        payload = _inflated(inflater, stream, promised)
        surplus = _inflated(inflater, stream, MOST_RECORDS if header.flags & HAS_EXTENSIONS else 1)
    except zlib.error as error:
        raise ValueError(f"{path}: expected a gzip stream, got a damaged one: {error}") from error
    extended = bool(header.flags & HAS_EXTENSIONS)
    if len(payload) < promised or not (inflater.eof or extended or len(surplus)):
        raise ValueError(f"{path}: expected {promised} bytes after the header, got {len(payload)}: truncated")
    if len(surplus) and not extended:
        raise ValueError(f"{path}: expected {promised} bytes after the header, got more")
    return header, payload, surplus.tobytes()


def _inflated(inflater: Any, stream: BinaryIO, most: int) -> Bytes:
    """Return the next ``most`` bytes of a gzip stream, unpacked piece by piece; fewer only if the stream ends."""
    found, filled = np.empty(most, np.uint8), 0
    while filled < most and not inflater.eof:
        packed = inflater.unconsumed_tail or stream.read(PIECE)
        piece = inflater.decompress(packed, min(most - filled, PIECE))
        found[filled : filled + len(piece)] = np.frombuffer(piece, np.uint8)
        filled += len(piece)
        if not packed and not piece:
            break
    return found[:filled]


def _join(path: Path, stream: BinaryIO, max_inflation: float) -> tuple[Header, Bytes, bytes]:
    """Unpack what ``_unpack`` returns for the other versions from a file of version 4."""
    data = stream.read()
    if len(data) < HEADER_4.size:
        raise ValueError(f"{path}: header: expected {HEADER_4.size} bytes, got {len(data)}")
    magic, version, points, degree, bits, flags, streams, contents = HEADER_4.unpack_from(data)
    header = _checked(path, Header(magic, version, points, degree, bits, flags, 0), (4,))
    sizes = [width * header.points for width in header.widths.values() if width]
    check_inflation(path, "numPoints", sum(sizes), len(data), max_inflation)
    start = contents + ENTRY.size * len(sizes)
    if streams != len(sizes) or not HEADER_4.size <= contents <= start <= len(data):
        raise ValueError(
            f"{path}: expected a table of {len(sizes)} streams in the file, got {streams} at byte {contents}"
        )
    decode = require("imagecodecs", "gsply", f"{path}: this format needs the extra gsply").zstd_decode
    parts = []
    for number, size in enumerate(sizes):
        packed, unpacked = ENTRY.unpack_from(data, contents + ENTRY.size * number)
        if unpacked != size or packed > len(data) - start:
            raise ValueError(
                f"{path}: stream {number}: expected {size} unpacked bytes, got {unpacked} from {packed} packed"
            )
        parts.append(bytes(decode(data[start : start + packed], out=size)))
        if len(parts[-1]) != size:
            raise ValueError(f"{path}: stream {number}: expected {size} bytes, got {len(parts[-1])}: truncated")
        start += packed
    return header, np.frombuffer(b"".join(parts), np.uint8), data[HEADER_4.size : contents][:MOST_RECORDS]


def _harmonics_scale(path: Path, records: bytes, version: int) -> tuple[np.float32, np.float32]:
    """Return the byte that stands for 0, and a byte's step, of the harmonics above degree 0.

    They range from -1 to just below 1, unless Adobe's record gives their range; its first form gave none. The first
    writers of vendor records, in versions 1 to 3, left out the size of their content.
    """
    low, high = -1.0, 1.0
    unknown: set[int] = set()
    start = 0
    while len(records) - start >= 4:
        kind, size = RECORD.unpack(records[start : start + RECORD.size].ljust(RECORD.size, b"\0"))
        start += RECORD.size
        content = CONTENTS.get(kind)
        if content is None:
            unknown.add(kind)
        elif version < 4 and size != content.size and (kind, size) != (SH_RANGE, SH_BITS):
            start -= 4
            size = SH_BITS if kind == SH_RANGE and _ends(records, start + SH_BITS) else content.size
        if kind == SH_RANGE and size == CONTENTS[kind].size <= len(records) - start:
            low, high = CONTENTS[kind].unpack_from(records, start)[2:]
        start += size
    if unknown:
        types = ", ".join(f"{kind:#010x}" for kind in sorted(unknown))
        warnings.warn(f"{path}: ignored vendor records of unknown types: {types}", stacklevel=5)
    if not (math.isfinite(high - low) and low < high):
        told = f"expected a range of harmonics, got {low:g} to {high:g} in Adobe's vendor record; taking -1 to 1"
        warnings.warn(f"{path}: {told}", stacklevel=5)
        low, high = -1.0, 1.0
    if (low, high) == (-1.0, 1.0):
        return np.float32(128), np.float32(1 / 128)
    return np.float32(-255 * low / (high - low)), np.float32((high - low) / 255)


def _ends(records: bytes, end: int) -> bool:
    """Return whether a vendor record can end here: at the end of them all, or where one of a known type starts."""
    return end == len(records) or int.from_bytes(records[end : end + 4], "little") in CONTENTS


def _checked(path: Path, header: Header, versions: tuple[int, ...]) -> Header:
    if header.magic != MAGIC:
        raise ValueError(f"{path}: magic: expected {MAGIC!r}, got {header.magic!r}")
    if header.version not in versions:
        expected = f"{versions[0]} to {versions[-1]}" if versions[1:] else versions[0]
        raise ValueError(f"{path}: version: expected {expected}, got {header.version}")
    if header.points == 0:
        raise ValueError(f"{path}: numPoints: expected at least 1, got 0")
    if header.sh_degree > 4:
        raise ValueError(f"{path}: shDegree: expected 0 to 4, got {header.sh_degree}")
    if header.fractional_bits > 24:
        raise ValueError(f"{path}: fractionalBits: expected at most 24, got {header.fractional_bits}")
    return header


def _positions(packed: Bytes, fractional_bits: int) -> NDArray[np.float32]:
    """Decode positions: [N, 9] → [N, 3], in 24-bit signed fixed point, or [N, 6] halves of version 1; little endian."""
    if packed.shape[1] == 6:
        return np.ascontiguousarray(packed).view("<f2").astype(np.float32)
    wide = np.zeros((len(packed), 3, 4), np.uint8)
    wide[:, :, 1:] = packed.reshape(-1, 3, 3)  # in the upper bytes, so that the shift extends the sign
    fixed = wide.reshape(-1, 12).view("<i4") >> 8
    return (fixed / np.float32(1 << fractional_bits)).astype(np.float32)


def _first_three(packed: Bytes) -> NDArray[np.float32]:
    """Decode rotations of versions 1 and 2, with x, y and z in one byte each and w ≥ 0: [N, 3] → wxyz [N, 4]."""
    xyz = packed / np.float32(127.5) - np.float32(1.0)
    w = np.sqrt(np.maximum(0.0, 1.0 - (xyz * xyz).sum(1, keepdims=True)))
    return np.concatenate([w, xyz], 1).astype(np.float32)


def _smallest_three(packed: Bytes) -> NDArray[np.float32]:
    """Decode rotations of versions 3 and 4: [N, 4] → wxyz [N, 4].

    Each is a little-endian word. The upper two bits say which of x, y, z, w is largest; that component is omitted and
    positive. The others follow from the upper bits down, each as a sign bit and 9 bits of magnitude relative to √½.
    """
    word = np.ascontiguousarray(packed).view("<u4")[:, 0]
    largest = (word >> 30).astype(np.intp)
    three = np.stack([word >> 20, word >> 10, word], 1)
    values = (three & 511).astype(np.float32) * np.float32(0.5**0.5 / 511)
    values *= 1.0 - 2.0 * ((three >> 9) & 1).astype(np.float32)
    xyzw = np.empty((len(word), 4), np.float32)
    left_out = np.arange(4) == largest[:, None]
    xyzw[~left_out] = values.ravel()
    xyzw[left_out] = np.sqrt(np.maximum(0.0, 1.0 - (values * values).sum(1)))
    return np.roll(xyzw, 1, axis=1)


def _antialiased(path: Path) -> bool:
    """Return whether the splat was trained antialiased."""
    with path.open("rb") as stream:
        plain = stream.read(len(MAGIC)) == MAGIC
        stream.seek(0)
        start = stream.read(HEADER.size) if plain else gzip.GzipFile(fileobj=stream).read(HEADER.size)
    return bool(Header(*HEADER.unpack(start)).flags & ANTIALIASED)


READERS = {".spz": read_spz}
MODES = {".spz": _antialiased}
