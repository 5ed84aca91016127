"""One writer for all splat files; a file's extension selects the format."""

import os
from pathlib import Path

from splatrl.scenes.formats.ply import write_ply
from splatrl.scenes.formats.spz_writer import write_spz
from splatrl.scenes.gaussians import Gaussians

ENDINGS = (".ply", ".spz")


def write_gaussians(path: str | os.PathLike[str], gaussians: Gaussians, antialiased: bool | None = None) -> None:
    """Write Gaussians to a splat file atomically.

    A PLY file has Inria's layout, which every splat viewer and editor opens, and keeps the values up to the float32
    rounding of logs and logits; Gaussians of opacity 0 are written, but readers drop them. SPZ takes a fifth to a
    quarter of the space but rounds the values, and leaves out a few Gaussians if they are so far away that the
    positions of the others would become too coarse.

    Args:
        path: the file to write; its name ends in .ply or .spz.
        gaussians: Gaussians in any frame.
        antialiased: whether they were trained antialiased, which viewers can read from the file; None if that is not
            known, which SPZ stores as not.

    Raises:
        ValueError: for another file extension, no Gaussians, or values that the format cannot store.
    """
    path = Path(path)
    ending = path.suffix.lower()
    if not len(gaussians):
        raise ValueError(f"{path}: expected at least one Gaussian to write, got none")
    if ending == ".ply":
        write_ply(path, gaussians, antialiased)
    elif ending == ".spz":
        write_spz(path, gaussians, antialiased is True)
    else:
        raise ValueError(f"{path}: expected the extension {' or '.join(ENDINGS)}, got {ending or 'no extension'!r}")
