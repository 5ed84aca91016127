"""Packed models of the blocks of scenes, kept in the user's cache directory and shared by all renderers."""

import json
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from hashlib import blake2b
from typing import TypeVar

from splatrl.files import cache_dir
from splatrl.native.threads import threads_of
from splatrl.renderers.lod import LEVELS_VERSION
from splatrl.renderers.packed import PACKED_VERSION, packed_model
from splatrl.scenes.blocks import Block
from splatrl.scenes.cache import Arrays, cached_arrays
from splatrl.waits import Bar

Made = TypeVar("Made")


@dataclass(frozen=True)
class Packing:
    """The settings with which blocks are packed: a renderer's arguments of ``packed_model``."""

    merge: bool
    background: tuple[float, float, float]
    antialiased: bool
    sh_degree: int = 0

    def name(self, block: Block) -> str:
        """Return the name of a block in the cache: a hash of everything that its arrays depend on."""
        recipe = [PACKED_VERSION, LEVELS_VERSION, asdict(self), block.digest]
        return blake2b(json.dumps(recipe).encode(), digest_size=16).hexdigest()

    def packed(self, block: Block) -> Arrays:
        """Pack a block with ``packed_model``, or load it from the cache if that has been done before."""
        return cached_arrays(f"packed-{self.name(block)}", lambda: packed_model(block.read(), **asdict(self)))


def for_each_block(make: Callable[[Block], Made], blocks: Sequence[Block], files: Sequence[str]) -> Iterator[Made]:
    """Call ``make`` on each block in parallel, with a progress bar if any of ``files`` is not in the cache yet."""
    known = all((cache_dir() / f"{name}.npz").is_file() for name in files)
    with ThreadPoolExecutor(threads_of(None)) as pool:
        yield from Bar(pool.map(make, blocks), "pack blocks", len(blocks), unit="block", disable=known)
