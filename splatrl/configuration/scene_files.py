"""Metadata of scene files and folders, read when a command line chooses them."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from splatrl.native.threads import usable_cores
from splatrl.scenes import yards
from splatrl.scenes.blocks import BLOCKS_FILE, is_in_blocks, read_blocks_description, scene_place
from splatrl.scenes.description import SCENE_FILE, read_description
from splatrl.scenes.formats.reading import META
from splatrl.waits import Bar

__all__ = ["described", "found_scene", "is_in_blocks", "make_yards", "yard_proposals"]

yard_proposals = yards.proposals


def found_scene(typed: str) -> str:
    """Return the path of a scene as it was typed, or its folder if ``scene.yaml`` or ``blocks.yaml`` was typed.

    Raises:
        ValueError: for a folder without a scene; the message says how to make one.
    """
    path = scene_place(Path(typed))
    if path.is_dir() and not any((path / name).is_file() for name in (SCENE_FILE, BLOCKS_FILE, META)):
        raise ValueError(
            f"scene: expected a splat file, or a folder with {SCENE_FILE} or {BLOCKS_FILE}, got {path}; "
            f"make one with splatrl-scene <splat file> --out {path}"
        )
    return typed if path == Path(typed) else str(path)


def described(place: Path) -> dict[str, Any]:
    """Read the description in a scene's folder; empty if there is none.

    Raises:
        ValueError: for an invalid ``scene.yaml`` or ``blocks.yaml``.
    """
    place = scene_place(place)
    if is_in_blocks(place):
        return read_blocks_description(place)
    return read_description(place) if (place / SCENE_FILE).is_file() else {}


def make_yards(seeds: Sequence[int]) -> None:
    """Generate, in parallel, the yards that are not cached yet."""
    made = yards.made_yards(seeds, usable_cores())
    for _ in Bar(made, "yards", len(seeds), unit="yard"):
        pass
