"""Reads the compressed PLY of PlayCanvas and SuperSplat: chunks of 256 Gaussians, each quantised to its own bounds."""

from pathlib import Path

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
    harmonics = len(header.elements["sh"].properties) if "sh" in header.elements else 0
    if harmonics not in (0, 9, 24, 45):
        raise ValueError(f"{path}: sh: expected 9, 24 or 45 properties, got {harmonics}")
    expected = {
        "chunk": (-(-count // CHUNK), BOUNDS, ("float", "float32")),
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
    return from_gsply(path, gsply.decompress_from_bytes(path.read_bytes()[:end]))
