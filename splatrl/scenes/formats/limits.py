"""How much a compressed splat file may hold, so that a few bytes cannot ask for gigabytes."""

from pathlib import Path

MAX_INFLATION = 16.0
"""Bytes that a byte of a compressed file may unpack to: real SPZ and SOG files stay below 8."""
SLACK = 1 << 20
"""Bytes that any file may unpack to."""


def check_inflation(path: Path, what: str, unpacked: int, held: int, most: float) -> None:
    """Refuse a file that promises more than it can really hold.

    Args:
        path: of the file.
        what: the field that promises it, for the message.
        unpacked: bytes that it promises.
        held: bytes of the file.
        most: bytes that one of the file's may become.

    Raises:
        ValueError: names the file, the field, and the key that raises the limit.
    """
    if unpacked > most * held + SLACK:
        raise ValueError(
            f"{path}: {what}: expected at most {most:g} bytes for each of the {held:,} in the file, got {unpacked:,}; "
            "scene.max_inflation raises the limit"
        )
