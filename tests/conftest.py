"""Fixtures that several rooms share."""

import os
from pathlib import Path

import pytest

from splatrl.scenes import Gaussians, read_gaussians, similarity


@pytest.fixture(scope="session")
def shared_scenes() -> Path:
    """Folder of the real captured scenes: $SPLATRL_SCENES, or ../shared/scenes beside the checkout."""
    folder = Path(os.environ.get("SPLATRL_SCENES", Path(__file__).parents[2] / "shared" / "scenes"))
    if not folder.is_dir():
        pytest.skip(f"real scenes not found at {folder}; set SPLATRL_SCENES to test with them")
    return folder


@pytest.fixture(scope="session")
def kitchen(shared_scenes: Path) -> Gaussians:
    """A captured kitchen, z up, metres."""
    return read_gaussians(shared_scenes / "kitchen" / "kitchen.spz").transformed(similarity(["x", "-z", "y"]))
