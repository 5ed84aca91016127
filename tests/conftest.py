"""Fixtures that several rooms share."""

import os
from pathlib import Path

import pytest
import torch

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


NO_GPU = "no CUDA device" if not torch.cuda.is_available() else ""


@pytest.fixture(scope="session")
def cuda_device() -> torch.device:
    """The GPU; tests that need it are marked ``gpu``, and are skipped where there is none."""
    if NO_GPU:
        pytest.skip(NO_GPU)
    pytest.importorskip("cuda.bindings", reason="needs the extra cuda")
    return torch.device("cuda", torch.cuda.current_device())


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """Say where the tests of ``-m gpu`` ran, or that they did not."""
    if "gpu" in (config.option.markexpr or "").replace("not gpu", ""):
        where = NO_GPU and f"{NO_GPU}: nothing that needs one was tested"
        terminalreporter.write_line(where or f"tested on {torch.cuda.get_device_name()}")
