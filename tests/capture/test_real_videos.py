"""Videos with ground truth, captured end to end by the command and compared with it; each takes minutes."""

import importlib
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import torch

from splatrl.capture.pipeline import reconstruct
from splatrl.capture.settings import CaptureSettings
from splatrl.capture.truth import deviation, read_truth
from splatrl.scenes.description import read_description

pytestmark = pytest.mark.slow
pytest.importorskip("cv2")
pytest.importorskip("pycolmap")
ROOT = Path(__file__).parents[2]
HEIGHT, WIDTH = 1.5, 960
"""Mean height of the camera above the floor, metres, and image width, pixels, of the rendered videos."""


def captured(video: Path, folder: Path, height: float) -> dict[str, Any]:
    """Capture a video with the command, and return the quality figures of its ``scene.yaml``."""
    if not video.is_file():
        pytest.skip(f"{video} is not here")
    words = [str(video), "--out", str(folder), "--camera-height", str(height), "--device", "cpu"]
    command = [sys.executable, "-m", "splatrl.commands.capture", *words]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    assert f"splatrl-train scene={folder}/" in done.stdout
    found: dict[str, Any] = read_description(folder)["quality"]
    return found


def against_truth(place: str, folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> Any:
    """Return the figures that ``benchmarks/capture_truth.py`` prints."""
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    module = importlib.import_module("capture_truth")
    monkeypatch.setattr(sys, "argv", ["capture_truth.py", place, str(folder)])
    capsys.readouterr()
    module.main()
    said = capsys.readouterr().out
    return json.loads(said[said.index("{") :])


@pytest.mark.parametrize("name", ["kitchen_m", "backyard_m"])
def test_a_rendered_video_becomes_a_scene_like_the_one_that_it_shows(
    name: str, shared_scenes: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    video, folder = shared_scenes / "videos" / f"{name}.mp4", tmp_path / name
    quality = captured(video, folder, HEIGHT)
    assert quality["psnr"] > 27 and quality["path_free"] == 1.0
    placed, _ = reconstruct(video, folder, CaptureSettings(camera_height=HEIGHT, still=True))
    off = deviation(placed, read_truth(video), WIDTH)
    assert placed.reconstruction.missing < 0.05
    assert off.path < 0.002 and off.up_deg < 2 and abs(off.scale) < 0.05
    found = against_truth(name.removesuffix("_m"), folder, monkeypatch, capsys)
    assert found["false hits"] < 0.01 and found["recall"] > (0.95 if name == "kitchen_m" else 0.9)
    assert found["starts"] > 100 and found["starts that touch it deeply"] < 0.01


def test_poses_of_photos_along_a_street_are_found(shared_scenes: Path, tmp_path: Path) -> None:
    photos = shared_scenes / "lund" / "photos"
    if not photos.is_dir():
        pytest.skip(f"{photos} is not here")
    placed, _ = reconstruct(photos, tmp_path / "lund", CaptureSettings(camera_height=1.6, still=True))
    places = placed.reconstruction.camera_to_world[:, :3, 3]
    ahead = placed.reconstruction.camera_to_world[:-1, :3, 2]
    steps = places.diff(dim=0)
    assert placed.reconstruction.missing == 0
    assert (torch.nn.functional.cosine_similarity(steps, ahead, dim=1) > 0.9).all()  # walked in the viewing direction
    assert steps.norm(dim=1).max() < 5 * steps.norm(dim=1).median()
    assert placed.reconstruction.K[0, 0].item() == pytest.approx(870 * 960 / 1024, rel=0.1)


def test_the_scene_of_a_real_video_agrees_with_a_depth_sensor(
    shared_scenes: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "red"
    quality = captured(shared_scenes / "videos" / "redkitchen" / "video.mp4", folder, 1.3)
    assert quality["psnr_corrected"] > 24
    found = against_truth("redkitchen", folder, monkeypatch, capsys)
    assert found["AbsRel"] < 0.08 and found["of these occupied"] < 0.0125
