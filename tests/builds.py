"""What is made once for all: what tests compile, for workers and runs, and what they measure, for workers of a run."""

import fcntl
import json
import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest


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
    with locked(folder / f"{name}.lock"):
        if not path.is_file():
            temporary = path.with_name(f"{name}.{os.getpid()}")
            build(temporary)
            temporary.replace(path)
    return path


def measured_once(factory: pytest.TempPathFactory, name: str, measure: Callable[[], Any]) -> Any:
    """What is measured by the first worker of a run of pytest that asks for it, while the others wait.

    Args:
        factory: of the run's folders.
        name: of what is measured.
        measure: gives what JSON can hold.
    """
    if "PYTEST_XDIST_WORKER" not in os.environ:
        return measure()
    path = factory.getbasetemp().parent / f"{name}.json"  # above the folders of the workers
    with locked(path.with_suffix(".lock")):
        if not path.is_file():
            path.write_text(json.dumps(measure()))
    return json.loads(path.read_text())


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Hold a file's lock."""
    with path.open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield
