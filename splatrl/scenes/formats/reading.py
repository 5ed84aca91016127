"""One reader for every splat file: the file's ending says which format it is in."""

import os
from collections.abc import Callable
from pathlib import Path

from splatrl.scenes.formats.ply import read_ply
from splatrl.scenes.formats.sog import read_sog
from splatrl.scenes.formats.splat import read_splat
from splatrl.scenes.formats.spz import read_spz
from splatrl.scenes.gaussians import Gaussians

READERS: dict[str, Callable[[Path], Gaussians]] = {
    ".ply": read_ply,
    ".sog": read_sog,
    ".splat": read_splat,
    ".spz": read_spz,
}
"""File ending → reader. A reader takes the path of an existing, non-empty file."""


def read_gaussians(path: str | os.PathLike[str]) -> Gaussians:
    """Read a splat file, in the file's own frame and unit.

    Args:
        path: a .ply (3DGS as trainers write it, or compressed), .spz (version 2 or 3), .splat or .sog file. SOG and
            compressed PLY need ``pip install 'splatrl[gsply]'``.

    Raises:
        FileNotFoundError: where there is no such file.
        ValueError: for a file that is not what its ending says, is damaged, or holds no visible Gaussian.
        ImportError: for SOG and compressed PLY without the extra.
    """
    path = Path(path)
    if path.is_dir():
        raise ValueError(f"{path}: expected a splat file, got a folder")
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        raise ValueError(
            f"{path}: expected a file that ends in {', '.join(READERS)}, got {path.suffix or 'no ending'!r}"
        )
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such splat file")
    if path.stat().st_size == 0:
        raise ValueError(f"{path}: expected a splat file, got an empty one")
    return reader(path)
