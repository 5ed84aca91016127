"""lerobot itself, in its own environment, reads the folders that are written in its format."""

import os
import subprocess
import sys
import venv
from pathlib import Path

import av
import numpy as np
import pytest
import torch

from splatrl.building import build_world
from splatrl.configuration import load_config
from splatrl.datasets import planner_episodes, write_lerobot
from tests.datasets.test_lerobot import RECORDED, sensed
from tests.tiny import tiny_overrides

NEEDED = ["datasets>=4,<5", "huggingface-hub<0.36", "jsonlines", "draccus==0.10.0", "deepdiff", "einops"]
ITSELF = ["lerobot==0.4.4", "torchvision==0.25.0", "accelerate", "safetensors", "psutil"]
"""Installed without dependencies: lerobot's would replace torch with an older one and gigabytes of GPU libraries."""
READER = Path(__file__).with_name("read_with_lerobot.py")


@pytest.fixture(scope="module")
def python(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The Python executable of a new environment with lerobot, which shares our torch, NumPy and PyAV."""
    pytest.importorskip("pyarrow", reason="needs the extra lerobot")
    home = tmp_path_factory.mktemp("environment")
    venv.create(home, with_pip=True)
    (packages,) = home.glob("lib/python*/site-packages")
    shared = {str(Path(module.__file__).parents[1]) for module in (torch, np, av)}
    (packages / "shared.pth").write_text("\n".join(sorted(shared)))
    python = home / "bin" / "python"
    for words in (NEEDED, ["--no-deps", *ITSELF]):
        subprocess.run([python, "-m", "pip", "install", "--quiet", *words], check=True)
    return python


@pytest.mark.slow
@pytest.mark.parametrize("recorded", list(RECORDED))
def test_lerobot_reads_what_was_written(python: Path, recorded: str, tmp_path: Path) -> None:
    task, more = RECORDED[recorded]
    shown = planner_episodes(build_world(load_config([*tiny_overrides(tmp_path, task), *more])), 9)
    write_lerobot(tmp_path / "demos", shown, "Grid in room")
    out = tmp_path / "read.npz"
    settings = os.environ | {"HF_HUB_OFFLINE": "1", "HF_HOME": str(tmp_path / "home")}
    subprocess.run([python, READER, tmp_path / "demos", out], check=True, env=settings, stdout=sys.stderr)
    found, frames = np.load(out), shown.frames
    for key, expected in (
        ("action", frames["action"]),
        ("observation.state", frames["state"]),
        ("next.reward", frames["next", "reward"].squeeze(1)),
        ("next.done", frames["next", "done"].squeeze(1)),
        ("episode_index", frames["episode"]),
        ("frame_index", frames["frame"]),
        *((f"observation.{key}", values) for key, values in sensed(shown).items()),
    ):
        assert found[key].dtype == expected.numpy().dtype, key
        assert found[key].tobytes() == expected.contiguous().numpy().tobytes(), key
    assert (int(found["episodes"]), int(found["fps"]), set(found["task"])) == (9, 10, {"Grid in room"})
    assert found["mean"] == pytest.approx(frames["state"].double().mean(0).numpy())
    views = 255 * found["observation.images.front"].transpose(0, 2, 3, 1)
    error = np.square(views - frames["pixels"].numpy().astype(float)).mean((1, 2, 3))
    assert (-10 * np.log10(error / 255**2)).min() > 25, "the loss of the codec"
