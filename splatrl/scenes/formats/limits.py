"""Limits on what is read of splat files: harmonics up to degree 3, and as much as the size of a file can hold."""

import warnings
from pathlib import Path

MAX_INFLATION = 16.0
"""Maximum unpacked bytes per byte of a compressed file; real SPZ and SOG files stay below 8."""
SLACK = 1 << 20
"""Additional unpacked bytes that every file may have, however small it is."""
MOST_HARMONICS = 15
"""Harmonics above degree 0 that are read: those of degrees 1 to 3."""
CONVERT = "convert it: npx @playcanvas/splat-transform {} splat.ply"
"""What to do with a file of another format that this tool reads, with a place for the file's quoted name."""


def warn_of_fourth_degree(path: Path) -> None:
    """Warn that the harmonics of degree 4, the finest changes of colour with direction, are left out."""
    warnings.warn(f"{path}: left out the harmonics of degree 4, which are not drawn", stacklevel=6)


def check_inflation(path: Path, what: str, unpacked: int, held: int, most: float) -> None:
    """Refuse a file that declares more data than its size can plausibly hold.

    Args:
        path: path of the file.
        what: the field that declares the size, for the message.
        unpacked: declared size after unpacking, bytes.
        held: size of the file, bytes.
        most: maximum unpacked bytes per byte of the file.

    Raises:
        ValueError: if the limit is exceeded; the message names the file, the field, and the key that raises the limit.
    """
    if unpacked > most * held + SLACK:
        raise ValueError(
            f"{path}: {what}: expected at most {most:g} unpacked bytes per byte of the file ({held:,} bytes), got "
            f"{unpacked:,}; scene.max_inflation raises the limit"
        )
