"""Reads the compressed PLY of PlayCanvas and SuperSplat: chunks of 256 Gaussians, each quantised to its own bounds."""

from pathlib import Path

import numpy as np

from splatrl.extras import require
from splatrl.scenes.formats.ply_header import PlyHeader
from splatrl.scenes.formats.stored import from_gsply
from splatrl.scenes.gaussians import Gaussians

CHUNK = 256
PACKED = ("packed_position", "packed_rotation", "packed_scale", "packed_color")
BOUNDS = tuple(
    f"{end}_{name}"
    for names in (("x", "y", "z"), ("scale_x", "scale_y", "scale_z"), ("r", "g", "b"))
    for end in ("min", "max")
    for name in names
)
COLOR_BOUNDS = {*BOUNDS[12:]}
"""Bounds that files of older writers do not have: their colours range from 0 to 1."""


def is_compressed(header: PlyHeader) -> bool:
    """Return whether a PLY file holds packed Gaussians in chunks."""
    vertex = header.elements.get("vertex")
    return "chunk" in header.elements and vertex is not None and "packed_position" in vertex.properties


def read_compressed_ply(path: Path, header: PlyHeader) -> Gaussians:
    """Read a compressed PLY file.

    Everything that gsply's compiled loops assume is checked first, because they do not check array bounds.

    Raises:
        ValueError: if the layout is not supported, or the file's size does not match its header.
        ImportError: if the extra ``gsply`` is not installed.
    """
    gsply = require("gsply", "gsply", f"{path}: this format needs the extra gsply")
    if header.format != "binary_little_endian":
        raise ValueError(f"{path}: format: expected binary_little_endian, got {header.format}")
    if list(header.elements) not in (["chunk", "vertex"], ["chunk", "vertex", "sh"]):
        raise ValueError(f"{path}: expected the elements chunk, vertex and optionally sh, got {list(header.elements)}")
    count = header.elements["vertex"].count
    bounds = BOUNDS if COLOR_BOUNDS & header.elements["chunk"].properties.keys() else BOUNDS[: -len(COLOR_BOUNDS)]
    harmonics = len(header.elements["sh"].properties) if "sh" in header.elements else 0
    if harmonics not in (0, 9, 24, 45):
        raise ValueError(f"{path}: sh: expected 9, 24 or 45 properties, got {harmonics}")
    expected = {
        "chunk": (-(-count // CHUNK), bounds, ("float", "float32")),
        "vertex": (count, PACKED, ("uint", "uint32")),
        "sh": (count, tuple(f"f_rest_{i}" for i in range(harmonics)), ("uchar", "uint8")),
    }
    for name, element in header.elements.items():
        rows, names, kinds = expected[name]
        if element.count != rows or rows == 0:
            raise ValueError(f"{path}: {name}: expected {max(rows, 1)} rows, got {element.count}")
        if tuple(element.properties) != names or not set(element.properties.values()) <= set(kinds):
            raise ValueError(
                f"{path}: {name}: expected the {kinds[0]} properties {', '.join(names)}, got {element.properties}"
            )
    header.check_size(path)
    end = header.size + sum(element.size or 0 for element in header.elements.values())
    return from_gsply(path, gsply.decompress_from_bytes(_bounded(path.read_bytes()[:end], header)))


def _bounded(content: bytes, header: PlyHeader) -> bytes:
    """Return the content of a file for gsply, with a plain header, and bounds of colours in every chunk."""
    chunks, vertices = header.elements["chunk"], header.elements["vertex"]
    end = header.size + (chunks.size or 0)
    bounds = np.frombuffer(content[header.size : end], "<f4").reshape(chunks.count, -1)
    if bounds.shape[1] < len(BOUNDS):
        bounds = np.hstack([bounds, np.full((chunks.count, 3), 0, "<f4"), np.full((chunks.count, 3), 1, "<f4")])
    lines = ["ply", "format binary_little_endian 1.0"]
    lines += [f"element chunk {chunks.count}", *(f"property float {name}" for name in BOUNDS)]
    lines += [f"element vertex {vertices.count}", *(f"property uint {name}" for name in PACKED)]
    if "sh" in header.elements:
        harmonics = header.elements["sh"].properties
        lines += [f"element sh {vertices.count}", *(f"property uchar {name}" for name in harmonics)]
    return "\n".join([*lines, "end_header", ""]).encode() + bounds.tobytes() + content[end:]
