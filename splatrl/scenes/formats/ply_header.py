"""The header of a PLY file, checked before memory is allocated for the rows that it declares."""

import re
import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, cast

PlyFormat = Literal["ascii", "binary_little_endian", "binary_big_endian"]

MAX_HEADER = 1 << 16
SIZES = {"char": 1, "uchar": 1, "short": 2, "ushort": 2, "int": 4, "uint": 4, "float": 4, "double": 8}
SIZES |= {"int8": 1, "uint8": 1, "int16": 2, "uint16": 2, "int32": 4, "uint32": 4, "float32": 4, "float64": 8}


@dataclass
class PlyElement:
    """One table of a PLY file: its declared number of rows, and the types of its columns by name, lists as ``list``."""

    count: int
    properties: dict[str, str] = field(default_factory=dict)

    @property
    def size(self) -> int | None:
        """Size of the table in a binary file, bytes; None if it has lists, whose lengths are only in the rows."""
        if "list" in self.properties.values():
            return None
        return self.count * sum(SIZES[kind] for kind in self.properties.values())


@dataclass
class PlyHeader:
    """Format, tables and comments of a PLY file, and the sizes of its header and of the whole file in bytes."""

    format: PlyFormat
    elements: dict[str, PlyElement]
    size: int
    file_size: int
    comments: tuple[str, ...] = ()

    def check_size(self, path: Path) -> None:
        """Refuse a file smaller than its header says, as far as can be told without reading the rows.

        What follows the last row is ignored with a warning.
        """
        held = self.file_size - self.size
        sizes = [element.size for element in self.elements.values()]
        if self.format != "ascii" and None not in sizes:
            promised = sum(size for size in sizes if size is not None)
            if held < promised:
                raise ValueError(f"{path}: expected {promised} bytes after the header, got {held}")
            if held > promised:
                warnings.warn(f"{path}: ignored {held - promised} bytes after the last row", stacklevel=6)
        else:  # each value takes at least one byte
            least = sum(element.count * max(1, len(element.properties)) for element in self.elements.values())
            if held < least:
                raise ValueError(f"{path}: expected {least} bytes or more after the header, got {held}")


def read_ply_header(path: Path) -> PlyHeader:
    """Parse the header of a PLY file strictly.

    Raises:
        ValueError: if the file does not begin with a valid PLY header.
    """
    with path.open("rb") as stream:
        start = stream.read(MAX_HEADER)
    end = re.search(rb"^end_header\r?\n", start, re.MULTILINE)
    if not start.startswith((b"ply\n", b"ply\r\n")) or end is None:
        raise ValueError(f"{path}: expected a PLY file with a header from 'ply' to 'end_header', got none")
    formats: list[str] = []
    elements: dict[str, PlyElement] = {}
    comments: list[str] = []
    for line in start[: end.start()].decode("ascii", "replace").split("\n")[1:]:
        match line.split():
            case [] | ["obj_info", *_]:
                pass
            case ["comment", *words]:
                comments.append(" ".join(words))
            case ["format", ("ascii" | "binary_little_endian" | "binary_big_endian") as kind, "1.0"] if not formats:
                formats.append(kind)
            case ["element", name, count] if re.fullmatch("[0-9]{1,12}", count) and name not in elements:
                elements[name] = PlyElement(int(count))
            case ["property", "list", length, kind, name] if elements and {length, kind} <= SIZES.keys():
                _add_property(path, elements, name, "list")
            case ["property", kind, name] if elements and kind in SIZES:
                _add_property(path, elements, name, kind)
            case _:
                raise ValueError(f"{path}: header: expected a line of a PLY header, got {line[:80]!r}")
    if not formats:
        raise ValueError(f"{path}: header: expected a format line, got none")
    return PlyHeader(cast(PlyFormat, formats[0]), elements, end.end(), path.stat().st_size, tuple(comments))


def _add_property(path: Path, elements: dict[str, PlyElement], name: str, kind: str) -> None:
    element = next(reversed(elements))
    if name in elements[element].properties:
        raise ValueError(f"{path}: header: expected each property of {element} once, got {name} twice")
    elements[element].properties[name] = kind
