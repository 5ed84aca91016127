"""Scenes split into blocks: many splat files in one world frame, each read only when it is needed.

A folder holds the files and a ``blocks.yaml`` that states where each of them lies.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from hashlib import blake2b
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import pad

from splatrl.documents import read_yaml
from splatrl.files import checked_name, replacing
from splatrl.scenes.description import SCENE_FILE, check_keys, decimals_of
from splatrl.scenes.formats import read_gaussians
from splatrl.scenes.formats.limits import MAX_INFLATION
from splatrl.scenes.frame import stated_similarity
from splatrl.scenes.gaussians import Gaussians
from splatrl.scenes.proposals import PROPOSALS, check_proposals, warn_of_unknowns
from splatrl.scenes.scene import Bounds, FreeSpace, Scene, checked_bounds

BLOCKS_FILE = "blocks.yaml"
MOST_BLOCKS = 1024
MAX_BYTES = 256 * MOST_BLOCKS
"""Maximum size of a ``blocks.yaml`` in bytes; each block takes a line of about 100."""
LEAST_SIDE, LEAST_SHARE = 1e-3, 1e-6
"""Shortest side of bounds that are written, metres, and relative to its distance from the origin, for float32."""
BLOCK_KEYS = ("splat", "bounds", "world_from_splat")
BLOCKS_KEYS = ("name", "bounds", "blocks", *PROPOSALS)


@dataclass(frozen=True, eq=False)
class Block:
    """A splat file and its place in the world.

    Attributes:
        splat: the splat file.
        bounds: lower and upper corner of the region that it covers, world frame, metres; Gaussians may extend beyond.
        world_from_splat: [4, 4] float64; None if the file is already in the world frame, in metres.
        max_inflation: as in ``read_gaussians``.
    """

    splat: Path
    bounds: Bounds
    world_from_splat: Tensor | None = None
    max_inflation: float = MAX_INFLATION

    def read(self) -> Gaussians:
        """Read the block's Gaussians in the world frame; every call reads the file again.

        Raises:
            FileNotFoundError: if the file no longer exists.
            ValueError: if the file is damaged, or is no longer the one that ``digest`` stands for.
        """
        gaussians = read_gaussians(self.splat, self.max_inflation, self.world_from_splat)
        if "digest" in vars(self) and self._fingerprint() != self.digest:  # caches would keep it under the old digest
            raise ValueError(f"{self.splat}: expected a file that stays as it is while it is in use, got a changed one")
        return gaussians

    @cached_property
    def digest(self) -> str:
        """Fingerprint of the block's content: the bytes and format of its file, and its frame."""
        return self._fingerprint()

    def _fingerprint(self) -> str:
        frame = None if self.world_from_splat is None else self.world_from_splat.tolist()
        digest = blake2b(f"{self.splat.suffix} {frame};".encode(), digest_size=16)
        with self.splat.open("rb") as stream:
            while chunk := stream.read(2**20):
                digest.update(chunk)
        return digest.hexdigest()


class BlockScene(Scene):
    """A scene whose Gaussians are stored in blocks and may exceed memory; otherwise it behaves like any scene.

    ``BlockRenderer`` renders it block by block, and its occupancy grid is built the same way. Code that needs the whole
    scene at once, such as ``ReferenceRenderer``, reads ``gaussians``.

    Attributes:
        name: name of the scene, used in captions and file names.
        blocks: at least one block; among Gaussians of equal depth, those of the earlier block are in front.
        bounds: lower and upper corner of the scene, metres.
        free: space that is not solid, whatever the Gaussians of any block suggest; None if nothing is known about it.

    Args:
        name: a valid file name.
        blocks: the blocks, at least one.
        bounds: lower and upper corner, metres; None takes the box around the bounds of all blocks.
        free: space that is not solid; None if nothing is known about it.

    Raises:
        ValueError: if the name is not a valid file name, or there are no blocks.
    """

    blocks: tuple[Block, ...]

    def __init__(self, name: str, blocks: Sequence[Block], bounds: Bounds | None = None, free: FreeSpace | None = None):
        if not blocks:
            raise ValueError("blocks: expected at least one, got none")
        fields = {"name": name, "blocks": tuple(blocks), "bounds": bounds or _around(blocks), "free": free}
        for field, value in fields.items():
            object.__setattr__(self, field, value)
        self.__post_init__()

    def __repr__(self) -> str:
        return f"BlockScene({self.name!r}, {len(self.blocks)} blocks, bounds={self.bounds})"

    @property
    def gaussians(self) -> Gaussians:
        """All Gaussians in the order of the blocks; every access reads the files again."""
        return joined([read() for read in self.pieces])

    @property
    def pieces(self) -> Sequence[Callable[[], Gaussians]]:
        """One function per block that reads its Gaussians."""
        return [block.read for block in self.blocks]

    @property
    def extent(self) -> Bounds:
        """Lower and upper corner of all blocks, metres."""
        return _around(self.blocks)

    @property
    def surroundings(self) -> Gaussians:
        """Gaussians of the blocks near the scene's bounds: at most half the bounds' longest side away.

        If no block is that near, these are the Gaussians of all blocks.
        """
        lower, upper = self.bounds
        margin = 0.5 * max(high - low for low, high in zip(lower, upper, strict=True))
        near = [
            block
            for block in self.blocks
            if all(
                low < block.bounds[1][axis] + margin and block.bounds[0][axis] - margin < high
                for axis, (low, high) in enumerate(zip(lower, upper, strict=True))
            )
        ]
        return joined([block.read() for block in near or self.blocks])

    @cached_property
    def digest(self) -> str:
        """Fingerprint of all blocks, in order."""
        return blake2b(" ".join(block.digest for block in self.blocks).encode(), digest_size=16).hexdigest()


def joined(parts: Sequence[Gaussians]) -> Gaussians:
    """Concatenate Gaussians in order; spherical harmonics of a lower degree are padded with zeros."""
    most = max(part.sh.shape[1] for part in parts)
    fields = {name: torch.cat([getattr(part, name) for part in parts]) for name in _PLAIN}
    sh = torch.cat([pad(part.sh, (0, 0, 0, most - part.sh.shape[1])) for part in parts])
    return Gaussians(**fields, sh=sh, batch_size=[len(sh)])


_PLAIN = ("means", "quats", "scales", "opacities")


def scene_place(path: Path) -> Path:
    """Return the folder of a scene if its ``scene.yaml`` or ``blocks.yaml`` is named instead; else the path itself."""
    return path.parent if path.name in (SCENE_FILE, BLOCKS_FILE) else path


def is_in_blocks(path: Path) -> bool:
    """Return whether a path is a folder of blocks; a ``scene.yaml`` in it takes precedence."""
    return (path / BLOCKS_FILE).is_file() and not (path / SCENE_FILE).is_file()


def read_blocks(
    folder: Path, bounds: Bounds | None = None, name: str | None = None, max_inflation: float = MAX_INFLATION
) -> BlockScene:
    """Open a folder of blocks without reading any of its splat files.

    Args:
        folder: a folder with a ``blocks.yaml``.
        bounds: override for the bounds that the file states.
        name: override for the name that the file states; if neither is given, the folder's name is used.
        max_inflation: as in ``read_gaussians``.

    Raises:
        FileNotFoundError: if the ``blocks.yaml``, or a file that it names, is missing.
        ValueError: if the ``blocks.yaml`` is invalid; the message names the block and the key.
    """
    path, stated = folder / BLOCKS_FILE, read_blocks_description(folder)
    warn_of_unknowns(folder, stated)
    blocks = [_block(folder, number, entry, max_inflation) for number, entry in enumerate(stated["blocks"])]
    if bounds is None and "bounds" in stated:
        bounds = _bounds(str(path), stated["bounds"])
    free = FreeSpace.stated(path, stated)
    return BlockScene(name or stated.get("name", folder.resolve().name), blocks, bounds, free)


def read_blocks_description(folder: Path) -> dict[str, Any]:
    """Read a folder's ``blocks.yaml`` and return its non-null ``BLOCKS_KEYS``, always including ``blocks``.

    Raises:
        FileNotFoundError: if the folder has no ``blocks.yaml``.
        ValueError: if the file is not YAML, or has unknown keys or values of the wrong type.
    """
    path = folder / BLOCKS_FILE
    content = read_yaml(path, MAX_BYTES)
    if not isinstance(content, dict):
        raise ValueError(f"{path}: expected keys and values, got {content!r:.80}")
    check_keys(str(path), content, BLOCKS_KEYS)
    stated = {str(key): value for key, value in content.items() if value is not None}
    if "name" in stated:
        checked_name(f"{path}: name", stated["name"])
    entries = stated.get("blocks")
    if not isinstance(entries, list) or not 0 < len(entries) <= MOST_BLOCKS:
        got = f"{len(entries):,}" if isinstance(entries, list) else f"{entries!r:.80}"
        raise ValueError(f"{path}: blocks: expected a list of 1 to {MOST_BLOCKS:,} blocks, got {got}")
    check_proposals(path, stated)
    return stated


def write_blocks(
    folder: Path,
    name: str,
    blocks: Mapping[str, Bounds],
    bounds: Bounds | None = None,
    proposals: Mapping[str, Any] | None = None,
) -> Path:
    """Write a ``blocks.yaml`` for splat files in the world frame, for ``read_scene`` to read and people to edit.

    Args:
        folder: the folder that holds the files, or will.
        name: name of the scene.
        blocks: bounds of each block, by the name of its file; a side shorter than a millimetre, or than a millionth of
            its distance from the origin, is enlarged to that.
        bounds: bounds of the whole scene, enlarged likewise; None means the box around all blocks.
        proposals: training settings that the scene proposes; see ``PROPOSALS``.
    """
    lines = [f"name: {json.dumps(name, ensure_ascii=False)}  # for captions and file names"]
    if bounds is not None:
        lines.append(f"bounds: {_written(bounds)}  # lower and upper corner of the scene, world frame, metres")
    lines += [f"{key}: {json.dumps(value, ensure_ascii=False)}" for key, value in (proposals or {}).items()]
    lines.append(
        "blocks:  # splat files in this folder, the bounds of each, and world_from_splat as in scene.yaml if needed"
    )
    lines += [
        f"  - {{splat: {json.dumps(splat, ensure_ascii=False)}, bounds: {_written(corners)}}}"
        for splat, corners in blocks.items()
    ]
    with replacing(folder / BLOCKS_FILE) as stream:
        stream.write("".join(f"{line}\n" for line in lines).encode())
    return folder / BLOCKS_FILE


def _block(folder: Path, number: int, entry: object, max_inflation: float) -> Block:
    """Parse one entry of ``blocks``."""
    where = f"{folder / BLOCKS_FILE}: blocks[{number}]"
    if not isinstance(entry, dict):
        raise ValueError(f"{where}: expected the keys {', '.join(BLOCK_KEYS)}, got {entry!r:.80}")
    check_keys(where, entry, BLOCK_KEYS)
    splat = folder / checked_name(f"{where}.splat", entry.get("splat"))
    if not splat.is_file():
        raise FileNotFoundError(f"{where}.splat: expected a file in this folder, found no {splat.name}")
    try:
        transform = stated_similarity(entry.get("world_from_splat"))
    except ValueError as error:
        raise ValueError(f"{where}.{error}") from error
    return Block(splat, _bounds(where, entry.get("bounds")), transform, max_inflation)


def _bounds(where: str, corners: Any) -> Bounds:
    try:
        return checked_bounds(corners)
    except ValueError as error:
        raise ValueError(f"{where}.{error}" if "[" in where else f"{where}: {error}") from error


def _written(bounds: Bounds) -> str:
    """Return bounds as text, rounded to a ten-thousandth of their shortest side; a side of no length gets one."""
    lower, upper = np.array(bounds)
    upper = np.maximum(upper, lower + np.maximum(LEAST_SIDE, LEAST_SHARE * np.abs(lower)))
    return json.dumps(np.round([lower, upper], decimals_of(float((upper - lower).min()))).tolist())


def _around(blocks: Sequence[Block]) -> Bounds:
    """Return the bounding box of all blocks."""
    x, y, z = (
        (min(block.bounds[0][axis] for block in blocks), max(block.bounds[1][axis] for block in blocks))
        for axis in range(3)
    )
    return (x[0], y[0], z[0]), (x[1], y[1], z[1])
