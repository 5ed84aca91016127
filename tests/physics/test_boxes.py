"""Boxes for physics: a few that cover exactly the voxels which bodies can meet."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from splatrl.collision.voxels import Voxels
from splatrl.physics.boxes import merged_boxes, solid_above
from splatrl.physics.ground import Ground

EDGE = 0.05
FAR = (-10.0, -10.0), (10.0, 10.0)


def level(height: float = 0.0, slope: float = 0.0) -> Ground:
    normal = np.array([-slope, 0.0, 1.0]) / np.hypot(1.0, slope)
    return Ground(np.append(normal, height * normal[2]), 0.0, 100, 1.0, (0.0, 0.0), 0.0)


def filled(boxes: np.ndarray, voxels: Voxels) -> np.ndarray:
    """Return which voxels of a grid the boxes fill, and assert that the boxes' faces lie on voxel faces."""
    low, high = boxes[:, :3] - boxes[:, 3:], boxes[:, :3] + boxes[:, 3:]
    for corner in (low, high):
        np.testing.assert_allclose(corner / EDGE, np.round(corner / EDGE), atol=1e-9)
    first, end = (np.round(corner / EDGE).astype(int) - voxels.origin_key for corner in (low, high))
    assert (first >= 0).all() and (end <= voxels.occupied.shape).all(), "boxes stay in the grid"
    result = np.zeros(voxels.occupied.shape, bool)
    for a, b in zip(first, end, strict=True):
        result[a[0] : b[0], a[1] : b[1], a[2] : b[2]] = True
    return result


@settings(max_examples=60)
@given(arrays(bool, array_shapes(min_dims=3, max_dims=3, max_side=7)), st.tuples(*[st.integers(-9, 9)] * 3))
def test_the_union_of_the_boxes_equals_the_solid_voxels(occupied: np.ndarray, origin: tuple[int, int, int]) -> None:
    voxels = Voxels(occupied, origin, EDGE)
    boxes = merged_boxes(voxels)
    assert boxes.shape == (len(boxes), 6) and boxes.dtype == np.float64
    np.testing.assert_array_equal(filled(boxes, voxels), occupied)


def test_a_room_becomes_one_box_per_wall() -> None:
    occupied = np.zeros((20, 14, 8), bool)
    occupied[[0, -1]] = True
    occupied[:, [0, -1]] = True
    occupied[8:11, 5:7, :3] = True
    assert len(merged_boxes(Voxels(occupied, (-3, 4, 0), EDGE))) == 5
    assert merged_boxes(Voxels(np.zeros((0, 0, 0), bool), (0, 0, 0), EDGE)).shape == (0, 6)


def column(*layers: int, count: int = 20) -> Voxels:
    """Make a single column with the given solid layers; the lowest layer of the grid is −2."""
    occupied = np.zeros((1, 1, count), bool)
    occupied[0, 0, np.array(layers, np.int64) + 2] = True
    return Voxels(occupied, (0, 0, -2), EDGE)


@pytest.mark.parametrize(
    ("layers", "kept"),
    [
        ([-2, -1, 0], []),  # ground: its voxels lie up to 10 cm above the plane
        ([-1, 0, 1], []),
        ([-1, 0, 1, 2], [0, 1, 2]),  # an object that stands on it, kept down to the plane
        ([-1, 3], [3]),  # an object above it, and the ground below
        ([0, 2, 3], [2, 3]),  # with a gap between the two
        ([-1, 11, 12, 13], [11]),  # up to 0.6 m
        ([], []),
    ],
)
def test_ground_is_removed_and_what_stands_on_it_is_kept(layers: list[int], kept: list[int]) -> None:
    found = solid_above(column(*layers), level(), *FAR, top=0.6)
    assert (np.flatnonzero(found.occupied[0, 0]) - 2).tolist() == kept


def test_heights_are_measured_from_the_plane_at_each_column() -> None:
    occupied = np.ones((80, 1, 3), bool)  # up to 0.15 m, in front of a plane that rises to 0.4 m
    found = solid_above(Voxels(occupied, (0, 0, 0), EDGE), level(0.0, slope=0.1), *FAR, top=0.6)
    kept = found.occupied.any((1, 2))
    assert kept.tolist() == [0.15 - 0.1 * (x + 0.5) * EDGE > 0.1 for x in range(80)]


def test_voxels_that_no_body_reaches_are_left_out() -> None:
    occupied = np.ones((10, 8, 4), bool)
    found = solid_above(Voxels(occupied, (0, 0, 0), EDGE), level(), (0.1, 0.12), (0.3, 0.28), top=0.6)
    kept = found.occupied
    assert np.flatnonzero(kept.any((1, 2))).tolist() == [2, 3, 4, 5]  # whole voxels; those that just touch are out
    assert np.flatnonzero(kept.any((0, 2))).tolist() == [2, 3, 4, 5]


def test_a_top_below_the_turf_is_refused() -> None:
    with pytest.raises(ValueError, match=r"top: expected a height above turf \(0\.1 m\), got 0\.05"):
        solid_above(column(0), level(), *FAR, top=0.05)
