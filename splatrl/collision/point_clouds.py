"""Points from point cloud files: PLY and PCD."""

import os
from collections.abc import Callable
from hashlib import blake2b
from pathlib import Path

import numpy as np
import plyfile
from numpy.typing import NDArray

from splatrl.collision.pcd import read_pcd
from splatrl.files import replacing
from splatrl.scenes.formats.ply_header import PlyElement, PlyHeader, read_ply_header

AXES = ("x", "y", "z")
TYPES = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"}
TYPES |= {"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"}
TYPES |= {"float": "f4", "double": "f8", "float32": "f4", "float64": "f8"}


def read_points(path: str | os.PathLike[str]) -> NDArray[np.float64]:
    """Read the points of a cloud, in the file's own frame and unit.

    Points with a coordinate that is not finite are left out: scanners write them where nothing came back.

    Args:
        path: a .ply file whose vertices have x, y and z (a mesh's, or a splat's centres), or a .pcd file, ASCII or
            binary.

    Returns:
        [N, 3], N ≥ 1.

    Raises:
        FileNotFoundError: where there is no such file.
        ValueError: for a file that is not what its ending says, is damaged, or holds no point.
    """
    path = _checked_path(path)
    points = READERS[path.suffix.lower()](path)
    finite = points[np.isfinite(points).all(1)]
    if len(finite) == 0:
        raise ValueError(f"{path}: expected points, got {len(points)}, none of them finite")
    return finite


def file_digest(path: str | os.PathLike[str]) -> str:
    """Fingerprint of a point cloud file's content, to tell whether what was made from it is still valid.

    Raises:
        FileNotFoundError: where there is no such file.
        ValueError: for a path without the extension of a point cloud.
    """
    digest = blake2b(digest_size=16)
    with _checked_path(path).open("rb") as stream:
        while block := stream.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()


def write_points(path: Path, points: NDArray[np.float32]) -> None:
    """Write points [N, 3], world, metres, as a binary PLY point cloud."""
    rows = np.ascontiguousarray(points, "<f4").view([(axis, "<f4") for axis in AXES])[:, 0]
    with replacing(path) as stream:
        plyfile.PlyData([plyfile.PlyElement.describe(rows, "vertex")], byte_order="<").write(stream)


def _checked_path(path: str | os.PathLike[str]) -> Path:
    path = Path(path).expanduser()
    if path.suffix.lower() not in READERS:
        raise ValueError(
            f"{path}: expected a point cloud that ends in {', '.join(READERS)}, got {path.suffix or 'no ending'!r}"
        )
    if path.is_dir():
        raise ValueError(f"{path}: expected a point cloud, got a folder")
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such point cloud")
    return path


def _read_ply(path: Path) -> NDArray[np.float64]:
    header = read_ply_header(path)
    vertex = header.elements.get("vertex")
    if vertex is None:
        raise ValueError(f"{path}: expected an element vertex, got {', '.join(header.elements) or 'none'}")
    missing = [axis for axis in AXES if vertex.properties.get(axis, "list") == "list"]
    if missing:
        raise ValueError(
            f"{path}: expected vertices with x, y and z, got none with {', '.join(missing)}; "
            f"they have {', '.join(vertex.properties) or 'nothing'}"
        )
    header.check_size(path)
    try:
        rows = _ascii_rows(path) if header.format == "ascii" else _binary_rows(path, header, vertex)
        return np.stack([rows[axis].astype(np.float64) for axis in AXES], 1)
    except (plyfile.PlyParseError, ValueError, OverflowError) as error:
        raise ValueError(f"{path}: expected the rows that the header describes, got a damaged file: {error}") from error


def _ascii_rows(path: Path) -> NDArray[np.void]:
    return plyfile.PlyData.read(str(path))["vertex"].data


def _binary_rows(path: Path, header: PlyHeader, vertex: PlyElement) -> NDArray[np.void]:
    """The vertices alone: the lengths of a mesh's lists, which nothing bounds, are never read."""
    if "list" in vertex.properties.values():
        raise ValueError("expected vertices of a fixed size, got lists in them")
    before = 0
    for name, element in header.elements.items():
        if name == "vertex":
            break
        if element.size is None:
            raise ValueError(f"expected the vertices before any element with lists, got {name} first")
        before += element.size
    order = "<" if header.format == "binary_little_endian" else ">"
    row = np.dtype([(name, order + TYPES[kind]) for name, kind in vertex.properties.items()])
    held = header.file_size - header.size - before
    if held < vertex.count * row.itemsize:
        raise ValueError(f"expected {vertex.count * row.itemsize} bytes of vertices, got {held}")
    return np.fromfile(path, row, vertex.count, offset=header.size + before)


READERS: dict[str, Callable[[Path], NDArray[np.float64]]] = {".ply": _read_ply, ".pcd": read_pcd}
"""File ending → reader. A reader takes the path of an existing file."""
