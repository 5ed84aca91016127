"""Results of the stages of a capture, each kept until something that it depends on changes."""

import json
import os
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass
from hashlib import blake2b
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from splatrl.array_files import read_arrays
from splatrl.capture.base import CaptureError
from splatrl.files import digest_of, discard, new_folder, replacing

VERSION = 9
"""Version of what the stages keep: raise it when the same settings give another result."""
STAMP, ARRAYS = "stamp.json", "arrays.npz"


def fingerprint(recipe: object, tensors: Iterable[Tensor] = (), files: Iterable[Path] = ()) -> str:
    """Return a digest of everything that the result of a stage depends on.

    Args:
        recipe: settings, as JSON values.
        tensors: data, on the CPU.
        files: files, which count by name and content.
    """
    named = [[path.name, digest_of([path])] for path in files]
    digest = blake2b(json.dumps([VERSION, recipe, named], sort_keys=True).encode(), digest_size=16)
    for values in tensors:
        digest.update(f"{values.dtype} {list(values.shape)}".encode())
        digest.update(values.contiguous().numpy().tobytes())
    return digest.hexdigest()


@dataclass(frozen=True)
class Stages:
    """A folder in which each stage keeps its result, in a sub-folder of its own.

    A sub-folder appears whole or not at all. Its stamp holds the fingerprint of what the result depends on, and digests
    of the files; a result with another fingerprint, or whose files have changed since, is replaced. Nothing else is
    ever removed: neither a folder without a stamp, nor one to which somebody added files.

    Attributes:
        place: the folder; created with the first result.
        say: called with a line that names the file where a result is repeated because it is damaged.
    """

    place: Path
    say: Callable[[str], object] = lambda _: None

    def folder(self, name: str, key: str, write: Callable[[Path], object]) -> Path:
        """Return the folder with the result of a stage, which is written unless it is there already.

        Args:
            name: name of the folder.
            key: fingerprint of everything that the result depends on.
            write: writes the result to a given folder.

        Raises:
            CaptureError: where other files are in the way.
        """
        path = self.place / name
        if not self._is_whole(path, key):
            self.discard(name)
            self.place.mkdir(parents=True, exist_ok=True)
            with new_folder(path) as made:
                write(made)
                _write_stamp(made, key, {file: digest_of([made / file]) for file in _files_of(made)})
        return path

    def arrays(self, name: str, key: str, find: Callable[[], dict[str, Tensor]]) -> dict[str, Tensor]:
        """Return the tensors that a stage finds; see ``folder``."""

        def write(made: Path) -> None:
            found: dict[str, Any] = {each: values.numpy() for each, values in find().items()}
            with replacing(made / ARRAYS) as stream:
                np.savez(stream, **found)

        kept = read_arrays(self.folder(name, key, write) / ARRAYS)
        return {each: torch.from_numpy(values) for each, values in kept.items()}

    def workplace(self, name: str, key: str) -> Path:
        """Return a folder for work that continues after an interrupt; it is empty at first, and for another key.

        Args:
            name: name of the folder.
            key: fingerprint of everything that the work depends on.

        Raises:
            CaptureError: where other files are in the way.
        """
        path = self.place / name
        if _read_stamp(path).get("key") != key:
            self.discard(name)
            self.place.mkdir(parents=True, exist_ok=True)
            with new_folder(path) as made:
                _write_stamp(made, key)
        return path

    def discard(self, name: str) -> None:
        """Remove what a stage kept, if anything.

        Raises:
            CaptureError: where it is not, or not only, what a stage kept.
        """
        path = self.place / name
        if not os.path.lexists(path):
            return
        if path.is_symlink() or not (path / STAMP).is_file():
            raise CaptureError(_in_the_way(path))
        known = _read_stamp(path).get("files")
        added = [] if known is None else [path / file for file in _files_of(path) if file not in known]
        for file in added:
            if not file.name.startswith("."):  # such as .DS_Store
                raise CaptureError(_in_the_way(file))
        discard(path)

    def _is_whole(self, path: Path, key: str) -> bool:
        stamp = _read_stamp(path)
        files = stamp.get("files")
        if stamp.get("key") != key or not isinstance(files, dict):
            return False
        for name, digest in files.items():
            if not (path / name).is_file() or digest_of([path / name]) != digest:
                self.say(f"{path / name}: expected the file that was kept, found it damaged; the stage is repeated")
                return False
        return True


def _files_of(folder: Path) -> list[str]:
    """Return the paths of a folder's files within it, except the stamp's."""
    paths = (path.relative_to(folder).as_posix() for path in folder.rglob("*") if not path.is_dir())
    return sorted(path for path in paths if path != STAMP)


def _write_stamp(folder: Path, key: str, files: dict[str, str] | None = None) -> None:
    """Write a stamp; without ``files``, all files of the folder belong to the stage."""
    (folder / STAMP).write_text(json.dumps({"key": key, "files": files}), "utf-8")


def _read_stamp(folder: Path) -> dict[str, Any]:
    """Return the content of a folder's stamp; nothing where there is none, or where it is damaged."""
    with suppress(OSError, ValueError):
        stamp = json.loads((folder / STAMP).read_text("utf-8"))
        if isinstance(stamp, dict):
            return stamp
    return {}


def _in_the_way(path: Path) -> str:
    return (
        f"{path}: expected nothing but what an earlier capture kept, found other files; move them elsewhere, or choose "
        "another folder with --out"
    )
