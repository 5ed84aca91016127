"""What cameras need of scenes in blocks, and how much of it is in memory at once."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from splatrl.renderers.parts import ABSENT
from splatrl.scenes.blocks import Block

TOP, WHOLE = 1, 2
"""Needs of a camera that sees a block, either its top or all of it: ``Need`` of native/renderer.h."""


class KeptBlock(NamedTuple):
    """Data about a block that is kept even while the block is not in memory.

    Attributes:
        block: the block.
        bounds: [6] float32, bounds of its root, as in ``packed``.
        error: largest error of the nodes where its top ends, metres; infinite if it has no top.
        bytes: memory that the whole model takes.
    """

    block: Block
    bounds: NDArray[np.float32]
    error: float
    bytes: int


class Stack(NamedTuple):
    """The blocks of a scene; slot ``first + 2 k`` of the core holds the top of block k, and the next slot all of it."""

    first: int
    kept: list[KeptBlock]
    bounds: NDArray[np.float32]  # [N, 6]
    errors: NDArray[np.float32]  # [N]
    sizes: NDArray[np.int64]  # [N], bytes


class View(NamedTuple):
    """What some rows need of a scene in blocks that is one of their parts."""

    stack: Stack
    part: int
    rows: Tensor  # [R] int64
    places: NDArray[np.float32]  # [R, 3], of the cameras, in the scene's frame
    needs: NDArray[np.uint8]  # [R, N]

    def slots(self, count: int) -> Tensor:
        """Return the slots that each of ``count`` rows draws, in the order of the blocks: [count, most] int64."""
        row, block = np.nonzero(self.needs)
        shown = np.bincount(row, minlength=len(self.needs))
        place = np.arange(len(row)) - np.repeat(shown.cumsum() - shown, shown)
        slots = np.full((count, shown.max(initial=0)), ABSENT)
        slots[self.rows.numpy()[row], place] = self.stack.first + 2 * block + (self.needs[row, block] == WHOLE)
        return torch.from_numpy(slots)


def spare(views: Sequence[View], rows: int, room: int, merge: bool) -> None:
    """Change the needs of rows that see too much to the tops of all blocks but the nearest that fit into memory.

    Args:
        views: what the rows need; changed in place.
        rows: number of rows.
        room: memory for whole blocks, bytes.
        merge: whether blocks have tops, as they do with level of detail.

    Raises:
        ValueError: for a row that sees too much without tops.
    """
    needed = np.zeros(rows, np.int64)
    for view in views:
        np.add.at(needed, view.rows.numpy(), (view.needs == WHOLE) @ view.stack.sizes)
    for row in np.flatnonzero(needed > room):
        away: list[float] = []
        blocks: list[tuple[View, int, int]] = []
        for view in views:
            for line in np.flatnonzero(view.rows.numpy() == row):
                whole = np.flatnonzero(view.needs[line] == WHOLE)
                apart = view.stack.bounds[whole, :3] - view.places[line]
                away += (np.linalg.norm(apart, axis=1) - view.stack.bounds[whole, 3]).tolist()
                blocks += [(view, int(line), int(block)) for block in whole]
        if not merge:
            raise ValueError(
                f"renderer.budget: expected at least {needed[row]:,} bytes for the {len(blocks)} blocks "
                f"that one camera sees, all of which tolerance=0 needs, got {room:,}"
            )
        held = 0
        for at in np.argsort(away, kind="stable"):
            view, line, block = blocks[at]
            held += int(view.stack.sizes[block])
            if held > room:
                view.needs[line, block] = TOP


def groups(needed: Sequence[set[int]], whole: dict[int, KeptBlock], room: int) -> Iterator[list[int]]:
    """Yield groups of rows whose blocks fit into memory together; rows are grouped in the order of their blocks."""
    group, union, held = list[int](), set[int](), 0
    for row in sorted(range(len(needed)), key=lambda row: sorted(needed[row])):
        held += size(needed[row] - union, whole)
        if held > room and group:
            yield group
            group, union, held = [], set(), size(needed[row], whole)
        group.append(row)
        union |= needed[row]
    if group:
        yield group


def size(slots: set[int], whole: dict[int, KeptBlock]) -> int:
    """Return the memory of whole blocks, given by their slots, bytes."""
    return sum(whole[slot].bytes for slot in slots)
