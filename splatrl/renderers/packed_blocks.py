"""The blocks of scenes as packed models in the user's cache directory, which all renderers share."""

import json
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from hashlib import blake2b
from typing import TypeVar

from tqdm import tqdm

from splatrl.files import cache_dir
from splatrl.native.threads import threads_of
from splatrl.renderers.lod import LEVELS_VERSION
from splatrl.renderers.packed import PACKED_VERSION, packed_model
from splatrl.scenes.blocks import Block
from splatrl.scenes.cache import Arrays, cached_arrays

Made = TypeVar("Made")


@dataclass(frozen=True)
class Packing:
    """How blocks are packed: what ``packed_model`` takes, by a renderer's settings."""

    merge: bool
    background: tuple[float, float, float]
    antialiased: bool
    sh_degree: int = 0

    def name(self, block: Block) -> str:
        """Of a block in the cache, by all that its arrays depend on."""
        recipe = [PACKED_VERSION, LEVELS_VERSION, asdict(self), block.digest]
        return blake2b(json.dumps(recipe).encode(), digest_size=16).hexdigest()

    def packed(self, block: Block) -> Arrays:
        """A block as ``packed_model`` packs it, from the cache but for the first time."""
        return cached_arrays(f"packed-{self.name(block)}", lambda: packed_model(block.read(), **asdict(self)))


def for_each_block(make: Callable[[Block], Made], blocks: Sequence[Block], files: Sequence[str]) -> Iterator[Made]:
    """Make something of each block, side by side; with a progress bar where one of these files is not in the cache."""
    known = all((cache_dir() / f"{name}.npz").is_file() for name in files)
    with ThreadPoolExecutor(threads_of(None)) as pool:
        yield from tqdm(pool.map(make, blocks), "blocks", len(blocks), unit="block", disable=known, dynamic_ncols=True)
