"""Robots and things that come with splatrl, as MJCF files, and the weights of their gaits."""

from pathlib import Path

from splatrl.files import expanded

FOLDER = Path(__file__).parent


def mjcf_path(name: str) -> Path:
    """Return the MJCF file of a robot or thing, given by a path or as the name of one of splatrl's own.

    Raises:
        FileNotFoundError: if there is neither.
    """
    return _own_or_path(name, "xml", "an MJCF file")


def gait_path(name: str) -> Path:
    """Return the file of the weights with which a robot walks, given by a path or as the name of one of splatrl's own.

    Raises:
        FileNotFoundError: if there is neither.
    """
    return _own_or_path(name, "npz", "a weights file")


def _own_or_path(name: str, kind: str, expected: str) -> Path:
    own, path = FOLDER / f"{name}.{kind}", expanded(name)
    if path.is_file():
        return path
    if path.name == name and own.is_file():
        return own
    known = ", ".join(sorted(each.stem for each in FOLDER.glob(f"*.{kind}")))
    raise FileNotFoundError(f"{name}: expected {expected}, or one of {known}; found neither")
