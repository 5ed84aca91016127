"""benchmarks/capture.py times stages and judges a capture; the poses and the fit are faked here."""

import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image

import splatrl
from splatrl.cameras import Cameras
from splatrl.capture.check import Quality
from splatrl.capture.world import Placed, moved
from splatrl.evaluation.phone_walk import camera_poses
from splatrl.renderers import NativeRenderer
from splatrl.scenes import write_gaussians
from tests.capture.walks import HEIGHT, WIDTH, K, walk

ROOT = Path(__file__).parents[2]
SIZE = 1.02
QUALITY = Quality(30.0, 0.9, 31.0, 0.9, 5, 1.0, 100, 0, 0.05)


@pytest.fixture
def capture(benchmark: Any, monkeypatch: pytest.MonkeyPatch) -> Any:
    """The benchmark module, with a fake capture that finds every camera and scales lengths by 1.02."""
    module = benchmark("capture")
    scaled = np.diag([SIZE, SIZE, SIZE, 1.0])

    def reconstruct(video: Path, folder: Path, settings: Any, progress: Any, say: Any) -> tuple[Placed, list[str]]:
        folder.mkdir()
        true, gaussians = walk(), splatrl.backyard().gaussians
        cameras = Cameras(true.camera_to_world.float(), K.float(), WIDTH, HEIGHT)
        paths = []
        for number, image in enumerate(NativeRenderer(gaussians).pixels(cameras).numpy()):
            paths.append(folder / f"{number}.png")
            Image.fromarray(image).save(paths[-1], compress_level=1)
        progress("extract", 1, 2)
        progress("extract", 2, 2)
        say("poses       40 of 40")
        time.sleep(0.01)
        found = moved(true, scaled)
        found = type(found)(**{**vars(found), "paths": paths, "seconds": torch.arange(40).double() / 10})
        return Placed(found, torch.eye(4), "camera_height", 0.05, "floor", 0.5, settings.camera_height, 100), []

    def build_scene(placed: Placed, folder: Path, settings: Any, notes: Any, progress: Any, say: Any) -> Quality:
        write_gaussians(folder / "splat.ply", splatrl.backyard().gaussians.transformed(torch.from_numpy(scaled)))
        say("fit         many Gaussians")
        return QUALITY

    monkeypatch.setattr(module, "reconstruct", reconstruct)
    monkeypatch.setattr(module, "build_scene", build_scene)
    monkeypatch.setattr(module, "measured_machine", lambda: None)
    return module


def test_a_capture_is_timed_and_judged_against_its_ground_truth(
    tmp_path: Path, capture: Any, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["capture.py", "--seconds", "0.2", "--size", "64", "48", "--yard", "3"])
    video = capture.filmed(tmp_path / "walk.mp4", capture.parsed())
    written = video.stat().st_mtime_ns
    assert capture.filmed(video, capture.parsed()).stat().st_mtime_ns == written
    np.savez(
        video.with_suffix(".npz"), camera_to_world=walk().camera_to_world, time=np.arange(40) / 10, K=K * 64 / WIDTH
    )
    monkeypatch.setattr(capture, "write_json", lambda kind, machine, results: json.dumps(results[0].ate_metres))
    words = ["capture.py", str(video), "--keep", str(tmp_path / "kept"), "--png", str(tmp_path / "a.png"), "--json"]
    monkeypatch.setattr(sys, "argv", words)
    capture.main()
    said = capsys.readouterr().out
    assert "+2.00 % (by camera_height)" in said and "| up" in said
    rows = [line.split("|")[1].strip() for line in said.splitlines() if line.startswith("|")]
    assert [row for row in rows if row in ("poses", "fit", "extract", "all")] == ["poses", "fit", "extract", "all"]
    held_out = next(line for line in said.splitlines() if "held out" in line)
    assert float(held_out.split("|")[2].split()[0]) > 25  # the images are PNG, and only resized here
    assert Image.open(tmp_path / "a.png").width > 1000


def test_somebody_who_walks_along_stays_ahead_of_the_camera_wherever_it_turns(benchmark: Any) -> None:
    people, scene = benchmark("passers_by"), splatrl.backyard()
    film = people.PassersBy(scene, 0, 1, fps=2.0, tolerance=0.5)
    poses = camera_poses(torch.tensor([[0.1 * step, 0.0, 1.4, 1.5 * step, 0.1, 0.0] for step in range(5)]))
    for pose in poses.float():
        camera = Cameras(pose[None], torch.tensor([[40.0, 0, 32], [0, 40, 24], [0, 0, 1]]), 64, 48)
        empty = NativeRenderer(scene, tolerance=0.5).pixels(camera)
        someone = (film.pixels(camera).int() - empty.int()).abs().amax(-1)[0] > 20
        assert float(someone.float().mean()) > 0.03 and float(someone[:, 12:52].sum()) > 0.9 * float(someone.sum())
