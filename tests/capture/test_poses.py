"""Poses and points that are found from images of a room, compared with the truth."""

import dataclasses
import os
import shutil
import signal
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from splatrl.array_files import read_arrays
from splatrl.capture import poses as poses_module
from splatrl.capture.base import CaptureError
from splatrl.capture.carrying import weakest
from splatrl.capture.child import _pass_on, run_child
from splatrl.capture.pipeline import reconstruct
from splatrl.capture.poses import find_poses, job_of, missing_runs
from splatrl.capture.settings import CaptureSettings
from splatrl.capture.sfm import mapping
from splatrl.capture.sfm.job import Job, write_job
from splatrl.capture.sfm.mapping import SHARED, find_cameras
from splatrl.capture.sfm.structure import MODEL, SPARSE, _keep, pairs, run
from tests.capture import ray_cast
from tests.capture.ray_cast import HALF, photos_of, walk

pytest.importorskip("cv2")
pycolmap = pytest.importorskip("pycolmap")

WIDTH, HEIGHT = 160, 120
K = ray_cast.K * [[0.5], [0.5], [1.0]]
"""Intrinsics of images half as wide and high as in other tests, since COLMAP's time grows with their features."""


def room_image(camera_to_world: np.ndarray, seed: int = 0) -> np.ndarray:
    """See ``ray_cast.room_image``."""
    return ray_cast.room_image(camera_to_world, seed, K, (WIDTH, HEIGHT))


def _similar(found: np.ndarray, truth: np.ndarray) -> tuple[float, float]:
    """Return the greatest distance (metres) and angle (radians) of cameras aligned by a similarity (Umeyama 1991)."""
    a, b = found[:, :3, 3] - found[:, :3, 3].mean(0), truth[:, :3, 3] - truth[:, :3, 3].mean(0)
    u, _, vt = np.linalg.svd(np.einsum("nij,nkj->ik", truth[:, :3, :3], found[:, :3, :3]))
    turn = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    a = a @ turn.T
    distance = np.linalg.norm((a * b).sum() / (a * a).sum() * a - b, axis=1).max()
    cosines = (np.einsum("nij,nij->n", turn @ found[:, :3, :3], truth[:, :3, :3]) - 1) / 2
    return float(distance), float(np.arccos(np.clip(cosines, -1, 1)).max())


def test_poses_of_a_walk_are_found_cached_and_reproducible(tmp_path: Path) -> None:
    truth = walk(24)[::4]
    photos = photos_of(tmp_path / "in", [room_image(pose) for pose in truth])
    told: list[str] = []
    found = find_poses(photos, tmp_path / "a", progress=lambda what, *_: told.append(what))
    assert {"extract", "match", "map", "undistort"} <= set(told)
    distance, angle = _similar(found.camera_to_world.numpy(), truth)
    assert distance < 0.02 and angle < 0.01 and found.missing == 0
    assert found.carried is None, "the order of photos may mean nothing"
    assert found.K[0, 0].item() == pytest.approx(K[0, 0], rel=0.03)
    assert len(found.points) > 300 and found.seen_point.max() == len(found.points) - 1
    assert all(path.is_file() and path.parent.name == "undistorted" for path in found.paths)
    told.clear()
    again = find_poses(photos, tmp_path / "a", progress=lambda what, *_: told.append(what))
    assert not told and torch.equal(again.points, found.points)
    anew = find_poses(photos, tmp_path / "b")
    assert torch.equal(anew.camera_to_world, found.camera_to_world) and torch.equal(anew.points, found.points)


def test_known_poses_are_kept_and_points_lie_on_the_walls(tmp_path: Path) -> None:
    truth = walk(24)[::4]
    photos = photos_of(tmp_path / "in", [room_image(pose) for pose in truth])
    known = dataclasses.replace(photos, K=torch.from_numpy(K), camera_to_world=torch.from_numpy(truth), metric=True)
    found = find_poses(known, tmp_path / "out")
    torch.testing.assert_close(found.camera_to_world, torch.from_numpy(truth))
    torch.testing.assert_close(found.K, torch.from_numpy(K))
    assert found.paths == photos.paths
    off = (np.abs(found.points.numpy()) - HALF).max(1)
    assert len(off) > 200 and np.median(np.abs(off)) < 0.02
    # each observed point projects into its image
    world_to_camera = torch.linalg.inv(found.camera_to_world)[found.seen_by]
    local = world_to_camera[:, :3] @ torch.nn.functional.pad(found.points[found.seen_point], (0, 1), value=1)[..., None]
    pixel = (found.K @ local)[..., 0]
    pixel = pixel[:, :2] / pixel[:, 2:]
    assert (local[:, 2] > 0).all() and ((pixel > -1) & (pixel < torch.tensor([WIDTH + 1.0, HEIGHT + 1.0]))).all()


def test_images_without_a_pose_are_named_and_left_out_where_that_is_allowed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    images = [room_image(pose) for pose in walk(24)[::4]] + [room_image(pose, seed=1) for pose in walk(24)[:9:3]]
    photos = photos_of(tmp_path / "in", images, [0.5 * number for number in range(len(images))])
    with pytest.raises(
        CaptureError, match=r"tracking lost: only 6 of 9 images .* Missing: 3\.0 s to 4\.0 s \(3 images\)"
    ):
        find_poses(photos, tmp_path / "out")
    film = find_poses(photos, tmp_path / "out", least=0.5)
    assert film.missing == pytest.approx(3 / 9)
    assert film.carried is not None and len(film.carried) == 6 and weakest(film) is None

    def found_again(_: str, work: Path, *__: object) -> None:
        shutil.copy(tmp_path / "out" / "structure" / MODEL, work)

    monkeypatch.setattr(poses_module, "run_child", found_again)
    for number in reversed(range(len(images))):  # a phone's names, which are not those of the images that are kept
        (tmp_path / "in" / f"{number:04}.png").rename(tmp_path / "in" / f"IMG_{2031 + number}.png")
    said: list[str] = []
    settings = CaptureSettings(camera_height=1.0, marker=None, force=True, still=True)
    placed, _ = reconstruct(tmp_path / "in", tmp_path / "scene", settings, say=said.append)
    assert "missing: IMG_2037.png to IMG_2039.png (3 images)" in "\n".join(said)
    assert placed.reconstruction.missing == pytest.approx(3 / 9), "with force, the capture goes on without them"


def test_a_time_lapse_with_an_image_a_second_has_times(tmp_path: Path) -> None:
    images = [np.zeros((8, 8, 3), np.uint8)] * 3
    assert job_of(photos_of(tmp_path / "film", images, [0.0, 1.0, 2.0])).seconds == [0.0, 1.0, 2.0]
    assert job_of(photos_of(tmp_path / "photos", images)).seconds is None


@pytest.mark.slow
def test_low_contrast_images_are_posed(tmp_path: Path) -> None:
    truth = walk(24)[::2]
    images = [room_image(pose) for pose in truth]
    for number in range(4, 10):  # 3 % of the contrast is left, as in a blurred image of a bare wall
        images[number] = (128 + 0.03 * (images[number].astype(float) - 128)).round().astype(np.uint8)
    found = find_poses(photos_of(tmp_path / "in", images), tmp_path / "out")
    assert found.missing == 0 and _similar(found.camera_to_world.numpy(), truth)[0] < 0.05


@pytest.mark.parametrize("fixed", [pytest.param(False, marks=pytest.mark.slow), True])
def test_global_mapping_poses_images_where_incremental_mapping_finds_no_initial_pair(
    fixed: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    truth = walk(24)[::4]
    photos = photos_of(tmp_path / "in", [room_image(pose) for pose in truth])
    monkeypatch.setattr(pycolmap, "incremental_mapping", lambda *_, **__: {})
    names, guess = [path.name for path in photos.paths], K.copy()
    guess[[0, 1], [0, 1]] *= 1.0 if fixed else 1.2
    models = []
    for name in ("a",) if fixed else ("a", "b"):
        folder = tmp_path / name
        folder.mkdir()
        write_job(folder, Job(str(photos.paths[0].parent), names, photos.width, photos.height, guess.tolist(), fixed))
        run(folder)
        models.append(read_arrays(folder / MODEL))
    assert models[0]["images"].tolist() == list(range(len(truth)))
    distance, angle = _similar(models[0]["camera_to_world"], truth)
    assert distance < 0.02 and angle < 0.01
    assert models[0]["camera"][0] == pytest.approx(K[0, 0], rel=1e-9 if fixed else 0.03)
    assert all(np.array_equal(models[0][key], models[-1][key]) for key in models[0])
    told: list[tuple[object, ...]] = []
    for line in "".join(capfd.readouterr()).splitlines():
        _pass_on(line, lambda *far: told.append(far))
    assert {("map globally", 0, 3), ("map globally", 1, 3)} <= set(told)


def _model(tracks: list[list[int]], count: int) -> SimpleNamespace:
    """Return a fake COLMAP model of images 1 to count, named a, b, …, and a point per list of images that see it."""
    pose = SimpleNamespace(inverse=lambda: SimpleNamespace(matrix=lambda: np.eye(4)[:3]))
    image = {"has_pose": True, "cam_from_world": lambda: pose}
    images = {i: SimpleNamespace(image_id=i, name=chr(96 + i), **image) for i in range(1, count + 1)}
    points = {}
    for number, track in enumerate(tracks):
        elements = [SimpleNamespace(image_id=i) for i in track]
        points[number] = SimpleNamespace(xyz=[number, 0, 0], color=[0] * 3, track=SimpleNamespace(elements=elements))
    lens = {"focal_length_x": 1, "focal_length_y": 1, "principal_point_x": 1, "principal_point_y": 1}
    camera = SimpleNamespace(model=SimpleNamespace(name="PINHOLE"), params=[1] * 4, **lens)
    return SimpleNamespace(images=images, points3D=points, cameras={1: camera})


def test_only_the_largest_set_of_images_that_share_enough_points_is_kept(tmp_path: Path) -> None:
    tracks = [[1, 2]] * SHARED + [[2, 3]] * (SHARED - 1) + [[3, 4, 5]] * SHARED
    model, names = _model(tracks, 5), list("abcde")
    _keep(tmp_path, Job("", names, 8, 6), model)
    kept = read_arrays(tmp_path / MODEL)
    assert kept["images"].tolist() == [2, 3, 4]
    assert kept["points"][:, 0].tolist() == [*range(2 * SHARED - 1, 3 * SHARED - 1)]
    assert kept["seen_by"].tolist() == [0, 1, 2] * SHARED
    _keep(tmp_path, Job("", names, 8, 6, camera_to_world=[np.eye(4).tolist()] * 5), model)
    assert len(read_arrays(tmp_path / MODEL)["images"]) == 5, "known poses need no points to hold together"


@pytest.mark.parametrize(
    ("bent", "other", "taken"), [(1.0, 0.0, 1), (0.0, 0.0, 0), (1.0, 2.0, 0), (0.02, 0.0, 1), (1.0, 0.02, 1)]
)
def test_the_global_map_of_a_bent_film_is_used_where_it_is_less_bent(
    bent: float, other: float, taken: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    count = SPARSE + 8
    seconds = np.arange(count) / 4.0 + np.random.default_rng(0).uniform(0.0, 0.15, count)
    names = [chr(97 + number) for number in range(count)]
    models = []
    for broken in (bent, other):
        places = np.stack([seconds, np.sin(0.5 * seconds), 0 * seconds], 1)
        places[10:] += [0.0, 4.0 * broken, 0.0]
        model = _model([list(range(1, count + 1))] * SHARED, count)
        for number, place in enumerate(places, 1):
            inverse = SimpleNamespace(translation=place)
            model.images[number].cam_from_world = lambda inverse=inverse: SimpleNamespace(inverse=lambda: inverse)
        models.append(model)
    monkeypatch.setattr(mapping, "map_one_by_one", lambda *_: models[0])
    monkeypatch.setattr(mapping, "map_at_once", lambda *_: models[1])
    monkeypatch.setattr(mapping, "fisheye", lambda *_: None)
    job = Job("", names, 8, 6, seconds=seconds.tolist())
    assert find_cameras(None, tmp_path, job) is models[taken]
    photos = dataclasses.replace(job, seconds=None)
    assert find_cameras(None, tmp_path, photos) is models[0]


def test_known_poses_without_intrinsics_are_refused(tmp_path: Path) -> None:
    photos = photos_of(tmp_path / "in", [room_image(walk(1)[0])])
    with pytest.raises(ValueError, match="expected intrinsics"):
        find_poses(dataclasses.replace(photos, camera_to_world=torch.eye(4).double()[None]), tmp_path / "out")


def test_a_missing_package_is_named_with_the_command_that_installs_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pycolmap", None)
    with pytest.raises(ImportError, match=r"pycolmap is missing: pip install 'splatrl\[capture\]'"):
        find_poses(photos_of(tmp_path / "in", [room_image(walk(1)[0])]), tmp_path / "out")


def test_pairs_join_neighbours_distant_images_and_every_tenth_image() -> None:
    assert pairs(4) == [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]
    many = set(pairs(100))
    assert {(0, 8), (7, 23), (7, 39), (0, 90), (10, 50)} <= many
    assert not {(0, 9), (7, 17), (1, 91)} & many


def test_runs_of_images_without_a_pose_are_found() -> None:
    assert missing_runs(np.array([2, 3, 7]), 9) == [(0, 1), (4, 6), (8, 8)]
    assert missing_runs(np.array([2, 3, 7]), 9, most=1) == [(4, 6)]
    assert missing_runs(np.arange(9), 9) == []


def test_an_interrupt_kills_the_child_process_and_a_failure_shows_its_last_lines(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    module = tmp_path / "child_of_a_test.py"
    module.write_text(
        "import os, time\nprint([str(os.getpid()), 0, 1])\nprint(f'[\"{os.getpid()}\", 0, 1]', flush=True)\n"
    )
    with module.open("a") as stream:
        stream.write("import sys\nif 'fail' in sys.argv[1]: sys.exit('no more rays')\ntime.sleep(60)\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    child: list[int] = []

    def interrupt(what: str, done: int, total: int) -> None:
        child.append(int(what))
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(5)

    with pytest.raises(KeyboardInterrupt):
        run_child("child_of_a_test", tmp_path, interrupt)
    if sys.platform != "win32":
        with pytest.raises(ProcessLookupError):
            os.kill(child[0], 0)
    with pytest.raises(CaptureError, match="no more rays"):
        run_child("child_of_a_test", tmp_path / "fail", lambda *_: None)


def test_a_full_disk_is_told_from_other_failures_of_the_child_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "crashing.py").write_text(
        "print('SQLite error: database or disk is full')\nfor _ in range(50): print('@ 0x7f74c90a71f5')\nexit(1)\n"
    )
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    with pytest.raises(OSError, match=r"cannot write: No space left on device: '.*job'$"):
        run_child("crashing", tmp_path / "job", lambda *_: None)
