import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from splatrl.collision import DistanceField, Occupancy


def true_distances(occupancy: Occupancy, points: np.ndarray) -> np.ndarray:
    gaps = np.abs(points[:, None] - (occupancy.keys() + 0.5) * occupancy.resolution) - 0.5 * occupancy.resolution
    return np.linalg.norm(np.maximum(gaps, 0.0), axis=2).min(1)


@settings(max_examples=40)
@given(seed=st.integers(0, 2**32 - 1), share=st.sampled_from([0.01, 0.1, 0.6]))
def test_clearance_is_below_the_true_distance_by_less_than_a_voxel_diagonal(seed, share):
    rng = np.random.default_rng(seed)
    occupied = rng.random((7, 5, 9)) < share
    occupied[3, 2, 4] = True
    occupancy = Occupancy(occupied, (-3, 4, -20), 0.1)
    lower, upper = occupancy.bounds
    points = rng.uniform(lower - 0.5, upper + 0.5, (200, 3))
    true, bound = true_distances(occupancy, points), DistanceField(occupancy).clearance(points)
    assert (bound <= true + 1e-6).all()
    inside = ((points >= lower) & (points < upper)).all(1)
    assert (bound >= true - np.sqrt(3) * 0.1 - 1e-6)[inside].all()


@pytest.mark.parametrize("shape", [(1, 1, 1), (5, 1, 7), (17, 33, 16), (40, 21, 31)])
@pytest.mark.parametrize("share", [0.0, 0.002, 0.1, 0.6, 1.0])
def test_distances_match_scipys_distance_transform(shape: tuple[int, int, int], share: float) -> None:
    occupied = np.random.default_rng(0).random(shape) < share
    if share == 0.002:
        occupied[0, 0, -1] = True
    centers = DistanceField(Occupancy(occupied, (0, 0, 0), 0.07)).centers
    if occupied.any():
        np.testing.assert_allclose(centers, ndimage.distance_transform_edt(~occupied, sampling=0.07), rtol=2e-7)
    else:
        assert np.isinf(centers).all()


def test_clearance_is_zero_in_a_solid_voxel():
    occupancy = Occupancy.from_boxes([[0.0, 0.0, 0.0]], [[0.3, 0.2, 0.4]], 0.1)
    assert DistanceField(occupancy).clearance(occupancy.centers()).max() == 0.0


def test_clearance_far_outside_the_grid_is_nearly_the_true_distance():
    occupancy = Occupancy.from_keys([[0, 0, 0], [9, 4, 2]], 0.1)
    bound = DistanceField(occupancy).clearance([[-30.0, 0.05, 0.05], [0.95, 0.45, 40.3]])
    assert bound == pytest.approx([30.0, 40.0], abs=0.1)


def test_clearance_is_infinite_where_nothing_is_solid():
    assert np.isinf(DistanceField(Occupancy.empty()).clearance(torch.zeros(3, 3))).all()
    unsolid = Occupancy(np.zeros((2, 3, 4), bool), (0, 0, 0), 0.1)
    assert np.isinf(DistanceField(unsolid).clearance(torch.zeros(3, 3))).all()
    assert np.isinf(DistanceField(unsolid).centers).all()


def test_distances_between_centers_are_euclidean():
    field = DistanceField(Occupancy.from_keys([[0, 0, 0], [3, 4, 0]], 0.1))
    assert field.centers[0, 0, 0] == 0.0
    assert field.centers[0, 2, 0] == pytest.approx(0.2)
    assert field.centers[3, 1, 0] == pytest.approx(0.3)
    assert field.centers[1, 1, 0] == pytest.approx(0.1 * np.sqrt(2))
