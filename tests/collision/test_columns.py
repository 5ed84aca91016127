"""Distances across the columns of a voxel grid."""

import numpy as np
import pytest

from splatrl.collision.columns import cells_across


def test_distances_are_between_centres_of_columns() -> None:
    marked = np.zeros((4, 6), bool)
    marked[1, 2] = True
    corner = np.array([(10 + 1) * 0.5, (-3 + 2) * 0.5])  # of the marked column
    places = corner + np.array([[[0.1, 0.4], [1.1, 0.4]], [[0.4, 1.6], [-0.1, -0.1]]])
    assert cells_across(marked, (10, -3), 0.5, places) == pytest.approx(np.array([[0.0, 2.0], [3.0, np.sqrt(2.0)]]))


def test_a_place_beyond_the_columns_counts_as_at_their_edge() -> None:
    marked = np.zeros((4, 6), bool)
    marked[0, 5] = True
    assert cells_across(marked, (0, 0), 1.0, np.array([[-7.5, 99.0], [99.0, 5.5]])).tolist() == [0.0, 3.0]


def test_without_a_marked_column_all_places_are_infinitely_far() -> None:
    assert cells_across(np.zeros((0, 6), bool), (0, 0), 1.0, np.zeros((3, 2))).tolist() == [np.inf] * 3
