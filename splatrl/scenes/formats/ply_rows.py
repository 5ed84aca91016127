"""Reads the vertices of a PLY file without the rows of other elements."""

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


BLOCK = 1 << 14
"""Rows read per batch, so that the raw file is never held whole in memory beside the result."""
Names = Sequence[Sequence[str]]
Dtypes = Sequence[np.dtype[Any]]


def vertex_columns(path: Path, header: PlyHeader, groups: Names, dtypes: Sequence[DTypeLike]) -> list[NDArray[Any]]:
    """Read selected properties of a file's vertices.

    Lists, whose lengths are only in the rows, are refused in the vertices and, in binary files, in the elements before
    them. Elements after the vertices are not read.

    Args:
        path: path of the file.
        header: header of the file, with an element vertex that has these properties.
        groups: names of the properties in each array of the result, in order.
        dtypes: dtype of each array; a double that is too large for it becomes infinite.

    Returns:
        One contiguous array [N, len(names)] per group.

    Raises:
        ValueError: if the file does not hold the rows that its header declares.
    """
    header.check_size(path)
    vertex = header.elements["vertex"]
    if vertex.size is None:
        raise ValueError(f"{path}: vertex: expected rows of a fixed size, got list properties")
    read = _ascii if header.format == "ascii" else _binary
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            return read(path, header, groups, [np.dtype(dtype) for dtype in dtypes])
    except (ValueError, OverflowError, IndexError) as error:
        raise ValueError(f"{path}: expected the rows that the header describes, got a damaged file: {error}") from error


def _before_vertices(header: PlyHeader) -> list[PlyElement]:
    return [header.elements[name] for name in itertools.takewhile(lambda name: name != "vertex", header.elements)]


def _ascii(path: Path, header: PlyHeader, groups: Names, dtypes: Dtypes) -> list[NDArray[Any]]:
    vertex, found = header.elements["vertex"], _empty(header, groups, dtypes)
    places = {name: place for place, name in enumerate(vertex.properties)}
    chosen = [places[name] for names in groups for name in names]
    ends = np.cumsum([len(names) for names in groups])[:-1]
    with path.open("rb") as stream:
        stream.seek(header.size)
        lines = io.TextIOWrapper(stream, "ascii", "replace")
        rows = itertools.islice(lines, sum(element.count for element in _before_vertices(header)), None)
        for first in range(0, vertex.count, BLOCK):
            most = min(BLOCK, vertex.count - first)
            values = np.loadtxt(rows, np.float64, comments=None, usecols=chosen, max_rows=most, ndmin=2)
            if len(values) != most:
                raise ValueError(f"expected {vertex.count} rows, got {first + len(values)}")
            for columns, part in zip(found, np.split(values, ends, 1), strict=True):
                columns[first : first + most] = part
    return found


def _binary(path: Path, header: PlyHeader, groups: Names, dtypes: Dtypes) -> list[NDArray[Any]]:
    vertex = header.elements["vertex"]
    sizes = [element.size for element in _before_vertices(header)]
    if None in sizes:
        raise ValueError("expected the vertices before any element with lists")
    start = header.size + sum(size for size in sizes if size is not None)
    order = "<" if header.format == "binary_little_endian" else ">"
    row = np.dtype([(name, order + TYPES[kind]) for name, kind in vertex.properties.items()])
    if header.file_size - start < vertex.count * row.itemsize:
        raise ValueError(f"expected {vertex.count * row.itemsize} bytes of vertices, got {header.file_size - start}")
    found = _empty(header, groups, dtypes)
    with path.open("rb") as stream:
        stream.seek(start)
        for first in range(0, vertex.count, BLOCK):
            rows: NDArray[np.void] = np.fromfile(stream, row, min(BLOCK, vertex.count - first))
            for names, columns in zip(groups, found, strict=True):
                for i, name in enumerate(names):
                    columns[first : first + BLOCK, i] = rows[name]
    return found


def _empty(header: PlyHeader, groups: Names, dtypes: Dtypes) -> list[NDArray[Any]]:
    count = header.elements["vertex"].count
    return [np.empty((count, len(names)), dtype) for names, dtype in zip(groups, dtypes, strict=True)]
