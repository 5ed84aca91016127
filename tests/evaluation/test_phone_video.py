"""A simulated phone video shows the scene as a phone would, and records where the phone was."""

from dataclasses import replace
from pathlib import Path

import av
import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from splatrl.cameras import Cameras
from splatrl.evaluation.phone_video import Phone, phone_video
from splatrl.evaluation.phone_walk import camera_poses
from splatrl.renderers import NativeRenderer
from tests.tiny import tiny_gaussians

PHONE = Phone(96, 64, 20, glimpses=1, drift=0.0, noise=0.0)
RENDERER = NativeRenderer(tiny_gaussians())


def walk(frames: int = 12, turn: float = 0.05) -> torch.Tensor:
    """Walk past the south side of the block, turning by ``turn`` radians per frame: [T, 6]."""
    step = torch.arange(frames).double()
    nothing = torch.zeros(frames).double()
    return torch.stack([0.02 * step - 1, nothing - 1, nothing + 0.5, turn * step, nothing + 0.1, nothing], 1)


def filmed(path: Path, phone: Phone, turn: float = 0.05, seed: int = 0) -> NDArray[np.float64]:
    phone_video(RENDERER, walk(turn=turn), phone, path, seed)
    with av.open(str(path)) as container:
        assert container.streams.video[0].average_rate == phone.fps
        return np.stack([frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]).astype(float)


def seen(phone: Phone) -> NDArray[np.float64]:
    cameras = Cameras(camera_poses(walk()).float(), phone.K, phone.width, phone.height)
    return RENDERER.pixels(cameras).numpy().astype(float)


def test_a_video_shows_what_its_ground_truth_cameras_see(tmp_path: Path) -> None:
    told: list[tuple[int, int]] = []
    truth = phone_video(RENDERER, walk(), PHONE, tmp_path / "film.mp4", progress=lambda *now: told.append(now))
    assert truth == tmp_path / "film.npz" and told == [(number + 1, 12) for number in range(12)]
    with np.load(truth) as known:
        np.testing.assert_array_equal(known["camera_to_world"], camera_poses(walk()).numpy())
        np.testing.assert_allclose(known["time"], np.arange(12) / 20)
        np.testing.assert_allclose(known["K"], PHONE.K.numpy())
    frames = filmed(tmp_path / "again.mp4", PHONE)
    assert frames.shape == (12, 64, 96, 3)
    assert np.abs(frames - seen(PHONE)).mean() < 4.0  # the loss of H.264 with subsampled chroma


@pytest.mark.usefixtures("usual_videos")
def test_the_same_seed_gives_the_same_bytes(tmp_path: Path) -> None:
    phone = replace(PHONE, noise=3.0, drift=0.2)
    for number in range(12):
        phone_video(RENDERER, walk(), phone, tmp_path / f"{number}.mp4", seed=number // 11)
    first, *again, other = ((tmp_path / f"{number}.mp4").read_bytes() for number in range(12))
    assert all(film == first for film in again) and other != first


def test_an_open_shutter_causes_motion_blur(tmp_path: Path) -> None:
    sharp = filmed(tmp_path / "sharp.mp4", PHONE, turn=0.2)
    blurred = filmed(tmp_path / "blurred.mp4", replace(PHONE, shutter=0.05, glimpses=5), turn=0.2)
    edges = [np.abs(np.diff(film[..., 1], axis=2)).mean() for film in (sharp, blurred)]
    assert edges[1] < 0.8 * edges[0]
    still = filmed(tmp_path / "still.mp4", replace(PHONE, shutter=0.0, glimpses=5), turn=0.2)
    assert np.abs(still - sharp).mean() < 1.0


def test_the_exposure_drifts_and_noise_covers_the_image(tmp_path: Path) -> None:
    calm = seen(PHONE)
    drifting = filmed(tmp_path / "drift.mp4", replace(PHONE, drift=1.0, fps=1))
    gains = drifting.mean((1, 2, 3)) / calm.mean((1, 2, 3))
    assert gains.max() > 1.1 and gains.min() < 0.9
    noisy = filmed(tmp_path / "noise.mp4", replace(PHONE, noise=12.0)) - filmed(tmp_path / "calm.mp4", PHONE)
    assert 5.0 < noisy[..., 1].std() < 13.0


def test_invalid_phone_settings_are_refused() -> None:
    with pytest.raises(ValueError, match="width: expected an even number of pixels, got 95"):
        replace(PHONE, width=95)
    with pytest.raises(ValueError, match="glimpses: expected a whole number of at least 1, got 0"):
        replace(PHONE, glimpses=0)
