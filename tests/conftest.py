"""Fixtures that several rooms share."""

import os
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def shared_scenes() -> Path:
    """Folder of the real captured scenes: $SPLATRL_SCENES, or ../shared/scenes beside the checkout."""
    folder = Path(os.environ.get("SPLATRL_SCENES", Path(__file__).parents[2] / "shared" / "scenes"))
    if not folder.is_dir():
        pytest.skip(f"real scenes not found at {folder}; set SPLATRL_SCENES to test with them")
    return folder
