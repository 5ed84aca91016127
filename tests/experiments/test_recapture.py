"""A recaptured scene is aligned with the original; the video, structure from motion and fit are faked here."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from torch import Tensor

from splatrl.building import build_world
from splatrl.capture.base import Reconstruction
from splatrl.capture.check import Quality
from splatrl.capture.world import Placed, moved
from splatrl.collision.point_clouds import read_points, write_points
from splatrl.configuration import load_config
from splatrl.evaluation.phone_video import Phone
from splatrl.evaluation.phone_walk import camera_poses
from splatrl.experiments import recapture as module
from splatrl.experiments.recapture import recapture
from splatrl.scenes import write_gaussians
from splatrl.scenes.description import write_description
from tests.capture.walks import similarity_of
from tests.tiny import tiny_gaussians, tiny_overrides

CAPTURE = similarity_of(5)
"""Similarity from the original's frame to that of the fake capture."""
SCALE = float(np.linalg.det(CAPTURE[:3, :3]) ** (1 / 3))
HAZE = (1.0, -1.0, 0.5)
"""Centre of the voxels that the fake capture knows to be free."""
QUALITY = Quality(30.0, 0.9, 31.0, 0.9, 5, 1.0, 100, 0, 0.05)


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Replace the video by its ground truth alone, and the capture by the original in another frame; list the calls."""
    called: list[str] = []

    def film(renderer: object, walk: Tensor, phone: Phone, path: Path, *_: object) -> None:
        called.append("film")
        path.touch()
        time = np.arange(len(walk)) / phone.fps
        np.savez(path.with_suffix(".npz"), camera_to_world=camera_poses(walk), K=phone.K.double(), time=time)

    def reconstruct(source: Path, *_: object) -> tuple[Placed, list[str]]:
        called.append("reconstruct")
        with np.load(source.with_suffix(".npz")) as truth:
            poses, time, K = (torch.from_numpy(truth[key][::9]) for key in ("camera_to_world", "time", "K"))
        points = torch.zeros(30, 3).double()
        nothing = torch.zeros(0, dtype=torch.int64)
        seen = Reconstruction([], 960, 540, K, poses, points, points.byte(), nothing, nothing, seconds=time)
        return Placed(moved(seen, CAPTURE), torch.eye(4), "distance", 0.03, "floor", 0.5, 0.6, 100), ["a note"]

    def build_scene(placed: Placed, folder: Path, settings: object, notes: list[str], *_: object) -> Quality:
        called.append("fit")
        assert notes == ["a note"]
        folder.mkdir()
        write_gaussians(folder / "splat.ply", tiny_gaussians().transformed(torch.from_numpy(CAPTURE)))
        spots = np.stack(np.meshgrid(*[np.arange(-0.3, 0.3, 0.02)] * 3, indexing="ij"), -1).reshape(-1, 3) + HAZE
        write_points(folder / "free.ply", (spots @ CAPTURE[:3, :3].T + CAPTURE[:3, 3]).astype(np.float32))
        proposals = {"voxel_size": 0.05 * SCALE, "free": "free.ply"}
        write_description(folder, "splat.ply", "made up", {}, ((0, 0, 0), (1, 1, 1)), proposals=proposals)
        return QUALITY

    for stage in (reconstruct, build_scene):
        monkeypatch.setattr(module, stage.__name__, stage)
    monkeypatch.setattr(module, "phone_video", film)
    return called


def test_the_capture_is_aligned_with_the_original_and_keeps_its_task(tmp_path: Path, calls: list[str]) -> None:
    room = tiny_overrides(tmp_path)
    folder = recapture(tmp_path / "loop", {"room": room}, "room")
    original = build_world(load_config([*room, "task=grid"]))
    plain = [one for one in room if not one.startswith(("scene", "landmarks", "robot.height", "task.motion.lower"))]
    plain = [one for one in plain if not one.startswith("task.motion.upper")]  # the folder states all of these
    found = build_world(load_config([f"scene={folder}", *plain]))
    np.testing.assert_allclose(found.scene.gaussians.means, original.scene.gaussians.means, atol=1e-3)
    assert found.robot == original.robot and torch.equal(found.task.motion.origin, original.task.motion.origin)
    np.testing.assert_allclose(found.scene.bounds, original.scene.bounds, atol=1e-3)
    assert found.scene.free is not None and found.scene.free.voxel_size == 0.05
    free = read_points(found.scene.free.path)
    assert np.abs(free - HAZE).max() == pytest.approx(0.3, abs=0.07)
    assert np.prod(np.ptp(free, axis=0) + 0.05) == pytest.approx(len(free) * 0.05**3, rel=0.4)  # the voxels are rotated
    assert calls == ["film", "reconstruct", "fit"]
    assert recapture(tmp_path / "loop", {"room": room}, "room") == folder and calls == ["film", "reconstruct", "fit"]


def test_robots_views_of_the_original_and_the_capture_are_compared_and_drawn(tmp_path: Path, calls: list[str]) -> None:
    room = tiny_overrides(tmp_path)
    recapture(tmp_path / "loop", {"room": room}, "room")
    figures = json.loads((tmp_path / "loop" / "capture.json").read_text())["figures"]
    assert figures["cameras_metres"] < 1e-3 and figures["psnr"] > 30 and figures["blocked"] < 0.1
    page = np.asarray(Image.open(tmp_path / "loop" / "views.png"), float)
    above, below = np.split(page, 2)
    assert above.std() > 20 and np.abs(above - below).mean() < 5


def test_an_existing_video_is_not_made_again(tmp_path: Path, calls: list[str]) -> None:
    room = tiny_overrides(tmp_path)
    folder = recapture(tmp_path / "loop", {"room": room}, "room")
    (folder / "scene.yaml").unlink()
    shutil.rmtree(tmp_path / "loop" / "captured")
    recapture(tmp_path / "loop", {"room": room}, "room")
    assert calls == ["film", "reconstruct", "fit", "reconstruct", "fit"] and (folder / "scene.yaml").is_file()
