"""Images that were chosen and prepared already stay as they are, or are copied into one folder as they are stored."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from splatrl.capture.base import CaptureError, Photos
from splatrl.capture.poses import job_of
from splatrl.capture.recordings import read_recording
from splatrl.capture.recordings.turning import stated_turns, turned_camera, turned_poses
from splatrl.images import orientation
from tests.capture.ray_cast import K, room_image
from tests.capture.recorded import as_seen

COUNT = 6
NUMBERED = tuple(f"images/{number}.png" for number in range(COUNT))
TWO_FOLDERS = tuple(f"images/cam{number % 2}/{number // 2}.jpg" for number in range(COUNT))
TWO_SUFFIXES = tuple(f"images/{number // 2}.{('jpg', 'png')[number % 2]}" for number in range(COUNT))
EXIF_OF_TURNS = {0: 1, 1: 8, 2: 3, 3: 6}
"""Orientations in EXIF, by the counter-clockwise quarter turns that they ask for."""


def around() -> np.ndarray:
    """Return poses [COUNT, 4, 4] of a camera that looks all around in the room, and a little down."""
    poses = np.tile(np.eye(4), (COUNT, 1, 1))
    for pose, yaw in zip(poses, np.linspace(0.3, 6.0, COUNT), strict=True):
        right = np.array([np.sin(yaw), -np.cos(yaw), 0.0])
        forward = np.array([np.cos(0.2) * np.cos(yaw), np.cos(0.2) * np.sin(yaw), -np.sin(0.2)])
        pose[:3, :3] = np.stack([right, np.cross(forward, right), forward], 1)
        pose[:3, 3] = 0.3 * np.cos(yaw), 0.4 * np.sin(yaw), 0.0
    return poses


def _write(
    folder: Path,
    names: Sequence[str] = NUMBERED,
    exif: int | None = None,
    stored_turns: int = 0,
    **settings: object,
) -> Path:
    """Write ``transforms.json`` and images that a camera took after it was rolled by some quarters clockwise."""
    size, lens = turned_camera((320, 240), K, -stored_turns % 4)
    frames = []
    for name, upright in zip(names, around(), strict=True):
        pose = turned_poses(upright, -stored_turns % 4)
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        tags = Image.Exif()
        tags[0x0112] = exif or 1
        image = Image.fromarray(room_image(pose, K=lens, size=size))
        image.save(folder / name, **({} if exif is None else {"exif": tags}), **({} if name.endswith("png") else FINE))
        frames.append({"file_path": name, "transform_matrix": (pose @ np.diag([1.0, -1, -1, 1])).tolist()})
    shared = {"w": size[0], "h": size[1], "fl_x": lens[0, 0], "fl_y": lens[1, 1], "cx": lens[0, 2], "cy": lens[1, 2]}
    (folder / "transforms.json").write_text(json.dumps({**shared, **settings, "frames": frames}))
    return folder


FINE = {"quality": 97, "subsampling": 0}


def _off(photos: Photos, number: int) -> float:
    """Return the mean difference between an image and what its camera sees in the room, grey levels."""
    assert photos.K is not None and photos.camera_to_world is not None
    pose, size = photos.camera_to_world[number].numpy(), (photos.width, photos.height)
    expected = room_image(pose, K=photos.K.numpy(), size=size).astype(float)
    shown = Image.open(photos.paths[number])
    assert shown.size == size and orientation(photos.paths[number]) == 1
    return float(np.abs(np.asarray(shown.convert("RGB")) - expected)[8:-8, 8:-8].mean())


def test_images_in_one_folder_stay_where_they_are(tmp_path: Path) -> None:
    source = _write(tmp_path / "in")
    photos = read_recording(source, tmp_path / "out")
    assert photos.paths == [source / name for name in NUMBERED] and not (tmp_path / "out").exists()


@pytest.mark.parametrize("names", [TWO_FOLDERS, TWO_SUFFIXES])
@pytest.mark.parametrize("k1", [0.0, 1e-6])
def test_images_of_the_same_name_are_told_apart(tmp_path: Path, names: Sequence[str], k1: float) -> None:
    pytest.importorskip("cv2")
    source = _write(tmp_path / "in", names, k1=k1)
    photos = read_recording(source, tmp_path / "out")
    assert max(_off(photos, number) for number in range(COUNT)) < 7
    if names is TWO_FOLDERS or k1:
        assert [path.stem for path in photos.paths] == [f"{number:04}" for number in range(COUNT)]
        assert len(job_of(photos, exact_camera=True).names) == COUNT
    again = read_recording(source, tmp_path / "out")
    assert again.paths == photos.paths


@pytest.mark.parametrize("name", ["IMG 0001 ({}).png", "#{}.png"])
def test_images_whose_names_colmap_would_misread_in_a_list_are_copied(tmp_path: Path, name: str) -> None:
    source = _write(tmp_path / "in", [f"images/{name.format(number)}" for number in range(COUNT)])
    photos = read_recording(source, tmp_path / "out")
    assert job_of(photos).names == [f"{number:04}.png" for number in range(COUNT)]
    assert photos.files[2] == f"images/{name.format(2)}" and max(_off(photos, number) for number in (0, 5)) < 1


@pytest.mark.parametrize("turns", range(4))
@pytest.mark.parametrize("k1", [0.0, 1e-6])
def test_images_are_turned_as_their_exif_says_together_with_their_poses(tmp_path: Path, turns: int, k1: float) -> None:
    pytest.importorskip("cv2")
    source = _write(tmp_path / "in", exif=EXIF_OF_TURNS[turns], stored_turns=turns, k1=k1)
    photos = read_recording(source, tmp_path / "out")
    assert (photos.width, photos.height) == (320, 240) and photos.camera_to_world is not None
    np.testing.assert_allclose(photos.camera_to_world, around(), atol=1e-9)
    assert max(_off(photos, number) for number in range(COUNT)) < 7


@pytest.mark.parametrize("exif", [2, 3, 5, 6, 8])
def test_an_orientation_that_the_poses_contradict_is_ignored(tmp_path: Path, exif: int) -> None:
    photos = read_recording(_write(tmp_path / "in", exif=exif), tmp_path / "out")
    assert photos.camera_to_world is not None
    np.testing.assert_allclose(photos.camera_to_world, around(), atol=1e-9)
    assert max(_off(photos, number) for number in range(COUNT)) < 7


def test_the_orientation_of_most_images_counts_where_the_poses_leave_it_open() -> None:
    poses = around()[:1].repeat(5, 0)
    assert stated_turns(poses, [6, 6, 6, 1, 8]) == 3 and stated_turns(poses, [1, 6, 1]) == 0


@pytest.mark.parametrize("k1", [0.0, -0.1])
@pytest.mark.parametrize("damage", ["size", "nothing", "text"])
def test_an_image_of_another_size_or_without_one_is_named(tmp_path: Path, k1: float, damage: str) -> None:
    pytest.importorskip("cv2")
    source = _write(tmp_path / "in", k1=k1)
    image, message = source / "images" / "2.png", "expected a complete PNG or JPEG or WEBP"
    if damage == "size":
        Image.new("RGB", (160, 120)).save(image)
        message = "expected 320 × 240 pixels, as most images have, got 160 × 120"
    else:
        image.write_bytes(b"" if damage == "nothing" else b"no image")
    with pytest.raises(CaptureError, match=rf"images/2\.png: {message}"):
        read_recording(source, tmp_path / "out")


def test_an_image_that_breaks_off_is_named_where_distortion_is_removed(tmp_path: Path) -> None:
    pytest.importorskip("cv2")
    source = _write(tmp_path / "in", k1=-0.1)
    content = (source / "images" / "2.png").read_bytes()
    (source / "images" / "2.png").write_bytes(content[: len(content) // 2])
    with pytest.raises(CaptureError, match=r"images/2\.png: expected a complete PNG"):
        read_recording(source, tmp_path / "out")
    assert not (tmp_path / "out" / "recorded").exists()


LENSES = {"radial": (-0.1, 0.02, 0.0, 0.0), "tangential": (0.05, 0.0, 0.002, -0.003), "pinhole": (0.0,) * 4}
"""OpenCV's k1, k2, p1 and p2, by what is special about them."""


def _lens_each(folder: Path, kind: str, sides: Sequence[tuple[int, int]]) -> Path:
    """Write images of given sizes, each with a focal length, principal point and distortion of its own."""
    cv2 = pytest.importorskip("cv2")
    (folder / "images").mkdir(parents=True)
    frames, random = [], np.random.default_rng(0)
    for number, (pose, (width, height)) in enumerate(zip(around(), sides, strict=True)):
        f, cx, cy = 260 + random.normal(), width / 2 + 2 + random.normal(), height / 2 - 3 + random.normal()
        distortion = np.array(LENSES[kind]) * random.uniform(0.7, 1.3)
        lens = np.array([[f, 0, cx], [0, f, cy], [0, 0, 1]])
        wide = np.array([[f, 0, width], [0, f, height], [0, 0, 1]])
        x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
        rays = cv2.undistortPoints(np.stack([x, y], -1).reshape(-1, 1, 2), lens, distortion).reshape(height, width, 2)
        at = (rays * f + [width - 0.5, height - 0.5]).astype(np.float32)  # OpenCV's first pixel has its centre at 0
        seen = cv2.remap(room_image(pose, K=wide, size=(2 * width, 2 * height)), at, None, cv2.INTER_CUBIC)
        Image.fromarray(seen).save(folder / "images" / f"{number}.png")
        own = {"w": width, "h": height, "fl_x": f, "fl_y": f, "cx": cx, "cy": cy}
        own |= dict(zip(("k1", "k2", "p1", "p2"), distortion.tolist(), strict=True))
        opengl = (pose @ np.diag([1.0, -1, -1, 1])).tolist()
        frames.append({"file_path": f"images/{number}.png", "transform_matrix": opengl, **own})
    (folder / "transforms.json").write_text(json.dumps({"frames": frames}))
    return folder


@pytest.mark.parametrize("kind", LENSES)
def test_images_with_a_lens_and_a_size_each_are_shown_as_one_camera_sees_them(tmp_path: Path, kind: str) -> None:
    sides = [(320 - number % 4, 240 - number % 3) for number in range(COUNT)]
    source = _lens_each(tmp_path / "in", kind, sides)
    for longest, width in ((960, 317), (160, 160)):
        photos = read_recording(source, tmp_path / str(longest), longest=longest)
        assert photos.width == width and photos.K is not None
        assert photos.K[0, 0] / width == pytest.approx(0.82, rel=0.06), "hardly more is cut off than must be"
        for number in range(COUNT):
            off, moved = as_seen(photos, number, np.eye(4))
            assert off < 4.5 and off < 0.35 * moved
