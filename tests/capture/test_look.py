"""The look at a capture refuses each fault with its own cause and lets good captures pass."""

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
import torch

from splatrl.capture import look as look_module
from splatrl.capture.base import CaptureError, Photos
from splatrl.capture.frames import read_photos
from splatrl.capture.look import Look, _chosen, _pairs, look, summed
from splatrl.capture.matches import SAME_CENTRE, Features, Pair, features, unlike_rotation
from tests.capture.ray_cast import K, photos_of, room_image, turning, walk

pytest.importorskip("cv2")
pytest.importorskip("pycolmap")
GOOD = Look(60, 120.0, 900.0, 0.98, 0.1, 0.2, math.radians(20))


@pytest.mark.parametrize(
    ("change", "cause"),
    [
        ({"images": 2}, "too few images: 2"),
        ({"around": True, "apart": 0.3}, "^360° film: .* export a flat view of one direction from the camera's app"),
        ({"around": True, "unordered": True, "brightness": 12.0}, "^360° photos: "),
        ({"brightness": 12.0}, "too dark: the mean grey level of the images is 12 of 255, but at least 25 is needed"),
        (
            {"keypoints": 40.0, "verified": 0.1},
            "textureless: even the better images show 40 distinct points, but at least 60",
        ),
        ({"bare": 0.5, "verified": 0.1}, "^textureless: 50% of the images show fewer than 100 points"),
        ({"verified": 0.56}, "^moved too fast: only 56% of the images share enough points"),
        (
            {"verified": 0.56, "brightness": 41.0},
            r"^perhaps too dark: the mean grey level .* is 41 of 255\. Switch on lights\. Or moved too fast: only 56%",
        ),
        (
            {"keypoints": 40.0, "brightness": 41.0},
            r"^perhaps too dark: .* 41 of 255\. Switch on lights\. Or textureless",
        ),
        ({"verified": 0.56, "apart": 0.5}, "too long or too fast: only 56% .* the image 1.0 s later.* lie 0.5 s apart"),
        ({"verified": 0.56, "unordered": True}, "photos too far apart: only 56% of the images share enough points"),
        ({"turned": 0.99, "angle": 0.0, "brightness": 41.0}, "^only turned on the spot: turning alone explains 99%"),
        ({"turned": 0.99, "angle": 0.0, "shift": 0.001}, "hardly moved"),
        ({"angle": math.radians(1.5)}, "hardly moved: .* only 1.5° apart"),
    ],
)
def test_each_fault_is_refused_with_its_own_cause_and_figures(change: dict, cause: str) -> None:
    with pytest.raises(CaptureError, match=cause):
        dataclasses.replace(GOOD, **change).refuse()


def test_a_good_capture_passes() -> None:
    GOOD.refuse()
    dataclasses.replace(GOOD, turned=0.65, angle=math.radians(9)).refuse()  # a film that pans at several places


def test_the_figures_are_computed_from_the_images_and_their_pairs() -> None:
    seen = [
        Features(np.zeros((count + 7, 2)), np.zeros((count + 7, 128)), count, 50.0, (64, 48))
        for count in (100, 200, 300, 400, 500)
    ]
    found = {
        (0, 1): Pair("none"),
        (0, 3): Pair("none"),
        (1, 4): Pair("moved", 0.2, 0.3),
        (0, 4): Pair("turned", 0, 0.1),
    }
    figures = summed(seen, found, unordered=False)
    assert (figures.verified, figures.turned, figures.keypoints) == (0.5, 0.5, 400)
    assert figures.shift == pytest.approx(0.2) and figures.angle == pytest.approx(0.18)
    assert summed(seen, found, unordered=True).verified == pytest.approx(1 / 5)


def test_images_of_a_long_film_are_compared_with_those_a_second_later() -> None:
    seen = [Features(np.zeros((500, 2)), np.zeros((500, 128)), 500, 50.0, (64, 48))] * 50
    found = {(n, n + by): Pair("moved" if by < 2 else "none", 0.2, 0.3) for by in (1, 2, 3) for n in range(50 - by)}
    verified = [summed(seen, found, False, apart).verified for apart in (0.3, 0.5, 0.75, 1.5)]
    assert verified == [0, 0, 1, 1]


@pytest.mark.parametrize("photos_in_order", [True, False])
def test_photos_in_any_order_pass_if_each_shares_points_with_two_others(
    photos_in_order: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    count = 58
    order = np.arange(count) if photos_in_order else np.random.default_rng(0).permutation(count)
    seen = {Path(str(n)): Features(np.full((500, 2), n), np.zeros((500, 128)), 500, 90.0, (64, 48)) for n in order}
    compared: list[int] = []

    def related(a: Features, b: Features) -> Pair:
        compared.append(abs(int(a.points[0, 0] - b.points[0, 0])))
        return Pair("moved" if compared[-1] <= 2 else "none", 0.2, 0.3)

    monkeypatch.setattr(look_module, "features", lambda path, _: seen[path])
    monkeypatch.setattr(look_module, "related", related)
    photos = Photos([*seen], 64, 48, torch.arange(count).double(), files=tuple(map(str, order)))
    figures = look(photos)
    assert figures.unordered and figures.verified == 1.0 and len(compared) < (300 if photos_in_order else 1700)


def test_bare_images_are_not_mistaken_for_fast_motion() -> None:
    points = [500, 500, 20, 500, 500, 99, 500, 500, 100, 500]
    seen = [Features(np.zeros((count, 2)), np.zeros((count, 128)), count, 50.0, (64, 48)) for count in points]
    moved, none = Pair("moved", 0.2, 0.3), Pair("none")
    found = {(0, 3): moved, (1, 4): moved, (2, 5): none, (3, 6): moved, (4, 7): moved, (5, 8): none, (6, 9): none}
    figures = summed(seen, found, unordered=False)
    assert figures.verified == pytest.approx(4 / 5) and figures.bare == pytest.approx(2 / 10)
    found[5, 8] = moved
    assert summed(seen, found, unordered=False) == figures, "what bare images share does not count either"


def test_faint_points_connect_images_and_do_not_count_as_distinct(tmp_path: Path) -> None:
    images = [(128 + 0.08 * (room_image(pose).astype(float) - 128)).round().astype(np.uint8) for pose in walk(24)[::4]]
    photos = photos_of(tmp_path / "in", images)
    found = [features(path) for path in photos.paths]
    assert all(one.distinct < 20 and len(one.points) > 100 for one in found)
    seen = look(photos)
    assert seen.verified == 1.0 and "textureless" in (seen.cause() or "")


def test_a_long_video_is_sampled_in_groups_of_neighbours() -> None:
    short, group = _chosen(np.arange(120) / 6)
    assert len(short) == group == 60 and short[-1] == 119 and np.diff(short).max() <= 3
    long, group = _chosen(np.arange(180) / 3)
    groups = long.reshape(-1, group)
    assert group == 6 and (np.diff(groups, axis=1) == 1).all() and (groups[0, 0], groups[-1, -1]) == (0, 179)
    dense, _ = _chosen(np.arange(600) / 10)
    assert (np.diff(dense.reshape(-1, group), axis=1) == 3).all()
    near = [pair for pair in _pairs(60, group) if pair[1] - pair[0] <= 3]
    assert len(near) == 10 * (5 + 4 + 3) and all(first // 6 == second // 6 for first, second in near)


def test_the_homography_of_a_rotation_is_told_from_that_of_a_plane() -> None:
    angle = 0.2
    turn = np.array([[math.cos(angle), 0, math.sin(angle)], [0, 1, 0], [-math.sin(angle), 0, math.cos(angle)]])
    assert unlike_rotation(5 * K @ turn @ np.linalg.inv(K), (326, 236)) < 0.01
    moved = turn + np.outer([0.4, 0.1, 0], [0, 0.2, 1])
    assert unlike_rotation(K @ moved @ np.linalg.inv(K), (326, 236)) > 1.5 * SAME_CENTRE


def test_a_walk_passes_and_turning_and_standing_still_do_not(tmp_path: Path) -> None:
    def seen(name: str, poses: np.ndarray) -> Look:
        return look(photos_of(tmp_path / name, [room_image(pose) for pose in poses]))

    assert seen("walk", walk(8)).cause() is None
    assert "only turned" in (seen("turning", turning(8)).cause() or "")
    assert "hardly moved" in (seen("still", walk(1).repeat(6, 0)).cause() or "")


def test_dark_and_blank_images_are_told_apart(tmp_path: Path) -> None:
    dark = photos_of(tmp_path / "dark", [room_image(pose) // 20 for pose in walk(4)])
    blank = photos_of(tmp_path / "blank", [np.full((240, 320, 3), 128, np.uint8)] * 4)
    assert "too dark" in (look(dark).cause() or "")
    assert "textureless" in (look(blank).cause() or "")


def _filmed(shared_scenes: Path, name: str, folder: Path) -> Photos:
    videos = shared_scenes / "videos"
    path = videos / name / "video.mp4" if (videos / name).is_dir() else videos / f"{name}.mp4"
    if not path.is_file():
        pytest.skip(f"{path} is not here")
    return read_photos(path, folder)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "cause"),
    [
        ("kitchen_fast", "moved too fast"),
        ("kitchen_rotation", "only turned on the spot"),
        ("kitchen_rotation5cm", "only turned on the spot"),
        ("kitchen_textureless", "textureless"),
    ],
)
def test_bad_videos_are_each_refused_with_their_own_cause(
    shared_scenes: Path, tmp_path: Path, name: str, cause: str
) -> None:
    with pytest.raises(CaptureError, match=cause):
        look(_filmed(shared_scenes, name, tmp_path)).refuse()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["redkitchen", "kitchen_m", "kitchen_rs", "backyard_m"])
def test_good_videos_pass(shared_scenes: Path, tmp_path: Path, name: str) -> None:
    look(_filmed(shared_scenes, name, tmp_path)).refuse()
