"""One writer for every splat file: the file's ending says in which format."""

import os
from pathlib import Path

from splatrl.scenes.formats.ply import write_ply
from splatrl.scenes.formats.spz_writer import write_spz
from splatrl.scenes.gaussians import Gaussians

ENDINGS = (".ply", ".spz")


def write_gaussians(path: str | os.PathLike[str], gaussians: Gaussians, antialiased: bool = True) -> None:
    """Write Gaussians to a splat file, which appears whole or not at all.

    A PLY file has Inria's layout, which every viewer and editor of splats opens, and the values themselves up to the
    float32 rounding of logs and logits; Gaussians of opacity 0 are written, and readers drop them. SPZ is a fifth
    to a quarter of that, and rounds.

    Args:
        path: to write to; ends in .ply or .spz.
        gaussians: in any frame.
        antialiased: whether they are to be drawn so; only SPZ can say it.

    Raises:
        ValueError: for another file extension, or for values that the format cannot store.
    """
    path = Path(path)
    ending = path.suffix.lower()
    if ending == ".ply":
        write_ply(path, gaussians)
    elif ending == ".spz":
        write_spz(path, gaussians, antialiased)
    else:
        raise ValueError(f"{path}: expected a name that ends in {' or '.join(ENDINGS)}, got {ending or 'no ending'!r}")
