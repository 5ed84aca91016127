"""Access to the optional library gsply, which decodes the formats that splatrl does not decode itself."""

import importlib
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from splatrl.scenes.formats.stored import activated
from splatrl.scenes.gaussians import Gaussians


def extra_module(name: str, path: Path) -> ModuleType:
    """Import a module that the extra ``gsply`` installs.

    It is imported only when the first file needs it, because its compiler takes seconds to start.

    Raises:
        ImportError: if the extra is not installed; the message says how to install it.
    """
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise ImportError(f"{path}: this format needs the extra gsply: pip install 'splatrl[gsply]'") from error


def from_gsply(path: Path, decoded: Any) -> Gaussians:
    """Build Gaussians from gsply's output: log scales, opacity logits and harmonics [N, K, 3] above degree 0."""
    sh = np.concatenate([decoded.sh0[:, None, :], decoded.shN], 1)
    stored = (decoded.means, decoded.quats, decoded.scales, decoded.opacities, sh)
    return activated(path, *(np.ascontiguousarray(values, np.float32) for values in stored))
