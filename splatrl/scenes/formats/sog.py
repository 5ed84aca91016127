"""Reads PlayCanvas's SOG version 2: lossless WebP textures, one pixel per Gaussian, and a meta.json, zipped or not."""

import io
import shlex
import zipfile
import zlib
from pathlib import Path
from types import ModuleType
from typing import Any

from splatrl.documents import parsed_json
from splatrl.extras import require
from splatrl.files import checked_name, read_entry
from splatrl.scenes.formats.limits import CONVERT, check_inflation
from splatrl.scenes.formats.stored import from_gsply
from splatrl.scenes.gaussians import Gaussians

TEXTURES = {"means": 2, "quats": 1, "scales": 1, "sh0": 1}
"""Number of textures per attribute, each with one pixel per Gaussian."""

MAX_PALETTE = 1 << 16
UNPACKED = 64
"""Unpacked bytes per Gaussian, about as many as in SPZ; real bundles take 15 or more on disk."""


def read_sog(path: Path, max_inflation: float) -> Gaussians:
    """Read a .sog bundle of version 2.

    Everything that gsply's compiled loops assume is checked first, because they do not check array bounds.

    Raises:
        ValueError: for a damaged bundle, another version, or textures that do not match ``count``.
        ImportError: if the extra ``gsply`` is not installed.
    """
    _extra(path)
    data = path.read_bytes()
    entries = _unzip(path, data)
    _check(path, _meta(path, entries), entries, len(data), max_inflation)
    return _decoded(path, data)


def read_unpacked_sog(path: Path, max_inflation: float) -> Gaussians:
    """Read an unpacked SOG bundle from its meta.json and the files beside it, with the same result as from the bundle.

    Raises:
        ValueError: as in ``read_sog``, or for a texture that is not beside the meta.json.
        ImportError: if the extra ``gsply`` is not installed.
    """
    _extra(path)
    entries = {"meta.json": path.read_bytes()}
    for section in _meta(path, entries).values():
        for name in section.get("files", ()) if isinstance(section, dict) else ():
            texture = path.with_name(checked_name(f"{path}: files", name))
            if not texture.is_file():
                raise ValueError(f"{path}: files: expected {name} beside it, found none")
            entries[name] = texture.read_bytes()
    _check(path, _meta(path, entries), entries, sum(map(len, entries.values())), max_inflation)
    bundle = io.BytesIO()
    with zipfile.ZipFile(bundle, "w") as archive:
        for name, content in entries.items():
            archive.writestr(name, content)
    return _decoded(path, bundle.getvalue())


def _decoded(path: Path, bundle: bytes) -> Gaussians:
    """Decode the Gaussians of a bundle that has already been checked."""
    reader, images = _extra(path)
    try:
        return from_gsply(path, reader.sogread(bundle))
    except images.WebpError as error:
        raise ValueError(f"{path}: expected WebP textures, got a damaged one: {error}") from error


def _extra(path: Path) -> tuple[ModuleType, ModuleType]:
    problem = f"{path}: this format needs the extra gsply"
    return require("gsply.sog_reader", "gsply", problem), require("imagecodecs", "gsply", problem)


def _unzip(path: Path, data: bytes) -> dict[str, bytes]:
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as bundle:
            promised = sum(entry.file_size for entry in bundle.infolist())
            if promised > 2 * len(data) + (1 << 20):  # textures are already compressed: real bundles hardly grow
                raise zipfile.BadZipFile(f"entries of {promised} bytes are more than {len(data)} bytes can hold")
            return {entry.filename: read_entry(bundle, entry, promised) for entry in bundle.infolist()}
    except (zipfile.BadZipFile, zlib.error, ValueError) as error:
        raise ValueError(f"{path}: expected a ZIP bundle, got a damaged one: {error}") from error


def _meta(path: Path, entries: dict[str, bytes]) -> dict[str, Any]:
    if "meta.json" not in entries:
        raise ValueError(f"{path}: expected an entry meta.json, got {', '.join(sorted(entries)) or 'none'}")
    meta = parsed_json(f"{path}: meta.json", entries["meta.json"])
    if not isinstance(meta, dict) or meta.get("version") != 2:
        found = meta.get("version") if isinstance(meta, dict) else meta
        first = isinstance(meta, dict) and found is None and "means" in meta  # version 1 did not state its version
        advice = f"; this is version 1; {CONVERT.format(shlex.quote(path.name))}" if first else ""
        raise ValueError(f"{path}: meta.json: version: expected 2, got {found!r}{advice}")
    return meta


def _check(path: Path, meta: dict[str, Any], entries: dict[str, bytes], size: int, inflation: float) -> None:
    """Check that every field that the decoder reads exists, has the right type and agrees with the textures."""
    count = meta.get("count")
    if type(count) is not int or count < 1:
        raise ValueError(f"{path}: count: expected a whole number of at least 1, got {count!r:.80}")
    check_inflation(path, "count", UNPACKED * count, size, inflation)
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
    """Return the width and height that the headers of a section's textures declare."""
    files = _section(path, meta, name).get("files")
    if not isinstance(files, list) or len(files) != count or not all(isinstance(file, str) for file in files):
        raise ValueError(f"{path}: {name}.files: expected {count} names, got {files!r:.80}")
    sizes = []
    for file in files:
        head = entries.get(file, b"")[:25]
        if len(head) < 25 or (head[:4], head[8:16], head[20]) != (b"RIFF", b"WEBPVP8L", 0x2F):
            raise ValueError(f"{path}: {file}: expected a lossless WebP texture, got {head[:16]!r}")
        bits = int.from_bytes(head[21:25], "little")  # 14 bits of width - 1, then 14 of height - 1
        sizes.append(((bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1))
    return sizes


def _antialiased(path: Path) -> bool | None:
    """Return whether the splat was trained antialiased, if the bundle says so."""
    data = path.read_bytes()
    meta = _meta(path, _unzip(path, data) if path.suffix.lower() == ".sog" else {"meta.json": data})
    return meta["antialias"] if isinstance(meta.get("antialias"), bool) else None


MODES = {".sog": _antialiased, ".json": _antialiased}
READERS = {".sog": read_sog, ".json": read_unpacked_sog}
