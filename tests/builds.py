"""Results that processes share: files, across all runs, and measurements, among the workers of one run."""

from __future__ import annotations

import fcntl
import json
import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import pytest


def built(name: str, build: Callable[[Path], object]) -> Path:
    """Return the file with a given name; the first process that asks for it builds it while the others wait.

    Args:
        name: file name, which includes a digest of all the file's sources.
        build: writes the file to the path that it is given.
    """
    folder = Path(tempfile.gettempdir()) / f"splatrl-tests-{os.getuid()}"
    path = folder / name
    if path.is_file():
        return path
    folder.mkdir(mode=0o700, exist_ok=True)
    with locked(folder / f"{name}.lock"):
        if not path.is_file():
            temporary = path.with_name(f"{name}.{os.getpid()}")
            build(temporary)
            temporary.replace(path)
    return path


def measured_once(factory: pytest.TempPathFactory, name: str, measure: Callable[[], Any]) -> Any:
    """Return a measurement; the first worker of a pytest run that asks for it takes it while the others wait.

    Args:
        factory: the factory of the run's temporary folders.
        name: name of the measurement.
        measure: takes the measurement and returns a value that JSON can hold.
    """
    if "PYTEST_XDIST_WORKER" not in os.environ:
        return measure()
    path = factory.getbasetemp().parent / f"{name}.json"  # the parent of all workers' folders
    with locked(path.with_suffix(".lock")):
        if not path.is_file():
            path.write_text(json.dumps(measure()))
    return json.loads(path.read_text())


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Hold an exclusive lock on a file."""
    with path.open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield
