"""Reads what nerfstudio leaves beside a splat that it trained: how it moved the cameras, and how it rendered.

``config.yml`` is YAML with Python tags, which a loader would execute, so the one value needed is searched for as text.
"""

import re
from pathlib import Path

from torch import Tensor

from splatrl.scenes.placement import nerfstudio_transform

DATAPARSER, CONFIG = "dataparser_transforms.json", "config.yml"
MAX_BYTES = 2**20
"""Maximum number of bytes read from ``config.yml``; real files have about a hundredth of that."""
RASTERIZE_MODE = re.compile(r"""^\s*rasterize_mode:\s*['"]?(antialiased|classic)['"]?\s*$""", re.MULTILINE)
UPRIGHT = 0.7
"""Minimum cosine between the world's z and nerfstudio's up."""


def transform_beside(splat: Path) -> Tensor | None:
    """Read ``world_from_splat`` from the ``dataparser_transforms.json`` beside a splat file.

    Args:
        splat: the splat file.

    Returns:
        [4, 4] float64; None if there is no such JSON file.

    Raises:
        ValueError: if the JSON file is damaged.
    """
    path = splat.parent / DATAPARSER
    return nerfstudio_transform(path) if path.is_file() else None


def stands(world_from_splat: Tensor) -> bool:
    """Return whether nerfstudio's up, which is +z of the splat, is roughly the world's up too.

    It is not if the cameras' own frame was not z-up, as with COLMAP and Record3D.

    Args:
        world_from_splat: [4, 4].
    """
    return bool(world_from_splat[2, 2] > UPRIGHT * world_from_splat[2, :3].norm())


def antialiased_beside(splat: Path) -> bool | None:
    """Return whether a splat was trained antialiased, by the ``config.yml`` beside it; None if that does not say.

    Args:
        splat: the splat file.
    """
    path = splat.parent / CONFIG
    if not path.is_file():
        return None
    with path.open("rb") as stream:
        text = stream.read(MAX_BYTES).decode("utf-8", "replace")
    modes = set(RASTERIZE_MODE.findall(text))
    return modes == {"antialiased"} if len(modes) == 1 else None
