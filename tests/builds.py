"""What tests compile, kept in a folder that workers and runs share, and rebuilt only when its sources change."""

import fcntl
import os
import tempfile
from collections.abc import Callable
from pathlib import Path


def built(name: str, build: Callable[[Path], object]) -> Path:
    """The file of a given name, built by the first process that asks for it while the others wait.

    Args:
        name: name of the file, including a digest of all its sources.
        build: writes the file to the given path.
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
