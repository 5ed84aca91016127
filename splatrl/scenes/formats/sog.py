"""PlayCanvas's SOG, version 2: a ZIP of lossless WebP textures, one pixel per Gaussian, and a meta.json."""

import io
import json
import struct
import zipfile
import zlib
from pathlib import Path
from typing import Any

from splatrl.scenes.formats.extra import extra_module, from_gsply
from splatrl.scenes.gaussians import Gaussians

DAMAGED = (zipfile.BadZipFile, zlib.error, struct.error, EOFError, OSError, RuntimeError, ValueError)
"""What zipfile raises for a damaged archive."""

TEXTURES = {"means": 2, "quats": 1, "scales": 1, "sh0": 1}
"""How many textures each attribute has, with one pixel per Gaussian."""

MAX_PALETTE = 1 << 16


def read_sog(path: Path) -> Gaussians:
    """Read a .sog bundle of version 2.

    Everything that gsply's compiled loops take for granted is checked first, because they do not check bounds.

    Raises:
        ValueError: for a damaged bundle, another version or textures that do not fit ``count``.
        ImportError: without the extra ``gsply``.
    """
    reader, images = extra_module("gsply.sog_reader", path), extra_module("imagecodecs", path)
    data = path.read_bytes()
    entries = _unzip(path, data)
    _check(path, _meta(path, entries), entries, len(data))
    try:
        return from_gsply(path, reader.sogread(data))
    except images.WebpError as error:
        raise ValueError(f"{path}: expected WebP textures, got a damaged one: {error}") from error


def _unzip(path: Path, data: bytes) -> dict[str, bytes]:
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as bundle:
            promised = sum(entry.file_size for entry in bundle.infolist())
            if promised > 16 * len(data) + (1 << 20):  # textures are compressed already: a real bundle hardly grows
                raise zipfile.BadZipFile(f"entries of {promised} bytes are more than {len(data)} bytes can hold")
            return {name: bundle.read(name) for name in bundle.namelist()}
    except DAMAGED as error:
        raise ValueError(f"{path}: expected a ZIP bundle, got a damaged one: {error}") from error


def _meta(path: Path, entries: dict[str, bytes]) -> dict[str, Any]:
    if "meta.json" not in entries:
        raise ValueError(f"{path}: expected an entry meta.json, got {', '.join(sorted(entries)) or 'none'}")
    try:
        meta = json.loads(entries["meta.json"].decode())
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path}: meta.json: expected JSON, got {error}") from error
    if not isinstance(meta, dict) or meta.get("version") != 2:
        found = meta.get("version") if isinstance(meta, dict) else meta
        raise ValueError(f"{path}: meta.json: version: expected 2, got {found!r}")
    return meta


def _check(path: Path, meta: dict[str, Any], entries: dict[str, bytes], size: int) -> None:
    """Check that every field that decoding reads exists, has its type and agrees with the textures."""
    count = meta.get("count")
    most = 8 * size + (1 << 16)  # real bundles take 15 bytes or more for each Gaussian
    if type(count) is not int or not 1 <= count <= most:
        raise ValueError(f"{path}: count: expected 1 to {most} for a file of {size} bytes, got {count!r}")
    for name, files in TEXTURES.items():
        for width, height in _sizes(path, meta, name, files, entries):
            if not count <= width * height <= 2 * count + 4096:
                raise ValueError(f"{path}: {name}: expected a texture of {count} pixels, got {width} by {height}")
    for end in ("mins", "maxs"):
        _numbers(path, meta, "means", end, 3)
    for name in ("scales", "sh0"):
        _numbers(path, meta, name, "codebook", 256)
    if "shN" in meta:
        _check_harmonics(path, meta, entries, count)


def _check_harmonics(path: Path, meta: dict[str, Any], entries: dict[str, bytes], count: int) -> None:
    centroids, labels = _sizes(path, meta, "shN", 2, entries)
    _numbers(path, meta, "shN", "codebook", 256)
    bands, palette = meta["shN"].get("bands"), meta["shN"].get("count")
    if type(bands) is not int or bands not in (1, 2, 3):
        raise ValueError(f"{path}: shN.bands: expected 1, 2 or 3, got {bands!r}")
    if type(palette) is not int or not 1 <= palette <= MAX_PALETTE:
        raise ValueError(f"{path}: shN.count: expected 1 to {MAX_PALETTE}, got {palette!r}")
    width, height = 64 * ((bands + 1) ** 2 - 1), -(-palette // 64)
    if centroids[0] != width or not height <= centroids[1] <= MAX_PALETTE // 64:
        raise ValueError(f"{path}: shN: expected centroids of {width} by {height} pixels, got {centroids}")
    if not count <= labels[0] * labels[1] <= 2 * count + 4096:
        raise ValueError(f"{path}: shN: expected labels of {count} pixels, got {labels}")


def _section(path: Path, meta: dict[str, Any], name: str) -> dict[str, Any]:
    section = meta.get(name)
    if not isinstance(section, dict):
        raise ValueError(f"{path}: {name}: expected a section of meta.json, got {section!r}")
    return section


def _numbers(path: Path, meta: dict[str, Any], name: str, key: str, count: int) -> None:
    values = _section(path, meta, name).get(key)
    if not isinstance(values, list) or len(values) != count:
        raise ValueError(f"{path}: {name}.{key}: expected {count} numbers, got {values!r:.80}")
    for value in values:
        if type(value) not in (int, float) or not abs(value) < 1e30:
            raise ValueError(f"{path}: {name}.{key}: expected finite numbers, got {value!r:.80}")


def _sizes(path: Path, meta: dict[str, Any], name: str, count: int, entries: dict[str, bytes]) -> list[tuple[int, int]]:
    """Width and height that the headers of a section's textures promise."""
    files = _section(path, meta, name).get("files")
    if not isinstance(files, list) or len(files) != count or not all(isinstance(file, str) for file in files):
        raise ValueError(f"{path}: {name}.files: expected {count} names, got {files!r:.80}")
    sizes = []
    for file in files:
        head = entries.get(file, b"")[:25]
        if len(head) < 25 or (head[:4], head[8:16], head[20]) != (b"RIFF", b"WEBPVP8L", 0x2F):
            raise ValueError(f"{path}: {file}: expected a lossless WebP texture, got {head[:16]!r}")
        bits = int.from_bytes(head[21:25], "little")  # 14 bits of width - 1, then of height - 1
        sizes.append(((bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1))
    return sizes


READERS = {".sog": read_sog}
