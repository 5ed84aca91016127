"""Films that lost their scale half-way or were joined wrongly are distinguished from sound ones."""

import re
from dataclasses import replace

import numpy as np
import pytest
import torch

from splatrl.capture.base import Reconstruction
from splatrl.capture.drift import below_floor, leap, lost_scale, weak_scale
from splatrl.capture.world import SCALE_ERROR, Placed, moved, place
from tests.capture.walks import ABOVE, CAMERAS, walk, without_points


@pytest.mark.parametrize(("scale", "lost"), [(1.0, False), (0.6, False), (0.2, True)])
def test_only_a_large_change_of_scale_half_way_counts_as_lost_scale(scale: float, lost: bool) -> None:
    first = walk()
    about = np.eye(4)
    about[:3, :3] *= scale
    about[:3, 3] = (1 - scale) * first.camera_to_world[-1, :3, 3].numpy()
    second = moved(first, about)
    both = replace(
        first,
        paths=[*first.paths, *second.paths],
        camera_to_world=torch.cat([first.camera_to_world, second.camera_to_world]),
        points=torch.cat([first.points, second.points]),
        colors=torch.cat([first.colors, second.colors]),
        seen_point=torch.cat([first.seen_point, second.seen_point + len(first.points)]),
        seen_by=torch.cat([first.seen_by, second.seen_by + CAMERAS]),
        seconds=torch.arange(2 * CAMERAS, dtype=torch.float64) / 4,
    )
    said = lost_scale(place(both, marker=None, camera_height=1.4))
    assert (said is not None) == lost
    assert not lost or "m above the floor at" in str(said)


def test_a_film_whose_scale_is_hardly_carried_on_is_reported_with_the_time_and_states_no_error() -> None:
    ways = torch.full((CAMERAS,), 0.2, dtype=torch.float64)
    film = replace(walk(), seconds=torch.arange(CAMERAS, dtype=torch.float64) / 4, carried=ways.clone())
    good = place(film, marker=None, camera_height=1.4)
    assert good.scale_error == SCALE_ERROR["camera_height"] and weak_scale(good) is None
    ways[24] = 0.06
    film = replace(film, carried=ways)
    weak = place(film, marker=None, camera_height=1.4)
    assert weak.scale_error is None and weak.up_error_deg is None and good.up_error_deg is not None
    assert "before and after 6 s may differ in scale: only 6 %" in str(weak_scale(weak))
    assert place(film, metric=True, marker=None).scale_error == SCALE_ERROR["recorded"]


HALF, STILL = 40, 90


def _film(jump: float, still: int = 0, cuts: tuple[float, ...] = ()) -> Placed:
    """Return a walk whose second half is shifted sideways by ``jump`` metres, after ``still`` images from one place."""
    first = walk()
    rows = torch.arange(still + 2 * HALF) % CAMERAS
    poses = first.camera_to_world[rows].clone()
    seconds = torch.arange(len(rows), dtype=torch.float64) / 4
    walked = (seconds - still / 4).clamp(min=0.0)
    poses[:, 0, 3], poses[:, 1, 3] = 0.8 * walked, torch.sin(0.5 * walked)
    poses[:still, 2, 3] = poses[still, 2, 3]
    poses[:, :3, 3] += 0.0002 * torch.randn(len(rows), 3, generator=torch.Generator().manual_seed(0))
    poses[still + HALF :, 1, 3] += jump
    film = replace(first, paths=[first.paths[row] for row in rows], camera_to_world=poses, seconds=seconds, cuts=cuts)
    return place(film, marker=None, camera_height=1.4)


@pytest.mark.parametrize("scale", [1.0, 5.0])
def test_a_camera_that_jumps_is_reported_with_the_time_of_the_jump(scale: float) -> None:
    film = _film(1.5)
    film = replace(film, reconstruction=moved(film.reconstruction, np.diag([scale] * 3 + [1.0])))
    assert "jump at 10 s" in str(leap(film))
    assert leap(_film(0.0)) is None


def test_a_film_that_stands_still_for_half_its_length_is_not_reported_as_jumping() -> None:
    assert leap(_film(0.0, still=STILL)) is None
    assert "jump at 32 s" in str(leap(_film(1.5, still=STILL)))


def test_the_way_from_one_take_to_the_next_is_no_leap_and_a_leap_within_a_take_is_reported() -> None:
    torn = _film(1.5)
    assert torn.up_from == "floor" and torn.scale_error is None and torn.up_error_deg is None
    takes = _film(1.5, cuts=(9.9,))
    assert leap(takes) is None and takes.scale_error == SCALE_ERROR["camera_height"]
    assert takes.up_error_deg is not None and takes.up_error_deg < 5.0
    assert "jump at 10 s" in str(leap(_film(1.5, cuts=(5.1, 15.0))))
    assert leap(_film(1.5, cuts=tuple(np.arange(0.1, 20.0, 0.5)))) is None, "all takes are of two images"


def test_photos_without_times_are_never_reported_as_jumping() -> None:
    film = _film(1.5)
    assert leap(replace(film, reconstruction=replace(film.reconstruction, seconds=None))) is None


def _sinking(last: float, scale: float = 1.0) -> Reconstruction:
    """Return a walk whose camera moves evenly, in its last third down to a height of ``last`` metres."""
    first = walk()
    poses = first.camera_to_world.clone()
    turn = torch.linspace(0, 6.0, CAMERAS, dtype=torch.float64)
    poses[:, 0, 3], poses[:, 1, 3], poses[:, 2, 3] = 1.5 * turn.cos(), 1.7 * turn.sin(), ABOVE
    poses[:, 2, 3] += (last - ABOVE) * ((turn - 4.0).clamp(min=0.0) / 2.0) ** 2
    film = replace(first, camera_to_world=poses, seconds=torch.arange(CAMERAS, dtype=torch.float64) / 4)
    return moved(film, np.diag([scale] * 3 + [1.0]))


@pytest.mark.parametrize("scale", [1.0, 0.2])
def test_a_camera_that_goes_below_the_floor_is_reported_with_the_time_and_states_no_errors(scale: float) -> None:
    sunken = place(_sinking(-0.15, scale), marker=None, camera_height=1.2)
    assert leap(sunken) is None and sunken.up_from == "floor"
    assert re.search("below the floor at (9|10) s: parts of the place are joined wrongly", str(below_floor(sunken)))
    assert (sunken.up_error_deg, sunken.scale_error) == (None, None)
    lowered = place(_sinking(0.15, scale), marker=None, camera_height=1.2)
    assert below_floor(lowered) is None and None not in (lowered.up_error_deg, lowered.scale_error)


def test_a_phone_that_is_laid_on_the_floor_is_not_reported() -> None:
    film = _sinking(-0.01)
    assert float(film.camera_to_world[-1, 2, 3]) < 0.0
    assert below_floor(place(film, marker=None, camera_height=1.2)) is None


def test_a_camera_that_goes_down_to_where_no_floor_is_seen_is_not_reported() -> None:
    film = _sinking(-0.15)
    under = film.camera_to_world[-6:, :2, 3]
    away = torch.cdist(film.points[:, :2], under).amin(1) > 0.8
    assert below_floor(place(without_points(film, away), marker=None, camera_height=1.2)) is None


def test_photos_of_a_camera_below_the_floor_are_reported_by_their_number() -> None:
    photos = replace(_sinking(-0.15), seconds=None)
    assert re.search(r"below the floor at image 3\d", str(below_floor(place(photos, marker=None, camera_height=1.2))))
