"""Deviation of a reconstruction from the truth, checked with known similarities."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from splatrl.capture.base import Reconstruction
from splatrl.capture.truth import Truth, closest_similarity, deviation, read_truth, true_poses
from splatrl.capture.world import Placed, moved
from tests.capture.walks import WIDTH, K, similarity_of, walk

TIME = torch.arange(40).double() / 10
SECONDS = TIME + 0.03


@pytest.fixture(scope="module")
def truth() -> Truth:
    return Truth(walk().camera_to_world, TIME, K)


def placed(reconstruction: Reconstruction) -> Placed:
    return Placed(replace(reconstruction, seconds=SECONDS), torch.eye(4), "distance", 0.03, "floor", 0.5, 1.4, 100)


def tilted(degrees: float, scale: float) -> np.ndarray:
    cosine, sine = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    transform = np.eye(4)
    transform[:3, :3] = scale * np.array([[1, 0, 0], [0, cosine, -sine], [0, sine, cosine]])
    transform[:3, 3] = [0.3, -2.0, 0.1]
    return transform


def test_a_known_similarity_is_recovered(truth: Truth) -> None:
    places = truth.camera_to_world[:, :3, 3]
    for seed in range(3):
        known = torch.from_numpy(similarity_of(seed))
        torch.testing.assert_close(closest_similarity(places, places @ known[:3, :3].T + known[:3, 3]), known)


def test_known_errors_of_up_scale_and_focal_length_are_measured(truth: Truth) -> None:
    off = placed(moved(walk(), tilted(3.0, 1.02)))
    off = replace(off, reconstruction=replace(off.reconstruction, K=1.05 * K))
    found = deviation(off, replace(truth, K=2 * K), 2 * WIDTH)
    assert found.up_deg == pytest.approx(3.0, abs=1e-3) and found.scale == pytest.approx(0.02, abs=1e-6)
    assert found.focal == pytest.approx(0.05) and found.path < 1e-9 and found.turn_deg < 0.05
    inverse = torch.from_numpy(np.linalg.inv(tilted(3.0, 1.02)))
    torch.testing.assert_close(found.world_from_capture, inverse)


def test_errors_of_camera_positions_are_given_in_metres_and_relative_to_the_path(truth: Truth) -> None:
    noise = 0.05 * torch.randn(40, 3, generator=torch.Generator().manual_seed(0)).double()
    poses = truth.camera_to_world.clone()
    poses[:, :3, 3] += noise
    found = deviation(placed(replace(walk(), camera_to_world=poses)), truth, WIDTH)
    assert found.metres == pytest.approx(0.05 * math.sqrt(3), rel=0.15)
    assert found.path == pytest.approx(
        found.metres / float(truth.camera_to_world[:, :3, 3].diff(dim=0).norm(dim=1).sum())
    )


def test_cameras_are_compared_with_the_true_poses_of_their_times(truth: Truth) -> None:
    some = replace(walk(), seconds=torch.tensor([0.31, 3.9, 0.0]).double())
    assert torch.equal(true_poses(some, truth), truth.camera_to_world[[3, 39, 0]])
    with pytest.raises(ValueError, match="seconds: expected the times"):
        true_poses(walk(), truth)


def test_the_truth_beside_a_video_is_read_and_checked(tmp_path: Path, truth: Truth) -> None:
    video, path = tmp_path / "walk.mp4", tmp_path / "walk.npz"
    with pytest.raises(FileNotFoundError, match=r"walk\.npz: expected the ground truth of walk\.mp4"):
        read_truth(video)
    content = {"camera_to_world": truth.camera_to_world.numpy(), "time": TIME.numpy(), "K": K.numpy()}
    np.savez(path, **content)
    assert torch.equal(read_truth(video).camera_to_world, truth.camera_to_world)
    np.savez(path, **content | {"time": TIME.numpy()[:-1]})
    with pytest.raises(ValueError, match=r"camera_to_world: expected finite numbers of shape \(39, 4, 4\)"):
        read_truth(video)
    np.savez(path, camera_to_world=truth.camera_to_world.numpy())
    with pytest.raises(ValueError, match=r"walk\.npz: expected a \.npz with camera_to_world, time, K"):
        read_truth(video)
    np.savez(path, **content | {"K": np.array([{}], object)})
    with pytest.raises(ValueError, match=r"walk\.npz: expected a complete \.npz"):
        read_truth(video)
    path.write_bytes(path.read_bytes()[:-40])  # the archive's directory is damaged
    with pytest.raises(ValueError, match=r"walk\.npz: expected a complete \.npz"):
        read_truth(video)
