"""The vertices of a PLY file, read without the rows of other elements."""

import io
import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from splatrl.scenes.formats.ply_header import PlyElement, PlyHeader

TYPES = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"}
TYPES |= {"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"}
TYPES |= {"float": "f4", "double": "f8", "float32": "f4", "float64": "f8"}


def vertex_columns(path: Path, header: PlyHeader, names: Sequence[str], dtype: DTypeLike) -> NDArray[Any]:
    """Some properties of a file's vertices.

    Lists, whose lengths are only in the rows, are refused in the vertices and before them, and not read after them.

    Args:
        path: of the file.
        header: of the file; it has an element vertex with these properties.
        names: of the properties, in the order of the result.
        dtype: of the result; a double that is too large for it becomes infinite.

    Returns:
        [N, len(names)].

    Raises:
        ValueError: for a file that does not hold the rows that its header promises.
    """
    header.check_size(path)
    vertex = header.elements["vertex"]
    if vertex.size is None:
        raise ValueError(f"{path}: vertex: expected rows of a fixed size, got lists in them")
    read = _ascii if header.format == "ascii" else _binary
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            return read(path, header, names, np.dtype(dtype))
    except (ValueError, OverflowError, IndexError) as error:
        raise ValueError(f"{path}: expected the rows that the header describes, got a damaged file: {error}") from error


def _before_vertices(header: PlyHeader) -> list[PlyElement]:
    return [header.elements[name] for name in itertools.takewhile(lambda name: name != "vertex", header.elements)]


def _ascii(path: Path, header: PlyHeader, names: Sequence[str], dtype: np.dtype[Any]) -> NDArray[Any]:
    vertex = header.elements["vertex"]
    places = [list(vertex.properties).index(name) for name in names]
    with path.open("rb") as stream:
        stream.seek(header.size)
        lines = io.TextIOWrapper(stream, "ascii", "replace")
        rows = itertools.islice(lines, sum(element.count for element in _before_vertices(header)), None)
        if vertex.count == 0:
            return np.zeros((0, len(names)), dtype)
        values = np.loadtxt(rows, np.float64, comments=None, usecols=places, max_rows=vertex.count, ndmin=2)
    if len(values) != vertex.count:
        raise ValueError(f"expected {vertex.count} rows, got {len(values)}")
    return values.astype(dtype)


def _binary(path: Path, header: PlyHeader, names: Sequence[str], dtype: np.dtype[Any]) -> NDArray[Any]:
    vertex = header.elements["vertex"]
    sizes = [element.size for element in _before_vertices(header)]
    if None in sizes:
        raise ValueError("expected the vertices before any element with lists")
    start = header.size + sum(size for size in sizes if size is not None)
    order = "<" if header.format == "binary_little_endian" else ">"
    row = np.dtype([(name, order + TYPES[kind]) for name, kind in vertex.properties.items()])
    if header.file_size - start < vertex.count * row.itemsize:
        raise ValueError(f"expected {vertex.count * row.itemsize} bytes of vertices, got {header.file_size - start}")
    rows: NDArray[np.void] = np.fromfile(path, row, vertex.count, offset=start)
    columns = np.empty((len(rows), len(names)), dtype)
    for i, name in enumerate(names):
        columns[:, i] = rows[name]
    return columns
