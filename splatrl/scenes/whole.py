"""Writes the folder of a scene completely or not at all."""

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from splatrl.files import in_place_of


@contextmanager
def whole_scene(folder: Path, work: Path, description: str, earlier: Sequence[str] = ()) -> Iterator[Path]:
    """Yield a new folder in ``work``, whose files move into ``folder`` once the block succeeds, the description last.

    A folder without a description is not a scene, so one in which the files of two scenes meet is never taken for one.

    Args:
        folder: the scene's folder; anything else in it stays.
        work: folder on the same disk, where ``remove_stale`` removes what a killed process left.
        description: name of the file that makes a folder a scene, ``scene.yaml`` or ``blocks.yaml``.
        earlier: names of files that an earlier scene may have left, which go unless they are written anew.

    Raises:
        OSError: if the folder cannot be written; the error names it.
    """
    with in_place_of(folder, work) as fresh:
        yield fresh
        if not folder.exists():
            os.rename(fresh, folder)
            return
        written = sorted(path.name for path in fresh.iterdir() if path.name != description)
        stale = [folder / name for name in earlier if name not in written]
        if written or any(path.exists() for path in stale):
            (folder / description).unlink(missing_ok=True)
        for path in stale:
            path.unlink(missing_ok=True)
        for name in (*written, description):
            os.replace(fresh / name, folder / name)
