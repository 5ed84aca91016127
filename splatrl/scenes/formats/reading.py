"""One reader for all splat files; a file's extension selects the format."""

import os
import pkgutil
import shlex
import warnings
from collections.abc import Callable
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from torch import Tensor

from splatrl.files import refusing
from splatrl.scenes.formats.limits import CONVERT, MAX_INFLATION
from splatrl.scenes.frame import similarity
from splatrl.scenes.gaussians import LARGEST, Gaussians

Reader = Callable[[Path, float], Gaussians]
"""Function that reads an existing, non-empty file, given the maximum unpacked bytes per byte of a compressed one."""

KINDS = {
    b"ply\n": (".ply", "a PLY"),
    b"ply\r": (".ply", "a PLY"),
    b"NGSP": (".spz", "an SPZ"),
    b"\x1f\x8b\x08\x00": (".spz", "an SPZ or another gzip file"),
    b"\x1f\x8b\x08\x08": (".spz", "an SPZ or another gzip file"),
    b"PK\x03\x04": (".sog", "an SOG or another ZIP file"),
    b"glTF": (".glb", "a glTF file"),
}
"""First bytes of a kind of file, and its extension. Read as the x of a first Gaussian, with which a .splat begins, they
are beyond 1e10 m or below 1e-30 m."""
STREAMED = "lod-meta.json"
EXPORT = "export it as a PLY or an SPZ from the program that made it"
ELSEWHERE = {".ksplat": CONVERT, ".lcc": CONVERT, ".glb": EXPORT, ".gltf": EXPORT, ".splatv": EXPORT}
"""What to do with the formats of splats that are not read."""

META = "meta.json"
"""Name of the file in an unpacked SOG bundle that lists the others."""


@cache
def _by_extension(attribute: str) -> dict[str, Any]:
    """Merge an attribute of the sibling modules, a mapping by file extension: a new format is a new module."""
    names = sorted(info.name for info in pkgutil.iter_modules([str(Path(__file__).parent)]))
    modules = [import_module(f"splatrl.scenes.formats.{name}") for name in names if name != "reading"]
    return {ending: value for module in modules for ending, value in vars(module).get(attribute, {}).items()}


def readers() -> dict[str, Reader]:
    """Return the readers by file extension, from ``READERS`` of the sibling modules."""
    return _by_extension("READERS")


def trained_antialiased(path: Path) -> bool | None:
    """Return whether a splat was trained antialiased, for other viewers; None if its file does not say so.

    Images are antialiased either way, unless that is set otherwise: at the sizes of robots' images this is nearer to
    what a classic splat looks like at the size that it was trained at.

    Args:
        path: a splat file, or the folder of an unpacked SOG, that can be read.
    """
    path = path / META if path.is_dir() else path
    mode = _by_extension("MODES").get(path.suffix.lower())
    return None if mode is None else mode(path)


def splat_reader(path: Path) -> Reader:
    """Return the reader of a splat file.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: for an unknown extension, another kind of file than its extension says, or an empty file.
    """
    ending = path.suffix.lower()
    reader = readers().get(ending)
    advice = CONVERT if path.name == STREAMED else ELSEWHERE.get(ending)
    if advice is not None:
        raise ValueError(
            f"{path}: expected a file with the extension {', '.join(readers())}, got "
            f"{'a streamed SOG' if path.name == STREAMED else ending}; {advice.format(shlex.quote(path.name))}"
        )
    if reader is None:
        raise ValueError(
            f"{path}: expected a file with the extension {', '.join(readers())}, got {path.suffix or 'no extension'!r}"
        )
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such splat file")
    if path.stat().st_size == 0:
        raise ValueError(f"{path}: expected a splat file, got an empty one")
    with path.open("rb") as stream:
        kind, words = KINDS.get(stream.read(4), (ending, ""))
    if kind != ending:
        raise ValueError(f"{path}: expected a {ending}, got {words}; give it the extension of its kind")
    return reader


def read_gaussians(
    path: str | os.PathLike[str], max_inflation: float = MAX_INFLATION, transform: Tensor | None = None
) -> Gaussians:
    """Read a splat file, in the file's own frame and unit or in another frame.

    Args:
        path: a .ply (3DGS as trainers write it, or compressed), .spz (version 1 to 4), .splat or .sog file, or the
            folder or the meta.json of an unpacked SOG. SOG, compressed PLY and SPZ 4 need the extra:
            ``pip install 'splatrl[gsply]'``.
        max_inflation: maximum unpacked bytes per byte of a compressed file; real files rarely exceed ``MAX_INFLATION``.
        transform: [4, 4] similarity from the file's frame to that of the result. Positions that a PLY stores as doubles
            are transformed in double precision, so that georeferenced ones keep millimetre accuracy.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: if the file does not match its extension, is damaged, or holds no visible Gaussian.
        ImportError: for SOG, compressed PLY and SPZ 4 if the extra is not installed.
    """
    path = Path(path)
    return _placed(path, _stored(path, max_inflation), transform)


def read_centred(path: Path) -> tuple[Gaussians, list[float]]:
    """Read a splat file, with its origin moved to its middle if single precision rounds the doubles of a PLY.

    Raises:
        FileNotFoundError, ValueError, ImportError: see ``read_gaussians``.

    Returns:
        The Gaussians, and the new origin in the file's frame: whole units, zeros if it was not moved.
    """
    stored = _stored(path, MAX_INFLATION)
    middle, single = stored.means.median(0).values.round(), stored.means.float()
    if rounding(stored) is None or bool((single == stored.means).all()):
        return _placed(path, stored, None), [0.0, 0.0, 0.0]
    return _placed(path, stored, similarity(translation=(-middle).tolist())), middle.tolist()


def rounding(gaussians: Gaussians) -> str | None:
    """Say how far from the origin Gaussians lie, as georeferenced ones do, if float32 rounds their positions there.

    Args:
        gaussians: Gaussians in any frame and unit.

    Returns:
        A sentence without its full stop; None if positions are rounded by less than the size of most Gaussians.
    """
    away = float(gaussians.means.abs().amax(1).median())
    step = float(np.spacing(np.float32(away)))
    if step <= float(gaussians.scales.amax(1).median()):
        return None
    return (
        f"half of its Gaussians lie more than {away:.3g} units from the origin, where single precision rounds "
        f"positions to {step:.2g}, more than their size"
    )


def _stored(path: Path, max_inflation: float) -> Gaussians:
    """Read a splat file as it is stored: doubles stay doubles."""
    if path.is_dir():
        if (path / STREAMED).is_file():
            return _stored(path / STREAMED, max_inflation)
        if not (path / META).is_file():
            raise ValueError(f"{path}: expected a splat file, got a folder")
        path = path / META
    reader = splat_reader(path)
    with refusing(path, "a complete splat file"):
        return reader(path, max_inflation)


def _placed(path: Path, gaussians: Gaussians, transform: Tensor | None) -> Gaussians:
    """Move Gaussians to the frame of the result, then round their positions to single precision."""
    if transform is not None:
        gaussians = gaussians.transformed(transform)
    gaussians.means = gaussians.means.float()
    within = (gaussians.means.abs() <= LARGEST).all() and (gaussians.scales <= LARGEST).all()
    if not (within and (gaussians.scales > 0).all()):
        raise ValueError(
            f"{path}: world_from_splat: expected positions of at most {LARGEST:g} and positive sizes after it, got "
            "others; its scale or translation is out of range"
        )
    _warn_of_distance(path, gaussians)
    return gaussians


def _warn_of_distance(path: Path, gaussians: Gaussians) -> None:
    if (rounded := rounding(gaussians)) is not None:
        warnings.warn(
            f"{path}: {rounded}; subtract an offset before writing the file, or, for a PLY with doubles, with "
            "world_from_splat.translation",
            stacklevel=4,
        )
