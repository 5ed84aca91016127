"""What nerfstudio leaves beside a splat that it trained: how it moved the cameras, and how it drew.

``config.yml`` is YAML with Python's tags, which a loader would run: one value is found in it as text.
"""

import re
from pathlib import Path

from torch import Tensor

from splatrl.scenes.placement import nerfstudio_transform

DATAPARSER, CONFIG = "dataparser_transforms.json", "config.yml"
MAX_BYTES = 2**20
"""Of ``config.yml``; real ones have a hundredth of it."""
RASTERIZE_MODE = re.compile(r"""^\s*rasterize_mode:\s*['"]?(antialiased|classic)['"]?\s*$""", re.MULTILINE)
UPRIGHT = 0.7
"""Least cosine between the world's z and what nerfstudio took for up."""


def transform_beside(splat: Path) -> Tensor | None:
    """``world_from_splat`` by the ``dataparser_transforms.json`` beside a splat file.

    Args:
        splat: the file.

    Returns:
        [4, 4] float64; None where there is no such file.

    Raises:
        ValueError: for one that is damaged.
    """
    path = splat.parent / DATAPARSER
    return nerfstudio_transform(path) if path.is_file() else None


def stands(world_from_splat: Tensor) -> bool:
    """Whether what nerfstudio took for up, +z of the splat, is about the world's up too.

    It is not where the cameras' own frame was not z up, as COLMAP's and Record3D's are not.

    Args:
        world_from_splat: [4, 4].
    """
    return bool(world_from_splat[2, 2] > UPRIGHT * world_from_splat[2, :3].norm())


def antialiased_beside(splat: Path) -> bool | None:
    """Whether a splat was trained antialiased, by the ``config.yml`` beside its file; None where that does not say.

    Args:
        splat: the file.
    """
    path = splat.parent / CONFIG
    if not path.is_file():
        return None
    with path.open("rb") as stream:
        text = stream.read(MAX_BYTES).decode("utf-8", "replace")
    modes = set(RASTERIZE_MODE.findall(text))
    return modes == {"antialiased"} if len(modes) == 1 else None
