"""Splits a large splat into blocks: a folder that ``read_scene`` opens without reading all of it."""

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from splatrl.scenes.blocks import MOST_BLOCKS, write_blocks
from splatrl.scenes.formats import write_gaussians
from splatrl.scenes.gaussians import INVISIBLE, Gaussians
from splatrl.scenes.scene import Bounds, Scene
from splatrl.values import require_number

BLOCK = "block-"
"""Start of the name of a block's file."""
AROUND = "around"
"""Name of the block for everything outside: the sky, the countryside up to the horizon, and stray Gaussians."""


def split_files(folder: Path) -> list[Path]:
    """Return the files in a folder that have the names which ``write_split`` gives to blocks."""
    name = re.compile(rf"({BLOCK}\d+-\d+|{AROUND})\.(ply|spz)")
    return sorted(path for path in folder.glob("*") if name.fullmatch(path.name))


def write_split(
    folder: Path,
    scene: Scene,
    size: float,
    ending: str = ".ply",
    bounds: Bounds | None = None,
    proposals: Mapping[str, Any] | None = None,
    antialiased: bool | None = None,
) -> list[str]:
    """Split a scene into square blocks along x and y, and write them with their ``blocks.yaml``.

    A Gaussian belongs to the block that contains its mean. Gaussians more than a block outside the scene's bounds form
    a block of their own.

    Args:
        folder: an existing folder to write to.
        scene: the scene, in the world frame.
        size: side of a block, metres.
        ending: file extension; .ply keeps the values, .spz rounds them and takes a fifth of the space.
        bounds: bounds of the region for robots, to be stated in ``blocks.yaml``; None takes the scene's own.
        proposals: training settings that the scene proposes.
        antialiased: whether the splat was trained antialiased, for the splat files; None if that is not known.

    Returns:
        Names of the splat files.

    Raises:
        ValueError: for a size below a millimetre, or one that gives more than ``MOST_BLOCKS`` blocks.
    """
    require_number("--split", size, 1e-3)
    (left, bottom, low), (right, top, high) = scene.bounds
    columns, rows = (max(1, math.ceil((end - start) / size - 1e-6)) for start, end in ((left, right), (bottom, top)))
    gaussians: Gaussians = scene.gaussians[scene.gaussians.opacities >= INVISIBLE]  # readers drop the others
    places = gaussians.means[:, :2].double().numpy()
    cells = np.floor((places - (left, bottom)) / size).astype(np.int64)
    outside = ((cells < -1) | (cells > (columns, rows))).any(1)
    numbers = (cells[:, 0] + 1) * (rows + 2) + cells[:, 1] + 1
    numbers[outside] = -1
    found = np.unique(numbers)
    if len(found) > MOST_BLOCKS:
        raise ValueError(
            f"--split: expected at most {MOST_BLOCKS:,} blocks, got {len(found):,} of {size:g} m; choose a larger size"
        )
    blocks: dict[str, Bounds] = {}
    for number in found.tolist():
        chosen = gaussians[numbers == number]
        column, row = number // (rows + 2), number % (rows + 2)
        x, y = left + (column - 1) * size, bottom + (row - 1) * size
        name = f"{AROUND if number < 0 else f'{BLOCK}{column}-{row}'}{ending}"
        blocks[name] = _box(chosen.means.numpy()) if number < 0 else ((x, y, low), (x + size, y + size, high))
        write_gaussians(folder / name, chosen, antialiased)
    write_blocks(folder, scene.name, blocks, bounds or scene.bounds, proposals)
    return list(blocks)


def _box(means: np.ndarray[Any, Any]) -> Bounds:
    """Return the bounding box of points."""
    low, high = means.min(0).tolist(), means.max(0).tolist()
    return (low[0], low[1], low[2]), (high[0], high[1], high[2])
