"""Recordings with known poses: axes, intrinsics and distortion; malformed and malicious files are refused."""

import itertools
import json
import struct
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from splatrl.capture.base import CaptureError
from splatrl.capture.recordings import colmap, is_recording, read_recording
from tests.capture.ray_cast import K, room_image, walk

SETTINGS = {"w": 640, "h": 480, "fl_x": 520, "fl_y": 518, "cx": 326, "cy": 236}


def _write(folder: Path, names: list[str] | None = None, **settings: object) -> Path:
    (folder / "images").mkdir(parents=True)
    frames = []
    for number, pose in list(enumerate(walk(3)))[::-1]:
        Image.fromarray(room_image(pose)).save(folder / "images" / f"{number + 9}.png")
        opengl = pose @ np.diag([1.0, -1, -1, 1])
        frames.append({"file_path": f"./images/{number + 9}.png", "transform_matrix": opengl.tolist()})
    for frame, name in zip(frames, names or [], strict=False):
        frame["file_path"] = name
    (folder / "transforms.json").write_text(json.dumps({**SETTINGS, **settings, "frames": frames}))
    return folder


def test_transforms_are_read_in_order_with_opencv_axes_and_intrinsics_scaled_to_the_images(tmp_path: Path) -> None:
    source = _write(tmp_path / "in")
    assert is_recording(source) and is_recording(source / "transforms.json")
    photos = read_recording(source, tmp_path / "out")
    assert [path.stem for path in photos.paths] == ["9", "10", "11"]
    torch.testing.assert_close(photos.camera_to_world, torch.from_numpy(walk(3)))
    expected = torch.tensor([[260, 0, 163], [0, 259, 118], [0, 0, 1]]).double()
    torch.testing.assert_close(photos.K, expected)
    assert (photos.width, photos.height, photos.metric, photos.up) == (320, 240, False, None)


def test_lens_distortion_is_removed(tmp_path: Path) -> None:
    cv2 = pytest.importorskip("cv2")
    source = _write(tmp_path / "in", k1=-0.1, fl_y=520)
    centred = K - [[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]]  # OpenCV's first pixel has its centre at 0
    x, y = np.meshgrid(np.arange(320.0), np.arange(240.0))
    rays = cv2.undistortPoints(np.stack([x, y], -1).reshape(-1, 1, 2), centred, np.array([-0.1, 0, 0, 0]))
    at = (rays.reshape(240, 320, 2) * 260 + centred[:2, 2]).astype(np.float32)
    for number, pose in enumerate(walk(3)):
        lens = cv2.remap(room_image(pose), at, None, cv2.INTER_CUBIC)
        Image.fromarray(lens).save(source / "images" / f"{number + 9}.png")
    photos = read_recording(source, tmp_path / "out")
    assert all(path.parent == tmp_path / "out" / "recorded" for path in photos.paths) and photos.K is not None
    shown = np.asarray(Image.open(photos.paths[0]))
    to_new = photos.K.numpy() @ np.linalg.inv(K)  # from pixels of a pinhole camera with the old K to those with the new
    shift = [[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]]
    expected = cv2.warpPerspective(room_image(walk(1)[0]), np.linalg.inv(shift) @ to_new @ shift, (320, 240))
    middle = (slice(30, 210), slice(40, 280))
    off = [np.abs(np.roll(shown, move, 1)[middle] - expected[middle].astype(float)).mean() for move in (0, 1, -1)]
    assert off[0] < 12 and off[0] < 0.6 * min(off[1:])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"names": ["../../secret.png"]}, "expected an image within"),
        ({"names": ["/etc/passwd"]}, "expected an image within"),
        ({"names": ["images/77.png"]}, "found none"),
        ({"w": None}, r"9\.png: w and h: expected the size of the image, or neither, got None and 480\.0"),
        ({"fl_x": None}, r"9\.png: fl_x: expected a focal length in pixels, or camera_angle_x in \(0, π\), got None"),
        ({"cx": [1]}, r"9\.png: cx: expected a number, got \[1\]"),
        ({"is_fisheye": True}, "camera_model: expected a perspective model, got is_fisheye"),
        ({"k4": 0.01}, r"9\.png: k4: expected 0, .* got 0\.01"),
        ({"w": 480}, "with the aspect ratio of"),
        ({"camera_model": "OPENCV_FISHEYE"}, "perspective"),
    ],
)
def test_malformed_transforms_and_images_outside_the_folder_are_refused(
    tmp_path: Path, change: dict, message: str
) -> None:
    Image.new("RGB", (320, 240)).save(tmp_path / "secret.png")
    with pytest.raises(CaptureError, match=message):
        read_recording(_write(tmp_path / "a" / "in", **change), tmp_path / "out")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ([1, 2], "frames: expected a list of at least one image, got null"),
        ({"frames": []}, r"frames: expected a list of at least one image, got \[\]"),
        ({"frames": [{"file_path": "a.png"}, 3]}, r"frames\[1\]\.file_path: expected the name of an image, got null"),
        ({"frames": [{"file_path": "a\0.png"}]}, "expected an image within"),
        ({**SETTINGS, "frames": [{"file_path": "a.png"}]}, "a.png: transform_matrix: expected 4 rows of 4 .* got null"),
    ],
)
def test_a_message_about_transforms_says_what_was_expected_where(tmp_path: Path, content: object, message: str) -> None:
    Image.new("RGB", (320, 240)).save(tmp_path / "a.png")
    (tmp_path / "transforms.json").write_text(json.dumps(content))
    with pytest.raises(CaptureError, match=message) as error:
        read_recording(tmp_path, tmp_path / "out")
    assert "Error(" not in str(error.value)


@pytest.mark.parametrize(
    ("names", "files"),
    [
        (["images\\9.png", ".\\images\\10.png"], None),
        (["images/9", "./images/10", "images/11"], None),
        (["images/9", "images/10.png", "images/11.Png"], ["9.PNG", "10.PNG", "11.png"]),
        (["images/f.9", "images/f.10", "images/f.11"], ["f.9.png", "f.10.jpg", "f.11.PNG"]),
    ],
)
def test_images_are_found_by_names_of_windows_and_without_or_with_another_suffix(
    tmp_path: Path, names: list[str], files: list[str] | None
) -> None:
    source = _write(tmp_path / "in", names=names[::-1] if len(names) == 3 else [f"images/{11}.png", *names[::-1]])
    for number, file in zip((9, 10, 11), files or [], strict=False):
        (source / "images" / f"{number}.png").rename(source / "images" / file)
    photos = read_recording(source, tmp_path / "out")
    assert [path.name for path in photos.paths] == (files or ["9.png", "10.png", "11.png"])
    torch.testing.assert_close(photos.camera_to_world, torch.from_numpy(walk(3)))


def test_transforms_without_an_image_size_take_it_from_the_first_image(tmp_path: Path) -> None:
    bare: dict[str, object] = dict.fromkeys([*SETTINGS, "camera_angle_x"])
    source = _write(tmp_path / "in", **bare | {"camera_angle_x": 2 * np.arctan(160 / 260)})
    photos = read_recording(source, tmp_path / "out")
    torch.testing.assert_close(photos.K, torch.tensor([[260, 0, 160], [0, 260, 120], [0, 0, 1]]).double())


def test_the_transforms_for_training_are_read_where_a_folder_has_no_others(tmp_path: Path) -> None:
    source = _write(tmp_path / "in")
    (source / "transforms.json").rename(source / "transforms_train.json")
    (source / "transforms_test.json").write_text("{}")
    assert is_recording(source) and len(read_recording(source, tmp_path / "out").paths) == 3
    (source / "transforms.json").write_text("{}")
    with pytest.raises(CaptureError, match=r"transforms\.json: frames: expected a list"):
        read_recording(source, tmp_path / "out")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (np.diag([1.0, 1, np.nan, 1]), "numbers that are not finite"),
        (np.diag([2.0, 2, 2, 1]), r"axes of length 2: is it scaled\?"),
        (np.diag([-1.0, 1, 1, 1]), "a reflection: its axes are left-handed"),
        (np.eye(4) + 0.1 * np.eye(4, k=1), "axes of lengths .*, or that are not perpendicular"),
    ],
)
def test_the_first_image_with_a_bad_pose_is_named(tmp_path: Path, change: np.ndarray, message: str) -> None:
    source = _write(tmp_path / "in")
    data = json.loads((source / "transforms.json").read_text())
    for frame in data["frames"][:2]:  # of images 11 and 10
        frame["transform_matrix"] = (change @ np.array(frame["transform_matrix"])).tolist()
    (source / "transforms.json").write_text(json.dumps(data))
    expected = rf"transforms\.json: \./images/10\.png: expected a pose of a rotation .*, got {message}"
    with pytest.raises(CaptureError, match=expected):
        read_recording(source, tmp_path / "out")


@pytest.mark.parametrize("photos", [0, 3])
def test_a_folder_without_a_recording_is_refused(photos: int, tmp_path: Path) -> None:
    for number in range(photos):
        Image.fromarray(room_image(walk(3)[number])).save(tmp_path / f"{number}.png")
    assert not is_recording(tmp_path)
    with pytest.raises(CaptureError, match="found none of them"):
        read_recording(tmp_path, tmp_path / "out")


CAMERAS = {
    "SIMPLE_PINHOLE": [260, 163, 118],
    "PINHOLE": [260, 259, 163, 118],
    "SIMPLE_RADIAL": [260, 163, 118, -0.1],
    "RADIAL": [260, 163, 118, -0.1, 0.02],
    "OPENCV": [260, 259, 163, 118, -0.1, 0.02, 0.001, -0.002],
}
"""Parameters of each COLMAP camera model that the reader supports."""


def _model(source: Path, camera: str, text: bool, numbers: Sequence[int] = range(3), name: str = "0") -> Path:
    """Write a COLMAP model of some images of a walk with COLMAP's own writer."""
    pycolmap = pytest.importorskip("pycolmap")
    (source / "images").mkdir(parents=True, exist_ok=True)
    (source / "sparse" / name).mkdir(parents=True)
    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(
        pycolmap.Camera(camera_id=7, model=camera, width=320, height=240, params=CAMERAS[camera])
    )
    for number in numbers:
        pose = walk(number + 1)[number]
        Image.fromarray(room_image(pose)).save(source / "images" / f"{number} a.png")
        points = np.ones((number, 2))
        image = pycolmap.Image(name=f"{number} a.png", keypoints=points, camera_id=7, image_id=number + 1)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(np.linalg.inv(pose)[:3]))
    (model.write_text if text else model.write)(source / "sparse" / name)
    return source


@pytest.mark.parametrize("text", [False, True])
def test_the_poses_and_intrinsics_of_a_colmap_model_are_read(text: bool, tmp_path: Path) -> None:
    photos = read_recording(_model(tmp_path / "in", "PINHOLE", text), tmp_path / "out")
    torch.testing.assert_close(photos.camera_to_world, torch.from_numpy(walk(3)))
    torch.testing.assert_close(photos.K, torch.tensor([[260.0, 0, 163], [0, 259, 118], [0, 0, 1]]).double())


def test_a_colmap_model_in_text_with_line_ends_of_windows_is_read(tmp_path: Path) -> None:
    source = _model(tmp_path / "in", "PINHOLE", True)
    for file in (source / "sparse" / "0").glob("*.txt"):
        file.write_bytes(file.read_bytes().replace(b"\n", b"\r\n"))
    photos = read_recording(source, tmp_path / "out")
    torch.testing.assert_close(photos.camera_to_world, torch.from_numpy(walk(3)))


def test_the_colmap_model_with_the_most_images_is_refused_if_it_is_broken_and_no_smaller_one_takes_its_place(
    tmp_path: Path,
) -> None:
    for name, numbers in (("0", [0]), ("1", [1, 2, 3])):
        source = _model(tmp_path / "in", "PINHOLE", True, numbers, name)
    broken = source / "sparse" / "1" / "images.txt"
    broken.write_text(broken.read_text().rstrip() + "\n1 one 0 0 0 0 0 0 1 a.png\n")
    with pytest.raises(CaptureError, match=r"sparse.1.images\.txt: expected a COLMAP model"):
        read_recording(source, tmp_path / "out")


@pytest.mark.parametrize("text", [False, True])
def test_of_several_colmap_models_the_one_with_the_most_images_is_read(text: bool, tmp_path: Path) -> None:
    for name, numbers in (("0", [0]), ("1", [1, 2, 3]), ("2", [4, 5])):
        source = _model(tmp_path / "in", "PINHOLE", text, numbers, name)
    (source / "sparse" / "3").mkdir()
    (source / "sparse" / "3" / "cameras.bin").write_bytes(b"broken")
    photos = read_recording(source, tmp_path / "out")
    torch.testing.assert_close(photos.camera_to_world, torch.from_numpy(walk(4)[1:]))
    assert photos.remarks == (
        "COLMAP joined the images into 4 models: sparse/1, with the most images (3), is used, and not sparse/0 (1), "
        "sparse/2 (2), sparse/3 (0).",
        f"3 of the 6 images in {source / 'images'} have no pose, and are not used.",
    )


def test_images_beside_those_that_transforms_name_are_counted(tmp_path: Path) -> None:
    source = _write(tmp_path / "in")
    assert read_recording(source, tmp_path / "out").remarks == ()
    for name in ("12.JPG", "._12.jpg", "notes.txt"):
        (source / "images" / name).touch()
    remark = f"1 of the 4 images in {source / 'images'} have no pose, and are not used."
    assert read_recording(source, tmp_path / "out").remarks == (remark,)


@pytest.mark.parametrize("points", [["1 1e-05 -1 2.5 3 17", "", "0.5 1 -1"], [""] * 4, []])
def test_a_colmap_model_in_text_may_lack_the_lines_with_points(points: list[str], tmp_path: Path) -> None:
    source = _model(tmp_path / "in", "PINHOLE", True, range(4))
    file = source / "sparse" / "0" / "images.txt"
    images = [line for line in file.read_text().split("\n") if line.endswith(".png")]
    lines = [line for pair in itertools.zip_longest(images, points) for line in pair if line is not None]
    file.write_text("\n".join(lines))
    assert [shot.name for shot in colmap.read(source).shots] == [f"{number} a.png" for number in range(4)]
    file.write_text("\n".join([*lines, "5 1 0 0"]))
    with pytest.raises(CaptureError, match=r"images\.txt: .*'5 1 0 0': expected an id, a pose of 7 numbers"):
        colmap.read(source)


@pytest.mark.parametrize("text", [False, True])
@pytest.mark.parametrize("camera", CAMERAS)
def test_every_supported_colmap_camera_model_is_read(camera: str, text: bool, tmp_path: Path) -> None:
    source = _model(tmp_path, camera, text)
    (lens,) = {shot.lens for shot in colmap.read(source).shots}
    fx, cx, cy, *others = CAMERAS[camera]
    fy = fx
    if camera in ("PINHOLE", "OPENCV"):
        fy, cx, cy, *others = cx, cy, *others
    k = [*others, 0, 0, 0, 0][:4]
    assert (lens.fx, lens.fy, lens.cx, lens.cy) == (fx, fy, cx, cy)
    assert (lens.width, lens.height, lens.distortion) == (320, 240, (*k, 0))


def test_points_may_take_most_of_a_large_colmap_model(tmp_path: Path) -> None:
    source, points = _model(tmp_path, "PINHOLE", False), 2**22
    image = struct.pack("<I7dI", 1, 1.0, *[0.0] * 6, 7) + b"0 a.png\0" + struct.pack("<Q", points)
    with (source / "sparse" / "0" / "images.bin").open("wb") as file:
        file.write(struct.pack("<Q", 1) + image)
        file.truncate(file.tell() + 24 * points)  # 96 MiB of nothing, which take no room on the disk
    assert [shot.name for shot in colmap.read(source).shots] == ["0 a.png"]


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("cameras.bin", b"\xff" * 8, "expected a COLMAP model"),
        ("cameras.bin", struct.pack("<QIiQQ4d", 1, 7, 5, 320, 240, 1, 1, 1, 1), "expected a camera model among"),
        (
            "cameras.bin",
            struct.pack("<QIiQQ4d", 1, 6, 1, 320, 240, 1, 1, 1, 1),
            "expected camera ids that are in cameras.bin, got 7",
        ),
        ("images.bin", struct.pack("<QI7dI", 1, 1, 1, *[0] * 6, 7) + b"0 a.png\0\0\0\0\0\0\0\0\x7f", "too early"),
        (
            "images.bin",
            struct.pack("<QI7dI", 1, 1, *[0] * 7, 7) + b"0 a.png\0" + bytes(8),
            "a.png: .* non-zero",
        ),
        (
            "images.bin",
            struct.pack("<QI7dI", 1, 1, 1, *[0] * 6, 7) + b"a" * 9000 + b"\0",
            "name of image 1 does not end",
        ),
        ("images.bin", struct.pack("<Q", 2**40), "at most 100,000 entries, got 1,099,511,627,776"),
        ("images.bin", b"", "expected a COLMAP model: it is empty"),
        (
            "images.bin",
            struct.pack("<Q", 2) + 2 * (struct.pack("<I7dI", 1, 1, *[0] * 6, 7) + b"0 a.png\0" + bytes(8)),
            "expected each image once, got '0 a.png' twice",
        ),
        ("images.bin", bytes(8), r"images\.bin: expected at least one image, got none"),
        ("images.bin", struct.pack("<QI7dI", 1, 1, 1, *[0] * 6, 7) + b"../../b.png\0" + bytes(8), "within|none"),
    ],
)
def test_a_damaged_colmap_model_is_refused(tmp_path: Path, name: str, content: bytes, message: str) -> None:
    source = _model(tmp_path / "in", "PINHOLE", False)
    Image.new("RGB", (320, 240)).save(tmp_path / "b.png")
    (source / "sparse" / "0" / name).write_bytes(content)
    with pytest.raises(CaptureError, match=message) as error:
        colmap.read(source)
    assert str(source) in str(error.value)
