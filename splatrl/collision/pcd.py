"""Reads PCD, the point cloud format of the Point Cloud Library, version 0.7 and earlier."""

import io
import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

MAX_HEADER = 1 << 16
KEYS = ("FIELDS", "SIZE", "TYPE", "WIDTH", "HEIGHT", "DATA")
TYPES = {"F4", "F8", "I1", "I2", "I4", "I8", "U1", "U2", "U4", "U8"}
AXES = ("x", "y", "z")


@dataclass(frozen=True)
class PcdHeader:
    """The layout of a PCD file's rows.

    Attributes:
        data: ``ascii`` or ``binary``.
        count: number of rows.
        kinds: NumPy types of x, y and z.
        columns: indices of x, y and z among a row's values.
        offsets: byte offsets of x, y and z in a row.
        width: values per row.
        stride: bytes per row.
        size: length of the header, bytes.
    """

    data: str
    count: int
    kinds: list[str]
    columns: list[int]
    offsets: list[int]
    width: int
    stride: int
    size: int


def read_pcd(path: Path) -> NDArray[np.float64]:
    """Read the x, y and z of all points: [N, 3].

    Raises:
        ValueError: for a damaged file, one without x, y and z, or a compressed one.
    """
    header = _read_header(path)
    held = path.stat().st_size - header.size
    least = header.count * (header.stride if header.data == "binary" else header.width)
    if held < least:  # an ASCII value takes at least one byte
        raise ValueError(f"{path}: expected at least {least} bytes after the header, got {held}")
    if header.count == 0:
        return np.zeros((0, 3))
    if header.data == "binary":
        layout = {"names": list(AXES), "formats": header.kinds, "offsets": header.offsets, "itemsize": header.stride}
        rows: NDArray[np.void] = np.fromfile(path, np.dtype(cast(Any, layout)), header.count, offset=header.size)
        return np.stack([rows[axis].astype(np.float64) for axis in AXES], 1)
    with path.open("rb") as stream:
        stream.seek(header.size)
        text = io.TextIOWrapper(stream, "ascii", "replace")
        try:
            points = np.loadtxt(text, np.float64, usecols=header.columns, ndmin=2)
        except (ValueError, IndexError) as error:
            raise ValueError(f"{path}: expected {header.width} numbers per row, got a damaged file: {error}") from error
    if len(points) != header.count:
        raise ValueError(f"{path}: expected {header.count} rows, got {len(points)}")
    return points


def _read_header(path: Path) -> PcdHeader:
    with path.open("rb") as stream:
        start = stream.read(MAX_HEADER)
    end = re.search(rb"^DATA[^\n]*\n", start, re.MULTILINE)
    if end is None:
        raise ValueError(f"{path}: expected a PCD file whose header ends with a DATA line, found none")
    lines = [line.split() for line in start[: end.end()].decode("ascii", "replace").splitlines()]
    entries = {line[0]: line[1:] for line in lines if line and not line[0].startswith("#")}
    missing = [key for key in KEYS if not entries.get(key)]
    if missing:
        raise ValueError(f"{path}: header: expected the lines {', '.join(KEYS)}, found no {', '.join(missing)}")
    data = entries["DATA"][0]
    if data not in ("ascii", "binary"):
        raise ValueError(
            f"{path}: DATA: expected ascii or binary, got {data!r}; "
            "convert the file with PCL's pcl_convert_pcd_ascii_binary, output format 0 or 1"
        )
    names = entries["FIELDS"]
    sizes, counts = (_numbers(path, key, entries.get(key, ["1"] * len(names)), len(names)) for key in ("SIZE", "COUNT"))
    kinds = [f"{kind}{size}" for kind, size in zip(entries["TYPE"], sizes, strict=False)]
    if len(kinds) != len(names) or not TYPES.issuperset(kinds):
        raise ValueError(f"{path}: TYPE, SIZE: expected one of {', '.join(sorted(TYPES))} per field, got {kinds}")
    places = [names.index(axis) if names.count(axis) == 1 else -1 for axis in AXES]
    if any(place < 0 or counts[place] != 1 for place in places):
        raise ValueError(f"{path}: FIELDS: expected x, y and z, once each, got {', '.join(names)}")
    bytes_each = [size * count for size, count in zip(sizes, counts, strict=True)]
    rows = math.prod(_numbers(path, "WIDTH", entries["WIDTH"], 1) + _numbers(path, "HEIGHT", entries["HEIGHT"], 1))
    (points,) = _numbers(path, "POINTS", entries.get("POINTS", [str(rows)]), 1)
    if points != rows:
        raise ValueError(f"{path}: POINTS: expected WIDTH × HEIGHT = {rows}, got {points}")
    return PcdHeader(
        data=data,
        count=rows,
        kinds=[f"<{kinds[place].lower()}" for place in places],
        columns=[sum(counts[:place]) for place in places],
        offsets=[sum(bytes_each[:place]) for place in places],
        width=sum(counts),
        stride=sum(bytes_each),
        size=end.end(),
    )


def _numbers(path: Path, key: str, values: list[str], count: int) -> list[int]:
    if len(values) != count or not all(re.fullmatch("[0-9]{1,12}", value) for value in values):
        raise ValueError(f"{path}: {key}: expected {count} whole numbers, got {' '.join(values)!r}")
    return [int(value) for value in values]
