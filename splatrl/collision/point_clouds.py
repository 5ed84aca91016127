"""Reads points from point cloud files, PLY and PCD, and writes PLY."""

import os
from collections.abc import Callable
from hashlib import blake2b
from pathlib import Path

import numpy as np
import plyfile
from numpy.typing import NDArray

from splatrl.collision.pcd import read_pcd
from splatrl.files import expanded, refusing, replacing
from splatrl.scenes.formats.ply_header import read_ply_header
from splatrl.scenes.formats.ply_rows import vertex_columns

AXES = ("x", "y", "z")


def read_points(path: str | os.PathLike[str]) -> NDArray[np.float64]:
    """Read the points of a cloud, in the file's own frame and unit.

    Points with a non-finite coordinate are left out: scanners write them where no signal came back.

    Args:
        path: a .ply file whose vertices have x, y and z (those of a mesh, or the centres of a splat), or a .pcd file,
            ASCII or binary.

    Returns:
        [N, 3], N ≥ 1.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: for a file that does not match its extension, is damaged, or holds no point.
    """
    path = _checked_path(path)
    with refusing(path, "a complete point cloud"):
        points = READERS[path.suffix.lower()](path)
    finite = points[np.isfinite(points).all(1)]
    if len(finite) == 0:
        raise ValueError(f"{path}: expected finite points, got {len(points)} points, none of them finite")
    return finite


def file_digest(path: str | os.PathLike[str]) -> str:
    """Return a fingerprint of a point cloud file's content, to tell whether data made from it is still valid.

    Raises:
        FileNotFoundError: if there is no such file.
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
    path = expanded(path)
    if path.suffix.lower() not in READERS:
        raise ValueError(
            f"{path}: expected a point cloud with the extension {' or '.join(READERS)}, "
            f"got {path.suffix or 'no extension'!r}"
        )
    if path.is_dir():
        raise ValueError(f"{path}: expected a point cloud file, got a folder")
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such point cloud file")
    return path


def _read_ply(path: Path) -> NDArray[np.float64]:
    header = read_ply_header(path)
    vertex = header.elements.get("vertex")
    if vertex is None:
        raise ValueError(f"{path}: expected an element called vertex, got {', '.join(header.elements) or 'none'}")
    missing = [axis for axis in AXES if vertex.properties.get(axis, "list") == "list"]
    if missing:
        raise ValueError(
            f"{path}: expected vertices with x, y and z, found no {', '.join(missing)}; "
            f"their properties are {', '.join(vertex.properties) or 'none'}"
        )
    (points,) = vertex_columns(path, header, [AXES], [np.float64])
    return points


READERS: dict[str, Callable[[Path], NDArray[np.float64]]] = {".ply": _read_ply, ".pcd": read_pcd}
"""Maps a file extension to its reader, which takes the path of an existing file."""
