"""Episodes that a person drove, each on the disk as soon as it ends: nobody can drive them again."""

import warnings
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from tensordict import TensorDict, TensorDictBase

from splatrl.configuration import differences
from splatrl.datasets import Demonstrations
from splatrl.datasets.recorder import demonstrations_of
from splatrl.envs.world import World
from splatrl.files import natural, remove_stale
from splatrl.made_with import FREE, changed_content
from splatrl.training import load_checkpoint, save_checkpoint

ANY = (*FREE, "by:", "episodes:", "out:", "lerobot:", "host:", "port:")
"""Beginnings of the lines of ``differences`` that do not keep a recording from being continued."""


class Takes:
    """Collects episodes that a person drove, as demonstrations.

    Args:
        world: the world in which they are recorded.
        folder: existing folder for a file of each episode, which begins with those of an interrupted recording.
        made_with: what the recording depends on, as plain values; see ``splatrl.made_with``.

    Raises:
        ValueError: if the folder holds episodes that were recorded with something else, or a damaged file.
    """

    def __init__(self, world: World, folder: Path, made_with: Mapping[str, Any]):
        self.world, self.folder, self.made_with = world, folder, dict(made_with)
        remove_stale(folder)
        self._files = sorted(folder.glob("*.pt"), key=natural)
        self.episodes: list[TensorDictBase] = [self._read(path) for path in self._files]

    def add(self, frames: TensorDictBase) -> None:
        """Keep an episode: frames [T]. It stays in memory alone, with a warning, while it cannot be written."""
        number = int(self._files[-1].stem) + 1 if self._files else 1
        self.episodes.append(frames)
        self._files.append(self.folder / f"{number}.pt")
        try:
            for path, episode in zip(self._files, self.episodes, strict=True):
                if not path.exists():
                    save_checkpoint(path, {"made_with": self.made_with, "frames": episode.to_dict()})
        except OSError as error:
            warnings.warn(f"{error}; until there is room, a kill would lose episodes", stacklevel=2)

    def discard(self) -> bool:
        """Drop the last episode and return whether there was one."""
        if not self.episodes:
            return False
        self.episodes.pop()
        self._files.pop().unlink(missing_ok=True)
        return True

    def forget(self) -> None:
        """Remove the files, once the episodes are written elsewhere or if there are none."""
        for path in self._files:
            path.unlink(missing_ok=True)
        with suppress(OSError):  # a folder with files of others stays
            self.folder.rmdir()

    def demonstrations(self) -> Demonstrations:
        """Return all kept episodes.

        Raises:
            ValueError: if there are none.
        """
        if not self.episodes:
            raise ValueError("by=keys: expected at least one episode that reached the goal, got none")
        return demonstrations_of(self.world, self.episodes)

    def _read(self, path: Path) -> TensorDictBase:
        take = load_checkpoint(path)
        then = take["made_with"]
        lines = differences(self.made_with["settings"], then["settings"])
        changed = [line for line in lines if not line.startswith(ANY)] + changed_content(self.made_with, then)
        if changed:
            raise ValueError(
                f"{path}: expected an episode of this recording, got one that was interrupted: {'; '.join(changed)}; "
                "repeat its command to continue it, choose another out=, or remove the file"
            )
        return TensorDict(take["frames"], [len(take["frames"]["action"])])
