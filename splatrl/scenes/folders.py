"""Writes the folders of scenes: a splat and its ``scene.yaml``, or blocks and their ``blocks.yaml``."""

import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from splatrl.files import alone_in, remove_stale, replacing
from splatrl.scenes.blocks import BLOCKS_FILE, read_blocks_description
from splatrl.scenes.description import (
    SCENE_FILE,
    SMALL_SPLAT,
    SPLAT,
    check_absent,
    read_description,
    scene_folder,
    write_description,
)
from splatrl.scenes.formats import read_gaussians, write_gaussians
from splatrl.scenes.placement import Frame
from splatrl.scenes.scene import Bounds, Scene
from splatrl.scenes.splitting import split_files, write_split
from splatrl.scenes.whole import whole_scene

AS_IT_IS: Frame = {"axes": ["x", "y", "z"], "scale": 1.0}
"""Frame of a splat file whose Gaussians are in the world frame."""
KEPT = ("name", "source", "antialiased", "cutoff")
"""Keys of a description that people write and ``splatrl-scene`` cannot estimate: a new description keeps them."""
ONE_FILE = (".ply", ".spz", ".splat", ".sog")
"""Formats of splats that are one file, which can be copied as it is."""


@dataclass(frozen=True)
class SceneFolder:
    """A folder in which a scene is to be written, and the form in which it is stored.

    Attributes:
        path: the folder; created if necessary.
        small: whether splat files are written as SPZ.
        block: side of the blocks that the scene is split into, metres; None for a single splat.
        force: whether to replace an existing scene.
    """

    path: Path
    small: bool = False
    block: float | None = None
    force: bool = False

    @classmethod
    def at(cls, out: Path, block: float | None = None, force: bool = False) -> "SceneFolder":
        """Return the folder of an ``--out`` such as ``garden``, or ``garden.spz`` for small splat files."""
        path, splat = scene_folder(out)
        return cls(path, splat == SMALL_SPLAT, block, force)

    @property
    def converts(self) -> bool:
        """Whether the scene's Gaussians are written anew, in the world frame."""
        return self.small or self.block is not None

    def check(self, source: Path, free: str | None = None) -> None:
        """Refuse to hide blocks behind a ``scene.yaml`` or vice versa, and to replace files without ``force``.

        Args:
            source: the splat file, or the folder of a scene to convert.
            free: name of the scene's record of free space, a copy of which is written.

        Raises:
            FileExistsError: names the file, or the folder.
        """
        if self.block is not None and (self.path / SCENE_FILE).exists():
            raise FileExistsError(
                f"--split: expected a folder without {SCENE_FILE}, which would be read instead of the blocks, "
                f"got {self.path}; pass another folder as --out"
            )
        if self.block is not None and self._holds(source) and source in split_files(source.parent):
            raise FileExistsError(
                f"--split: expected a splat whose name no block has, got {source}; pass another folder as --out"
            )
        for path in (self.path / SCENE_FILE, self.path / BLOCKS_FILE, *self._files(source, free)):
            check_absent(path, self.force)

    def kept(self, source: Path, name: str) -> tuple[dict[str, Any], list[str]]:
        """Return what a description that is about to be replaced says about the same splat in the keys ``KEPT``.

        A description beside a splat file names the file. One beside a small file or blocks does not say what these
        were made from, and counts as one of the same splat if its name is the one that the new description would have.

        Args:
            source: the splat file, or the folder of a scene to convert.
            name: name of the scene, unless it is kept.

        Returns:
            The keys with their values, and those that are lost because the description is one of another splat.

        Raises:
            ValueError: for a description that cannot be read, whose replacement would lose what somebody wrote.
        """
        try:
            if self.block is not None:
                before = read_blocks_description(self.path) if (self.path / BLOCKS_FILE).exists() else {}
            else:
                before = read_description(self.path) if (self.path / SCENE_FILE).exists() else {}
        except ValueError as error:
            raise ValueError(f"{error}; correct or remove the file, of which --force keeps what is yours") from error
        there = {key: before[key] for key in KEPT if key in before}
        same = before.get("name") == name
        if not self.converts:
            same = before.get("splat") == (source.name if self._holds(source) else _copied_name(source))
        return (there, []) if same else ({}, list(there))

    def _files(self, source: Path, free: str | None) -> list[Path]:
        """Return the files to be written besides descriptions and pictures; of blocks, those of any earlier split."""
        cloud = [] if free is None else [self.path / _cloud_name(free)]
        cloud = [path for path in cloud if path.resolve() != (source / str(free)).resolve()]
        if self.block is not None:
            return [*split_files(self.path), *cloud]
        if self.small:
            return [self.path / SMALL_SPLAT, *cloud]
        return [] if self._holds(source) else [self.path / _copied_name(source)]

    def _holds(self, file: Path) -> bool:
        """Return whether a splat file is in this folder already."""
        return self.path.resolve() == file.parent.resolve()

    @property
    def _ending(self) -> str:
        return Path(SMALL_SPLAT if self.small else SPLAT).suffix

    def write(
        self, scene: Scene, bounds: Bounds, proposals: Mapping[str, Any], antialiased: bool | None = None
    ) -> list[str]:
        """Write a scene in the world frame, as blocks or with a small splat file, completely or not at all.

        Args:
            scene: the scene; the cloud of its ``free`` space is copied to the folder.
            bounds: bounds of the region for robots, metres.
            proposals: training settings that the scene proposes.
            antialiased: whether the splat was trained antialiased, for the splat files; None if that is not known.

        Returns:
            Lines that say what was written.

        Raises:
            FileExistsError: for an existing description, without ``force``.
            ValueError: for a size of blocks that ``write_split`` refuses, or if another process writes to the folder.
        """
        description = SCENE_FILE if self.block is None else BLOCKS_FILE
        with self._whole(description) as fresh:
            if scene.free is not None:
                cloud = _cloud_name(scene.free.path.name)
                _copy(scene.free.path, fresh / cloud)
                proposals = {**proposals, "free": cloud}
            if self.block is not None:
                names = write_split(fresh, scene, self.block, self._ending, bounds, proposals, antialiased)
                return [f"wrote       {self.path / description} and {len(names)} blocks of {self.block:g} m"]
            write_gaussians(fresh / SMALL_SPLAT, scene.gaussians, antialiased)
            size = (fresh / SMALL_SPLAT).stat().st_size
            write_description(fresh, SMALL_SPLAT, scene.name, AS_IT_IS, bounds, proposals=proposals)
        line = f"wrote       {self.path / SMALL_SPLAT}, {size / 1e6:.1f} MB"
        return [line, f"wrote       {self.path / description}"]

    def describe(
        self,
        file: Path,
        name: str,
        frame: Frame,
        bounds: Bounds,
        proposals: Mapping[str, Any],
        antialiased: bool | None = None,
    ) -> list[str]:
        """Write a ``scene.yaml`` for a splat file, after copying the file to the folder unless it is there.

        Formats with several files are read once more and rewritten as one.

        Args:
            file: the splat file.
            name: name of the scene.
            frame: arguments of ``similarity`` from the file to the world, by name.
            bounds: bounds of the region for robots, metres.
            proposals: training settings that the scene proposes.
            antialiased: whether the splat was trained antialiased, for a rewritten file; None if that is not known.

        Returns:
            Lines that say what was written.

        Raises:
            FileExistsError: for an existing ``scene.yaml``, without ``force``.
            ValueError: if another process writes to the folder.
        """
        splat, copied = file.name, not self._holds(file)
        with self._whole(SCENE_FILE) as fresh:
            if copied:
                splat = _copied_name(file)
                if splat == file.name:
                    _copy(file, fresh / splat)
                else:
                    write_gaussians(fresh / splat, read_gaussians(file), antialiased)
            write_description(fresh, splat, name, frame, bounds, proposals=proposals)
        lines = [f"wrote       {self.path / splat}"] if copied else []
        return [*lines, f"wrote       {self.path / SCENE_FILE}"]

    @contextmanager
    def _whole(self, description: str) -> Iterator[Path]:
        """Yield a new folder, whose files replace those of the scene that was here once the block succeeds."""
        check_absent(self.path / description, self.force)
        self.path.mkdir(parents=True, exist_ok=True)
        with alone_in(self.path):
            remove_stale(self.path)
            earlier = split_files(self.path) if description == BLOCKS_FILE else []
            with whole_scene(self.path, self.path, description, [path.name for path in earlier]) as fresh:
                yield fresh


def _cloud_name(free: str) -> str:
    """Return the name of a copy of the cloud of free space, which is the name of no splat that is written."""
    return f"free{Path(free).suffix}"


def _copied_name(file: Path) -> str:
    """Return the name of a splat file in another folder: its own, if it is a single file that can be copied."""
    return file.name if file.suffix.lower() in ONE_FILE else SPLAT


def _copy(old: Path, new: Path) -> None:
    with replacing(new) as stream, old.open("rb") as source:
        shutil.copyfileobj(source, stream)
