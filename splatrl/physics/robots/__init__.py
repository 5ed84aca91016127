"""Robots and things that come with splatrl, as MJCF."""

from pathlib import Path

FOLDER = Path(__file__).parent


def mjcf_path(name: str) -> Path:
    """The file of a robot or thing: one of splatrl's own by its name, or a path.

    Raises:
        FileNotFoundError: for neither.
    """
    own, path = FOLDER / f"{name}.xml", Path(name).expanduser()
    if path.is_file():
        return path
    if path.name == name and own.is_file():
        return own
    known = ", ".join(sorted(each.stem for each in FOLDER.glob("*.xml")))
    raise FileNotFoundError(f"{name}: expected a file of MJCF, or one of {known}; found neither")
