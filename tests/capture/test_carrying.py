"""Whether a film's scale is carried on is told from what its images share, and films where it is not are parted."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from splatrl.array_files import read_arrays
from splatrl.capture.carrying import WEAK, carried
from splatrl.capture.sfm.job import Job
from splatrl.capture.sfm.structure import MODEL, _keep
from tests.capture.walks import similarity_of

COUNT, HINGE = 40, 24


def _film(crossing: int, back: int = 0, turning: int = 0) -> tuple[np.ndarray, ...]:
    """Return places, points, ``seen_point`` and ``seen_by`` of a film along x, each point seen by six images.

    Only ``crossing`` points of those around image ``HINGE`` are seen from both sides of it, ``back`` points again at
    the end of the film, and the last ``turning`` images are all from one place.
    """
    generator, places = np.random.default_rng(0), np.zeros((COUNT, 3))
    places[:, 0] = 0.3 * np.minimum(np.arange(COUNT), COUNT - 1 - turning)
    points, seen_point, seen_by = [], [], []
    for first in range(COUNT - 5):
        for number in range(40):
            rows = np.arange(first, first + 6)
            if rows[0] < HINGE <= rows[-1] and (first != HINGE - 3 or number >= crossing):
                rows = rows[rows < HINGE] if number % 2 else rows[rows >= HINGE]
            if first < 10 and number < back:
                rows = np.concatenate([rows, [COUNT - 3, COUNT - 1]])
            points.append([0.3 * first + 0.75 + generator.normal(), 4.0, generator.normal()])
            seen_point += [len(points) - 1] * len(rows)
            seen_by += rows.tolist()
    return places, np.array(points), np.array(seen_point), np.array(seen_by)


def test_the_scale_is_carried_past_an_image_by_points_measured_from_both_sides() -> None:
    good, weak = carried(*_film(40)), carried(*_film(12))
    shown = len(_film(12)[2]) / COUNT
    assert weak.argmin() == HINGE - 1 or weak.argmin() == HINGE
    assert weak[HINGE] * shown == pytest.approx(12) and weak[HINGE] < WEAK < good[:HINGE].min()
    assert good.min() > weak.min()
    assert np.isinf(weak[0]) and np.isinf(weak[-1]), "the ends have no scale of their own"
    places, points, *seen = _film(12)
    transform = similarity_of(3)
    moved = [values @ transform[:3, :3].T + transform[:3, 3] for values in (places, points)]
    order = np.random.default_rng(1).permutation(len(seen[0]))
    np.testing.assert_array_equal(carried(*moved, *(each[order] for each in seen)), weak)


def test_points_that_are_seen_again_carry_the_scale_past_everything_in_between() -> None:
    assert carried(*_film(0)).min() == 0
    assert carried(*_film(0, back=20)).min() > WEAK


def test_a_camera_that_only_turns_at_the_end_has_no_scale_that_could_differ() -> None:
    ways = carried(*_film(40, turning=12))
    assert np.isinf(ways[-10:]).all()


@pytest.mark.parametrize("film", [True, False])
def test_a_film_is_parted_where_its_scale_is_not_carried_on_and_photos_are_not(film: bool, tmp_path: Path) -> None:
    places, points, seen_point, seen_by = _film(0)
    images = {}
    for number, at in enumerate(places.tolist()):
        pose = np.eye(4)
        pose[:3, 3] = at
        inverse = SimpleNamespace(translation=pose[:3, 3], matrix=lambda pose=pose: pose[:3])
        held = SimpleNamespace(inverse=lambda inverse=inverse: inverse)
        images[number + 1] = SimpleNamespace(
            image_id=number + 1, name=f"{number:04}", has_pose=True, cam_from_world=lambda held=held: held
        )
    tracks = {
        point: [SimpleNamespace(image_id=int(by) + 1) for by in seen_by[seen_point == point]]
        for point in range(len(points))
    }
    far = len(points)  # points too far away to tell a distance join the images all the same
    tracks |= {far + n: [SimpleNamespace(image_id=number + 1) for number in range(COUNT)] for n in range(30)}
    every = np.concatenate([points, np.tile([0.0, 1e6, 0.0], (30, 1))])
    three = {
        point: SimpleNamespace(xyz=every[point], color=[0] * 3, track=SimpleNamespace(elements=track))
        for point, track in tracks.items()
    }
    lens = {"focal_length_x": 1, "focal_length_y": 1, "principal_point_x": 1, "principal_point_y": 1}
    camera = SimpleNamespace(model=SimpleNamespace(name="PINHOLE"), params=[1] * 4, **lens)
    model = SimpleNamespace(images=images, points3D=three, cameras={1: camera})
    names = [image.name for image in images.values()]
    seconds = (np.arange(COUNT) / 4).tolist() if film else None
    _keep(tmp_path, Job("", names, 8, 6, seconds=seconds), model)
    kept = read_arrays(tmp_path / MODEL)["images"]
    assert kept.tolist() == list(range(HINGE - 1 if film else COUNT))
