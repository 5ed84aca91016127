"""What tests compile, kept in a folder that workers and runs share: made again only when its sources change."""

import fcntl
import os
import tempfile
from collections.abc import Callable
from pathlib import Path


def built(name: str, build: Callable[[Path], object]) -> Path:
    """The file of a name, built by the first process that asks while the others wait.

    Args:
        name: of the file; holds a digest of all that it is made from.
        build: writes the file to the path that it is given.
    """
    folder = Path(tempfile.gettempdir()) / f"splatrl-tests-{os.getuid()}"
    path = folder / name
    if path.is_file():
        return path
    folder.mkdir(mode=0o700, exist_ok=True)
    with (folder / f"{name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not path.is_file():
            temporary = path.with_name(f"{name}.{os.getpid()}")
            build(temporary)
            temporary.replace(path)
    return path
