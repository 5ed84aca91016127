"""Recordings of phones with a depth sensor: axes, units, one camera for all images, and refused files."""

import json
import sys
import tracemalloc
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image, ImageFilter

from splatrl.capture.base import CaptureError, Photos
from splatrl.capture.depth_points import with_measured_points
from splatrl.capture.fitting.fit import FitSettings
from splatrl.capture.lens import Lens
from splatrl.capture.pipeline import capture
from splatrl.capture.poses import find_poses
from splatrl.capture.recordings import is_recording, read_recording, record3d
from splatrl.capture.recordings.keeping import one_camera
from splatrl.capture.recordings.turning import quarter_turns
from splatrl.capture.settings import CaptureSettings
from splatrl.capture.world import place
from splatrl.scenes.description import read_description
from tests.capture.ray_cast import HALF, HEIGHT, WIDTH, room_depth, walk
from tests.capture.recorded import (
    ARKIT_FROM_ROOM,
    KINDS,
    SENSOR,
    Taken,
    as_seen,
    taken,
    write_nerfstudio,
    write_polycam,
    write_r3d,
    write_record3d,
    write_stray,
)

pytest.importorskip("imagecodecs")


def _depth_error(photos: Photos, number: int, world_from_room: np.ndarray) -> np.ndarray:
    """Return the relative errors of the depth where it is known."""
    assert photos.K is not None and photos.camera_to_world is not None
    depth = np.asarray(Image.open(photos.depths[number]))
    assert depth.dtype == np.uint16
    size = depth.shape[1], depth.shape[0]
    pose = np.linalg.inv(world_from_room) @ photos.camera_to_world[number].numpy()
    K = np.diag([size[0] / photos.width, size[1] / photos.height, 1]) @ photos.K.numpy()
    return np.abs(depth / (1000 * room_depth(pose, K, size)) - 1)[depth > 0]


@pytest.fixture(scope="module")
def images() -> list[Taken]:
    return taken(8)


@pytest.mark.parametrize("kind", KINDS)
def test_a_recording_becomes_images_of_one_upright_camera_with_metric_poses_and_depth(
    tmp_path: Path, images: list[Taken], kind: str
) -> None:
    source = KINDS[kind](tmp_path / "in", images)
    assert is_recording(source)
    photos = read_recording(source, tmp_path / "out")
    assert (len(photos.paths), photos.width, photos.height, photos.metric) == (8, HEIGHT, WIDTH, True)
    assert photos.up is not None and photos.up.tolist() == [0.0, 1.0, 0.0]
    assert len(photos.depths) == 8 and Image.open(photos.depths[0]).size == SENSOR[::-1]
    for number in (0, 3, 7):
        off, moved = as_seen(photos, number, ARKIT_FROM_ROOM)
        assert off < 8 and off < 0.7 * moved
        error = _depth_error(photos, number, ARKIT_FROM_ROOM)
        assert len(error) > 0.97 * SENSOR[0] * SENSOR[1] and np.median(error) < 0.006 and error.max() < 0.05
    assert photos.seconds[0] == 0 and photos.seconds[7] == pytest.approx(7 if kind == "polycam" else 0.7)


def test_nerfstudio_images_with_a_camera_each_become_images_of_one_camera(tmp_path: Path, images: list[Taken]) -> None:
    photos = read_recording(write_nerfstudio(tmp_path / "in", images), tmp_path / "out")
    assert photos.metric and photos.up is not None and photos.up.tolist() == [0.0, 0.0, 1.0]
    off, moved = as_seen(photos, 5, np.eye(4))
    assert off < 4 and off < 0.6 * moved
    assert np.median(_depth_error(photos, 5, np.eye(4))) < 0.006


def test_depth_that_colmap_estimated_is_not_taken_for_metres(tmp_path: Path, images: list[Taken]) -> None:
    source = write_nerfstudio(tmp_path / "in", images)
    data = json.loads((source / "transforms.json").read_text())
    for number, frame in enumerate(data["frames"]):
        frame["colmap_im_id"] = number
    (source / "transforms.json").write_text(json.dumps(data))
    photos = read_recording(source, tmp_path / "out")
    assert not photos.metric and photos.depths == ()


def test_colmap_images_with_a_camera_each_become_images_of_one_camera(tmp_path: Path, images: list[Taken]) -> None:
    pycolmap = pytest.importorskip("pycolmap")
    source = tmp_path / "in"
    (source / "images").mkdir(parents=True)
    (source / "sparse").mkdir()
    model = pycolmap.Reconstruction()
    for number, one in enumerate(images):
        Image.fromarray(one.image).save(source / "images" / f"{number}.png")
        params = [one.K[0, 0], one.K[1, 1], one.K[0, 2], one.K[1, 2]]
        model.add_camera_with_trivial_rig(
            pycolmap.Camera(camera_id=number + 1, model="PINHOLE", width=WIDTH, height=HEIGHT, params=params)
        )
        pose = pycolmap.Rigid3d(np.linalg.inv(one.pose)[:3])
        image = pycolmap.Image(
            name=f"{number}.png", keypoints=np.zeros((0, 2)), camera_id=number + 1, image_id=number + 1
        )
        model.add_image_with_trivial_frame(image, pose)
    model.write(source / "sparse")
    photos = read_recording(source, tmp_path / "out")
    assert (photos.width, photos.metric, photos.up) == (WIDTH, False, None), "nothing tells that it lies on its side"
    off, moved = as_seen(photos, 5, np.eye(4))
    assert off < 4 and off < 0.6 * moved


def test_the_sharpest_image_of_each_interval_is_chosen_and_cached(tmp_path: Path) -> None:
    images, sharp = taken(18), [1, 3, 8, 10, 14, 15]
    for number, one in enumerate(images):
        if number not in sharp:
            one.image[:] = Image.fromarray(one.image).filter(ImageFilter.GaussianBlur(3))
    source = write_record3d(tmp_path / "in", images)
    photos = read_recording(source, tmp_path / "out", count=(6, 6))
    assert [round(10 * seconds) for seconds in photos.seconds.tolist()] == sharp
    expected = torch.from_numpy(np.array([images[number].arkit[:3, 3] for number in sharp]))
    assert photos.camera_to_world is not None
    torch.testing.assert_close(photos.camera_to_world[:, :3, 3], expected)
    stamp = photos.paths[0].stat().st_mtime_ns
    told: list[str] = []
    again = read_recording(source, tmp_path / "out", (6, 6), progress=lambda what, *_: told.append(what))
    assert again.paths[0].stat().st_mtime_ns == stamp and not told
    assert again.camera_to_world is not None and torch.equal(again.camera_to_world, photos.camera_to_world)
    assert len(read_recording(source, tmp_path / "out", (6, 6), longest=80).paths) == 6
    assert Image.open(photos.paths[0]).size == (60, 80)


@pytest.mark.parametrize("kind", ["polycam", "stray", "record3d", "nerfstudio"])
def test_depth_and_confidence_that_have_changed_are_read_again(tmp_path: Path, kind: str) -> None:
    write = {**KINDS, "nerfstudio": write_nerfstudio}[kind]
    images = taken(2, steady=True)

    def kept(name: str, **changes: np.ndarray) -> np.ndarray:
        source = write(tmp_path / name, [replace(one, **changes) for one in images])
        return np.asarray(Image.open(read_recording(source, tmp_path / "out").depths[1]))

    far = np.full(images[0].depth.shape, 4000, np.uint16)
    assert kept("first").max() < 4000 and set(np.unique(kept("corrected", depth=far))) <= {0, 4000}
    if kind != "nerfstudio":  # its depth has no confidence
        assert not kept("untrusted", depth=far, confidence=np.zeros(far.shape, np.uint8)).any()


@pytest.mark.parametrize("kind", ["polycam", "stray", "record3d"])
def test_hidden_files_as_macos_writes_beside_others_do_not_count(tmp_path: Path, kind: str) -> None:
    source = KINDS[kind](tmp_path / "in", taken(2, steady=True))
    kept = read_recording(source, tmp_path / "out").paths
    for file in [file for file in source.rglob("*") if file.is_file()]:
        file.with_name(f"._{file.name}").write_bytes(b"\x00\x05\x16\x07")
    told: list[str] = []
    again = read_recording(source, tmp_path / "out", progress=lambda what, *_: told.append(what))
    assert again.paths == kept and not told


def test_a_failed_read_leaves_no_files(tmp_path: Path, images: list[Taken]) -> None:
    source = write_polycam(tmp_path / "in", images)
    next((source / "keyframes" / "depth").glob("*.png")).write_bytes(b"\x89PNG")
    with pytest.raises(CaptureError, match=r"depth.*expected a complete PNG"):
        read_recording(source, tmp_path / "out")
    assert list((tmp_path / "out").iterdir()) == []


def test_the_common_camera_sees_only_what_every_image_shows() -> None:
    lenses = [
        Lens(320, 240, 260, 260, 160, 120),
        Lens(320, 240, 263, 262, 156, 121),
        Lens(320, 240, 261, 260, 163, 118),
    ]
    camera, boxes = one_camera("here", lenses)
    assert camera.fx / camera.fy == pytest.approx(261 / 260) and (camera.cx, camera.cy) == (160, 120)
    assert (boxes[:, :2] >= 0).all() and (boxes[:, 2:] <= [320, 240]).all()
    assert min(boxes[:, :2].min(), (np.array([320, 240]) - boxes[:, 2:]).min()) == pytest.approx(0, abs=1e-9)
    for lens, (left, upper, right, lower) in zip(lenses, boxes, strict=True):  # the same ray in both cameras
        x, y = (50 - camera.cx) / camera.fx, (200 - camera.cy) / camera.fy
        assert lens.fx * x + lens.cx == pytest.approx(left + 50 / 320 * (right - left))
        assert lens.fy * y + lens.cy == pytest.approx(upper + 200 / 240 * (lower - upper))
    _, boxes = one_camera("here", lenses, border=10)
    assert (boxes[:, :2] >= 10 - 1e-9).all() and (boxes[:, 2:] <= [310 + 1e-9, 230 + 1e-9]).all()
    same, boxes = one_camera("here", lenses[:1] * 3)
    assert same == lenses[0] and (boxes == [0, 0, 320, 240]).all()


@pytest.mark.parametrize(
    ("other", "message"),
    [
        (Lens(240, 320, 260, 260, 120, 160), "expected images of one size and one camera, got 240 × 320 and 320 × 240"),
        (
            Lens(320, 240, 260, 260, 160, 120, (50.0, 0, 0, 0, 0)),
            "expected lens distortion that leaves at least a third",
        ),
        (
            Lens(320, 240, 260, 260, 160, 120, (-50.0, 0, 0, 0, 0)),  # folds the image at its middle
            "expected lens distortion that leaves at least a third",
        ),
        (Lens(320, 240, 130, 130, 160, 120), "expected one camera, got focal lengths from 130 to 260 pixels"),
        (Lens(320, 240, 260, 260, 210, 120), "a principal point that moves by 16 % of the width"),
    ],
)
def test_images_of_different_cameras_are_refused(other: Lens, message: str) -> None:
    with pytest.raises(CaptureError, match=f"here: .*{message}"):
        one_camera("here", [Lens(320, 240, 260, 260, 160, 120), other])


def test_intrinsics_of_another_image_size_are_refused() -> None:
    with pytest.raises(CaptureError, match=r"near the middle of 640 × 480 pixels, got \(960, 720\)"):
        one_camera("here", [Lens(640, 480, 1600, 1600, 960, 720)])


@pytest.mark.parametrize(("turns", "right"), [(0, (1, 0, 0)), (1, (0, 0, 1)), (2, (-1, 0, 0)), (3, (0, 0, -1))])
def test_images_are_turned_upright(turns: int, right: tuple[int, int, int]) -> None:
    pose = np.eye(4)
    forward = np.array([0.0, 1.0, 0.0])
    pose[:3, :3] = np.stack([right, np.cross(forward, right), forward], 1)
    assert quarter_turns(np.stack([pose] * 2), np.array([0.0, 0.0, 1.0])) == turns


def test_polycams_corrected_images_are_preferred_and_lose_their_black_border(
    tmp_path: Path, images: list[Taken]
) -> None:
    plain = [replace(one, image=np.zeros_like(one.image)) for one in images]
    images = [replace(one, image=one.image.copy()) for one in images]
    for one in images:
        one.image[:2] = one.image[-2:] = 0
    source = write_polycam(tmp_path / "in", plain)
    write_polycam(source / "corrected", images, corrected=True)
    for name in ("corrected_images", "corrected_cameras"):
        (source / "corrected" / "keyframes" / name).rename(source / "keyframes" / name)
    photos = read_recording(source, tmp_path / "out")
    shown = np.asarray(Image.open(photos.paths[2])).astype(float)
    assert min(shown[:, 0].mean(), shown[:, -1].mean(), shown[0].mean()) > 60
    off, moved = as_seen(photos, 2, ARKIT_FROM_ROOM)
    assert off < 0.7 * moved and np.median(_depth_error(photos, 2, ARKIT_FROM_ROOM)) < 0.006


def test_stray_scanner_frames_without_intrinsics_use_those_of_the_recording(tmp_path: Path) -> None:
    source = write_stray(tmp_path / "in", taken(3, steady=True))
    rows = [",".join(row.split(",")[:9]) for row in (source / "odometry.csv").read_text().splitlines()]
    (source / "odometry.csv").write_text("\n".join(rows))
    (source / "camera_matrix.csv").write_text("260.0, 0.0, 163.0\n0.0, 260.0, 118.0\n0.0, 0.0, 1.0")
    photos = read_recording(source, tmp_path / "out")
    expected = torch.tensor([[260, 0, 118], [0, 260, 320 - 163], [0, 0, 1]]).double()
    torch.testing.assert_close(photos.K, expected)
    (source / "camera_matrix.csv").write_text("250.0, 0.0, 163.0\n0.0, 250.0, 118.0\n0.0, 0.0, 1.0")
    corrected = read_recording(source, tmp_path / "out").K
    assert corrected is not None and corrected[0, 0] == 250


def test_record3d_poses_relative_to_the_first_camera_have_up_only_with_an_initial_pose(
    tmp_path: Path, images: list[Taken]
) -> None:
    first = np.linalg.inv(images[0].arkit @ np.diag([1, -1, -1, 1]))
    poses = [first @ one.arkit @ np.diag([1, -1, -1, 1]) for one in images]

    def written(pose: np.ndarray) -> list[float]:
        from scipy.spatial.transform import Rotation

        return [*Rotation.from_matrix(pose[:3, :3]).as_quat().tolist(), *pose[:3, 3].tolist()]

    relative = [written(pose) for pose in poses]
    source = write_record3d(tmp_path / "a", images, poses=relative)
    photos = read_recording(source, tmp_path / "out")
    assert photos.up is None and photos.metric and (photos.width, photos.height) == (WIDTH, HEIGHT)
    source = write_record3d(tmp_path / "b", images, poses=relative, initPose=written(np.linalg.inv(first)))
    photos = read_recording(source, tmp_path / "out")
    assert photos.up is not None and as_seen(photos, 4, ARKIT_FROM_ROOM)[0] < 4


def test_older_record3d_files_without_times_and_intrinsics_per_frame_are_read(tmp_path: Path) -> None:
    images = taken(3, steady=True)
    source = write_record3d(tmp_path / "in", images, perFrameIntrinsicCoeffs=None, frameTimestamps=None)
    photos = read_recording(source, tmp_path / "out")
    expected = torch.tensor([[260, 0, 118], [0, 260, 320 - 163], [0, 0, 1]]).double()
    torch.testing.assert_close(photos.K, expected)
    assert photos.seconds.tolist() == pytest.approx([0, 0.1, 0.2])


def test_the_largest_number_in_a_depth_image_means_no_depth(tmp_path: Path, images: list[Taken]) -> None:
    source = write_nerfstudio(tmp_path / "in", images)
    path = source / "depth" / "frame_00003.png"
    depth = np.array(Image.open(path))
    depth[:120] = 65_535
    Image.fromarray(depth).save(path)
    kept = np.asarray(Image.open(read_recording(source, tmp_path / "out").depths[3]))
    assert kept.max() < 5000 and 0.4 < (kept == 0).mean() < 0.6


def test_entries_of_an_archive_write_no_files_outside_the_output_folder(tmp_path: Path, images: list[Taken]) -> None:
    source = write_r3d(tmp_path / "a.r3d", images[:3])
    with zipfile.ZipFile(source, "a") as archive:
        archive.writestr("../../evil.jpg", b"evil")
        archive.writestr("rgbd/../../1.jpg", b"evil")
        archive.writestr("/rgbd/9.jpg", b"evil")
    before = {path for path in tmp_path.rglob("*") if "shots" not in path.parts}
    assert len(read_recording(source, tmp_path / "out").paths) == 3
    assert {path for path in tmp_path.rglob("*") if "shots" not in path.parts} == before | {tmp_path / "out"}


def test_depth_that_unpacks_to_more_than_expected_is_not_unpacked(tmp_path: Path, images: list[Taken]) -> None:
    import imagecodecs

    source = write_record3d(tmp_path / "in", images)
    (source / "rgbd" / "2.depth").write_bytes(imagecodecs.lzfse_encode(bytes(1 << 23)))
    files = record3d.Files(source)
    tracemalloc.start()
    with pytest.raises(CaptureError, match=r"rgbd/2\.depth: expected 12,288 unpacked bytes, got more"):
        record3d.read_depth_of(files, "rgbd/2.depth", None, SENSOR[::-1])
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1 << 20
    with pytest.raises(CaptureError, match=r"rgbd/2\.depth: expected 12,288 unpacked bytes, got more"):
        read_recording(source, tmp_path / "out")


def test_an_entry_that_unpacks_to_more_than_is_allowed_is_not_unpacked(
    tmp_path: Path, images: list[Taken], monkeypatch: pytest.MonkeyPatch
) -> None:
    source = write_r3d(tmp_path / "a.r3d", images[:3])
    monkeypatch.setattr(record3d, "MAX_BYTES", 100)
    with pytest.raises(CaptureError, match=r"a\.r3d: metadata: could not be read: expected at most 100 bytes, got \d+"):
        read_recording(source, tmp_path / "out")


def test_the_error_without_the_package_that_unpacks_depth_says_how_to_install_it(
    tmp_path: Path, images: list[Taken], monkeypatch: pytest.MonkeyPatch
) -> None:
    source = write_record3d(tmp_path / "in", images)
    monkeypatch.setitem(sys.modules, "imagecodecs", None)
    with pytest.raises(ImportError, match=r"imagecodecs is missing: pip install 'splatrl\[capture\]'"):
        read_recording(source, tmp_path / "out")


def _broken_polycam(folder: Path, images: list[Taken]) -> Path:
    source = write_polycam(folder, images)
    next((source / "keyframes" / "cameras").iterdir()).write_text('{"fx": 1}')
    return source


def _polycam_without_cameras(folder: Path, images: list[Taken]) -> Path:
    source = write_polycam(folder, images)
    for file in (source / "keyframes" / "cameras").iterdir():
        file.unlink()
    return source


def _stray(folder: Path, images: list[Taken], file: str, content: str) -> Path:
    source = write_stray(folder, images)
    (source / file).write_text(content)
    return source


def _small_confidence(folder: Path, images: list[Taken]) -> Path:
    source = write_stray(folder, images)
    Image.new("L", (8, 6)).save(source / "confidence" / "000001.png")
    return source


def _another_sensor(folder: Path, images: list[Taken]) -> Path:
    source = write_polycam(folder, images)
    some = sorted((source / "keyframes" / "depth").iterdir())[4]
    Image.fromarray(np.ones((6, 8), np.uint16)).save(some)
    (source / "keyframes" / "confidence" / some.name).unlink()
    return source


def _archive(folder: Path, content: bytes) -> Path:
    folder.with_suffix(".r3d").write_bytes(content)
    return folder.with_suffix(".r3d")


HEADER = "timestamp, frame, x, y, z, qx, qy, qz, qw\n"


@pytest.mark.parametrize(
    ("write", "message"),
    [
        (_broken_polycam, r"\.json: expected a camera file of Polycam"),
        (_polycam_without_cameras, "expected images that each have a camera file of the same name, found none"),
        (lambda f, i: _stray(f, i, "odometry.csv", "x, y\n1, 2\n"), "odometry.csv: expected one row per frame"),
        (lambda f, i: _stray(f, i, "odometry.csv", HEADER), "odometry.csv: expected one row per frame"),
        (lambda f, i: _stray(f, i, "odometry.csv", HEADER + "1, 0, 0, 0, 0, 0, 0, 0"), "row 2: qw: expected a finite"),
        (
            lambda f, i: _stray(f, i, "odometry.csv", HEADER + "1, 0, 0, 0, nan, 0, 0, 0, 1"),
            "row 2: z: expected a finite",
        ),
        (lambda f, i: _stray(f, i, "odometry.csv", HEADER + "1, 0, 0, 0, 0, 0, 0, 0, 0"), "frame 0: .* non-zero"),
        (lambda f, i: _stray(f, i, "odometry.csv", HEADER + "1, .5, 0, 0, 0, 0, 0, 0, 1"), "frame: expected ascending"),
        (lambda f, i: _stray(f, i, "camera_matrix.csv", "1, 2\n3, 4"), "expected 3 rows of 3 numbers"),
        (lambda f, i: _stray(f, i, "rgb.mp4", "no video"), r"rgb\.mp4: expected a complete video"),
        (_another_sensor, r"expected depth images of one size, got \(64, 48\) and \(8, 6\)"),
        (_small_confidence, r"000001\.png: expected depth as large as its confidence"),
        (lambda f, i: _archive(f, b"RED's own"), r"\.r3d: expected a ZIP archive of Record3D"),
        (lambda f, i: write_record3d(f, i, poses=[[0, 0, 0, 1, 0, 0, 0]] * 8), "at different positions"),
        (lambda f, i: write_record3d(f, i, poses=[[0, 0, 0, 1]] * 8), "metadata: expected the metadata of a Record3D"),
        (lambda f, i: write_record3d(f, i, poses=[]), "expected at least one image"),
        (lambda f, i: write_record3d(f, i, w=None), "metadata: expected the metadata of a Record3D"),
        (lambda f, i: write_record3d(f, i, w=200), "expected"),
        (lambda f, i: write_record3d(f, i, dw=10**9), "dh, dw: expected the height and width"),
        (lambda f, i: write_record3d(f, i, dw=10), "expected 1,920 unpacked bytes, got more"),
        (lambda f, i: write_record3d(f, i, dw=100), "expected 19,200 unpacked bytes, got 12,288"),
        (lambda f, i: write_record3d(f, i, perFrameIntrinsicCoeffs=[[0, 0, 0, 0]] * 8), "finite intrinsics"),
    ],
)
def test_malformed_recordings_are_refused_in_one_line(
    tmp_path: Path, images: list[Taken], write: object, message: str
) -> None:
    source = write(tmp_path / "in", images)  # type: ignore[operator]
    with pytest.raises(CaptureError, match=message) as refused:
        read_recording(source, tmp_path / "out")
    assert "\n" not in str(refused.value)


def test_a_textureless_room_still_gets_points_and_a_floor_from_its_depth(tmp_path: Path, images: list[Taken]) -> None:
    for package in ("cv2", "pycolmap"):
        pytest.importorskip(package)
    bare = [replace(one, image=np.full_like(one.image, 90 + number)) for number, one in enumerate(images)]
    photos = read_recording(write_polycam(tmp_path / "in", bare), tmp_path / "out")
    triangulated = find_poses(photos, tmp_path / "out")
    assert len(triangulated.points) == 0
    found = with_measured_points(triangulated)
    places = np.concatenate([found.points.numpy(), np.ones((len(found.points), 1))], 1)
    off = (np.abs((places @ np.linalg.inv(ARKIT_FROM_ROOM).T)[:, :3]) - HALF).max(1)
    assert len(off) > 480 and np.abs(off).max() < 0.1 and np.median(np.abs(off)) < 0.02
    assert found.seen_point.tolist() == list(range(len(off))) and sorted(set(found.seen_by.tolist())) == list(range(8))
    shown = torch.from_numpy(np.arange(8) + 90)[found.seen_by]
    assert (found.colors.int() - shown[:, None]).abs().max() <= 1
    placed = place(found, photos.up, photos.metric, marker=None)
    height = float(np.median([pose[2, 3] for pose in walk(8)])) + HALF[2]
    assert placed.camera_height == pytest.approx(height, abs=0.05)
    without = replace(triangulated, depths=())
    assert with_measured_points(without) is without


@pytest.mark.parametrize("name", ["../secret.png", "/etc/passwd"])
def test_depth_files_that_are_outside_the_recording_are_refused(tmp_path: Path, images: list[Taken], name: str) -> None:
    Image.new("L", (8, 6)).save(tmp_path / "secret.png")
    source = write_nerfstudio(tmp_path / "in", images)
    data = json.loads((source / "transforms.json").read_text())
    data["frames"][3]["depth_file_path"] = name
    (source / "transforms.json").write_text(json.dumps(data))
    with pytest.raises(CaptureError, match="expected an image"):
        read_recording(source, tmp_path / "out")


@pytest.mark.usefixtures("bare_report")
def test_a_recording_becomes_a_scene_that_stands_upright_in_metres(tmp_path: Path, images: list[Taken]) -> None:
    for package in ("cv2", "pycolmap"):
        pytest.importorskip(package)
    said: list[str] = []
    settings = CaptureSettings(fit=FitSettings(width=64, cap=1500, views=30))
    capture(write_r3d(tmp_path / "in.r3d", images[:5]), tmp_path / "room", settings, say=said.append)
    assert "5 of 240 × 320 pixels, with poses and depth" in said[0]
    assert "5 of 5 images" in said[1] and "up from recorded, scale from recorded" in said[2]
    stated = read_description(tmp_path / "room")
    height = float(np.median([pose[2, 3] for pose in walk(5)])) + HALF[2]
    assert stated["metric"] and stated["robot_height"] == pytest.approx(height, abs=0.05)
    assert stated["quality"]["scale_from"] == stated["quality"]["up_from"] == "recorded"
