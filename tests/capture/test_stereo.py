"""Depths of photos, from their neighbours or a sensor: correct where the photos determine them, else unknown."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from torch import Tensor

from splatrl.cameras import Cameras, intrinsics, look_at
from splatrl.capture.base import CaptureError, Reconstruction
from splatrl.capture.fitting.pictures import frame_of, pictures
from splatrl.capture.stereo import Depths, find_depths
from splatrl.native import _core
from splatrl.renderers import NativeRenderer
from splatrl.scenes.gaussians import Gaussians

WIDTH, HEIGHT, COUNT = 96, 72, 12
WALL, BOX = 3.0, 1.8
"""Depth of a speckled wall, and of a speckled box in front of it."""


def speckled() -> Gaussians:
    """Return a wall of coloured discs, and a smaller, nearer one in front of its middle."""
    random = torch.Generator().manual_seed(0)

    def sheet(half: float, far: float, count: int) -> Tensor:
        flat = (2 * torch.rand(count, 2, generator=random) - 1) * half
        return torch.cat([flat, torch.full((count, 1), far)], 1)

    means = torch.cat([sheet(2.6, WALL, 9000), sheet(0.5, BOX, 1200)])
    count = len(means)
    return Gaussians(
        means=means,
        quats=torch.tensor([1.0, 0, 0, 0]).repeat(count, 1),
        scales=torch.tensor([0.03, 0.03, 0.002]).repeat(count, 1),
        opacities=torch.full((count,), 0.95),
        sh=torch.randn(count, 1, 3, generator=random),
        batch_size=[count],
    )


def photographed(
    folder: Path, count: int, side: float, every: int, changed: Callable[[int, Tensor], Tensor]
) -> Reconstruction:
    """Photograph the wall and the box from a row of places.

    Args:
        folder: where the photos are written.
        count: number of photos.
        side: distance from the middle of the row to either end.
        every: stride with which Gaussians become points of the reconstruction.
        changed: function of a photo's number and image [H, W, 3] uint8 that returns the image to write.
    """
    scene, across = speckled(), torch.linspace(-side, side, count)
    eyes = torch.stack([across, 0.1 * torch.sin(9 * across), torch.zeros(count)], 1)
    poses = look_at(eyes, eyes + torch.tensor([0.0, 0.0, 1.0]), up=(0.0, -1.0, 0.0))
    K = intrinsics(0.9, WIDTH, HEIGHT)
    paths = []
    for row, image in enumerate(NativeRenderer(scene, threads=1).pixels(Cameras(poses, K, WIDTH, HEIGHT))):
        paths.append(folder / f"{row:02d}.png")
        Image.fromarray(changed(row, image).numpy()).save(paths[-1])
    points = scene.means[::every].double()
    return Reconstruction(
        paths=paths,
        width=WIDTH,
        height=HEIGHT,
        K=K.double(),
        camera_to_world=poses.double(),
        points=points,
        colors=torch.zeros(len(points), 3, dtype=torch.uint8),
        seen_point=torch.arange(len(points)).repeat(count),
        seen_by=torch.arange(count).repeat_interleave(len(points)),
    )


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Reconstruction:
    return photographed(tmp_path_factory.mktemp("photos"), COUNT, 0.4, 150, lambda row, image: image)


@pytest.fixture(scope="module")
def depths(capture: Reconstruction) -> Depths:
    return found(capture)


def drawn_depths(capture: Reconstruction) -> Tensor:
    """Return the true depths: [N, H, W]."""
    cameras = Cameras(capture.camera_to_world.float(), capture.K.float(), WIDTH, HEIGHT)
    return NativeRenderer(speckled()).render(cameras).depth


def found(capture: Reconstruction, threads: int = 1, rows: Tensor | None = None) -> Depths:
    return find_depths(
        capture, frame_of(capture.camera_to_world), torch.arange(COUNT) if rows is None else rows, threads
    )


@pytest.mark.parametrize("isa", _core.supported_isas())
def test_depths_match_the_scene(capture: Reconstruction, isa: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SPLATRL_ISA", isa)
    depths, truth = found(capture), drawn_depths(capture)
    far, known = depths.far(frame_of(capture.camera_to_world)), depths.known > 0
    assert known.float().mean() > 0.75
    error = (far / truth - 1).abs()[known]
    assert error.median() < 0.006
    assert (error > 0.1).float().mean() < 0.08, "only around the box, which the matching window widens"
    assert (depths.likely > 0).all()


def test_depths_do_not_depend_on_the_number_of_threads(capture: Reconstruction, depths: Depths) -> None:
    one, three = depths, found(capture, 3)
    assert torch.equal(one.likely, three.likely) and torch.equal(one.known, three.known)


def test_held_out_photos_have_no_depths_and_do_not_influence_others(capture: Reconstruction, tmp_path: Path) -> None:
    rows = torch.tensor([row for row in range(COUNT) if row % 4])
    paths = list(capture.paths)
    for row in range(0, COUNT, 4):
        paths[row] = tmp_path / f"{row}.png"
        Image.new("RGB", (WIDTH, HEIGHT)).save(paths[row])
    some, other = found(capture, rows=rows), found(replace(capture, paths=paths), rows=rows)
    assert torch.equal(some.known, other.known) and (some.known[::4] == 0).all()


def test_photos_without_points_get_no_depths(capture: Reconstruction) -> None:
    none = torch.zeros(0, dtype=torch.int64)
    nothing = found(replace(capture, seen_point=none, seen_by=none))
    assert (nothing.known == 0).all() and (nothing.likely == 0).all()


def test_photos_of_noise_have_far_fewer_known_depths(capture: Reconstruction, depths: Depths, tmp_path: Path) -> None:
    random = np.random.default_rng(0)
    paths = [tmp_path / f"{row:02d}.png" for row in range(COUNT)]
    for path in paths:
        noise = random.integers(0, 256, (HEIGHT, WIDTH, 3), np.uint8)
        Image.fromarray(noise).save(path)
    known = found(replace(capture, paths=paths)).known > 0
    assert known.float().mean() < 0.6 * (depths.known > 0).float().mean()


def test_depths_of_points_are_known_at_every_image_size(capture: Reconstruction) -> None:
    frame = frame_of(capture.camera_to_world)
    nothing = Depths(torch.zeros(COUNT, 9, 12), torch.zeros(COUNT, 9, 12))
    (seen,) = pictures(capture, frame, [48])
    known = nothing.at(seen, torch.tensor([3]))
    assert known.shape == (COUNT, 36, 48) and (known[:3] == 0).all()
    count = int((known[3] > 0).sum())
    assert 0.2 * len(capture.points) < count <= len(capture.points)
    truth = torch.tensor([WALL, BOX]) / frame.extent
    away = (1 / known[3][known[3] > 0][:, None] / truth - 1).abs().amin(1)
    assert (away < 0.01).all()


def test_depths_of_a_sensor_are_used_in_the_unit_of_the_frame_and_those_of_photos_where_it_has_none(
    capture: Reconstruction, depths: Depths, tmp_path: Path
) -> None:
    paths = []
    for row in range(COUNT):
        counts = np.full((30, 40), 2500, np.uint16)
        counts[:, :20] = 0
        paths.append(tmp_path / f"{row}.png")
        Image.fromarray(counts).save(paths[-1])
    measured = replace(capture, depths=tuple(paths), depth_unit=0.004)
    frame = frame_of(capture.camera_to_world)
    both = found(measured)
    assert torch.allclose(both.far(frame)[:, :, WIDTH // 2 :], torch.tensor(10.0))
    assert torch.equal(both.known[:, :, : WIDTH // 2], depths.known[:, :, : WIDTH // 2])
    assert torch.equal(both.likely[:, :, : WIDTH // 2], depths.likely[:, :, : WIDTH // 2])
    paths[2].write_bytes(b"no picture")
    with pytest.raises(CaptureError, match=r"2\.png: expected a depth image, uint16 PNG: "):
        found(measured)
    Image.new("RGB", (40, 30)).save(paths[2])
    with pytest.raises(CaptureError, match=r"2\.png: expected a depth image, uint16 PNG: .*one channel"):
        found(measured)
