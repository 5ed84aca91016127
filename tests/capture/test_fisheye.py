"""Images through a fisheye: the lens is recognised, the cameras are found, and straight lines become straight."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from splatrl.array_files import read_arrays
from splatrl.capture import placing
from splatrl.capture.base import Photos
from splatrl.capture.lens import WIDEST, Lens
from splatrl.capture.photo_files import read_photo
from splatrl.capture.poses import find_poses
from splatrl.capture.settings import CaptureSettings
from splatrl.capture.sfm.fisheye import fisheye
from splatrl.capture.sfm.structure import MODEL, run
from splatrl.capture.sfm.zoom import adjust
from splatrl.capture.stages import Stages
from splatrl.capture.undistort import undistorted
from tests.capture.ray_cast import photos_of, room_image, walk
from tests.capture.test_poses import _similar
from tests.capture.test_zoom import SECONDS, seen_from_a_circle
from tests.capture.walks import walk as walked

cv2 = pytest.importorskip("cv2")
pycolmap = pytest.importorskip("pycolmap")

SIZE, CENTER = (200, 150), (101.0, 74.0)


def seen_through(camera_to_world: np.ndarray, across_deg: float) -> tuple[np.ndarray, float]:
    """Return the image of a room through a lens that maps angles linearly, [H, W, 3] uint8, and its focal length."""
    focal = SIZE[0] / np.radians(across_deg)
    wide = np.array([[240.0, 0, 450], [0, 240, 340], [0, 0, 1]])
    x, y = np.meshgrid(*(np.arange(side) + 0.5 - middle for side, middle in zip(SIZE, CENTER, strict=True)))
    radius = np.hypot(x, y)
    longer = np.tan(np.minimum(radius / focal, 1.4)) / radius
    columns, rows = (x * longer * 240 + 449.5).astype(np.float32), (y * longer * 240 + 339.5).astype(np.float32)
    return cv2.remap(room_image(camera_to_world, 0, wide, (900, 680)), columns, rows, cv2.INTER_LINEAR), focal


def test_cameras_behind_a_fisheye_are_found_and_their_images_become_straight(tmp_path: Path) -> None:
    truth = walk(24)[::4]
    seen = [seen_through(pose, 110.0) for pose in truth]
    photos = photos_of(tmp_path / "in", [image for image, _ in seen])
    found = find_poses(photos, tmp_path / "out")
    assert found.lens is not None and found.lens.fisheye and found.missing == 0
    assert found.lens.fx == pytest.approx(seen[0][1], rel=0.03)
    distance, angle = _similar(found.camera_to_world.numpy(), truth)
    assert distance < 0.02 and angle < 0.01
    kept = read_arrays(tmp_path / "out" / "structure" / MODEL)
    (tmp_path / "out" / "structure" / MODEL).unlink()  # as if it had been interrupted at the end
    run(tmp_path / "out" / "structure")
    again = read_arrays(tmp_path / "out" / "structure" / MODEL)
    assert all(np.array_equal(kept[key], again[key]) for key in kept)


def test_an_ordinary_lens_is_none() -> None:
    model, _ = seen_from_a_circle(np.full(40, 400.0))
    adjust(pycolmap, model)
    before = next(iter(model.cameras.values())).params.copy()
    assert fisheye(pycolmap, model) is None
    camera = next(iter(model.cameras.values()))
    assert camera.model.name == "RADIAL" and np.array_equal(camera.params, before), "the model stays as it was"


@pytest.mark.parametrize("across_deg", [100.0, 170.0])
def test_straight_images_show_all_of_a_fisheye_up_to_a_limit_and_have_no_black_edges(
    across_deg: float, tmp_path: Path
) -> None:
    focal = SIZE[0] / np.radians(across_deg)
    x, y = np.meshgrid(*(np.arange(side) + 0.5 - middle for side, middle in zip(SIZE, CENTER, strict=True)))
    tangents = np.stack([x, y], -1) * (np.tan(np.hypot(x, y) / focal) / np.hypot(x, y))[..., None]
    coded = np.dstack([128 + 60 * np.clip(tangents, -2, 2), np.full((*SIZE[::-1], 1), 200)])
    (path,) = photos_of(tmp_path / "in", [coded.round().astype(np.uint8)]).paths
    lens = Lens(*SIZE, focal, focal, *CENTER, (0.0,) * 4, fisheye=True)
    (straight,), camera = undistorted([path], lens, Stages(tmp_path / "out"), "straight")
    new = camera.K(SIZE)
    shown = np.degrees(np.arctan([new[0, 2] / new[0, 0], (SIZE[0] - new[0, 2]) / new[0, 0]]).sum())
    assert shown == pytest.approx(min(across_deg, 2 * WIDEST), abs=1.5)
    seen = np.asarray(read_photo(straight, upright=False)).astype(float)
    meant = (np.stack([x, y], -1) + CENTER - new[:2, 2]) / new.diagonal()[:2]
    assert np.abs(seen[..., :2] - 128 - 60 * meant).max() < 6 and np.abs(seen[..., 2] - 200).max() < 6


@pytest.mark.parametrize("bent", [False, True])
def test_a_fisheye_is_mentioned(bent: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lens = Lens(*SIZE, 100.0, 100.0, *CENTER, fisheye=bent)
    film = replace(walked(), seconds=SECONDS, lens=lens)
    monkeypatch.setattr(placing, "find_poses", lambda *_, **__: film)
    monkeypatch.setattr(placing, "place", lambda *_, **__: None)
    photos, said = Photos(film.paths, film.width, film.height, SECONDS), list[str]()
    remarks = placing.place_photos(photos, tmp_path, CaptureSettings(), lambda *_: None, said.append, 0.8).remarks
    assert len(remarks) == bent and all("the lens is a fisheye; its images" in remark for remark in remarks)
    assert ("fisheye" in "\n".join(said)) == bent
