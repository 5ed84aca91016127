"""One reader for every splat file: the file's ending says which format it is in."""

import os
import pkgutil
from collections.abc import Callable
from functools import cache
from importlib import import_module
from pathlib import Path

from splatrl.scenes.gaussians import Gaussians

Reader = Callable[[Path], Gaussians]
"""Reads an existing, non-empty file."""


@cache
def readers() -> dict[str, Reader]:
    """File ending → reader, of every module beside this one that has ``READERS``: a new format is a new module."""
    names = sorted(info.name for info in pkgutil.iter_modules([str(Path(__file__).parent)]))
    modules = [import_module(f"splatrl.scenes.formats.{name}") for name in names if name != "reading"]
    return {ending: read for module in modules for ending, read in vars(module).get("READERS", {}).items()}


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
    reader = readers().get(path.suffix.lower())
    if reader is None:
        raise ValueError(
            f"{path}: expected a file that ends in {', '.join(readers())}, got {path.suffix or 'no ending'!r}"
        )
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such splat file")
    if path.stat().st_size == 0:
        raise ValueError(f"{path}: expected a splat file, got an empty one")
    return reader(path)
