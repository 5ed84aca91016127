import json
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from splatrl.collision import DensitySettings, Occupancy
from tests.collision.test_occupancy import blobs, same


def random_grid(seed: int, resolution: float = 0.1) -> Occupancy:
    generator = np.random.default_rng(seed)
    shape, origin = generator.integers(1, 7, 3), generator.integers(-5, 5, 3)
    return Occupancy(generator.random(shape) < 0.4, tuple(origin.tolist()), resolution)


@settings(max_examples=30)
@given(seeds=st.tuples(st.integers(0, 2**32 - 1), st.integers(0, 2**32 - 1)))
def test_a_union_is_solid_where_either_is(seeds):
    a, b = (random_grid(seed) for seed in seeds)
    keys = {tuple(key) for grid in (a, b) for key in grid.keys().tolist()}
    assert {tuple(key) for key in (a | b).keys().tolist()} == keys
    assert (a | b).keys().tolist() == (b | a).keys().tolist()


def test_a_union_with_an_empty_grid_changes_nothing():
    grid = random_grid(1)
    assert same(grid | Occupancy.empty(0.1), grid)
    assert same(Occupancy.empty(0.1) | grid, grid)
    assert (Occupancy.empty(0.1) | Occupancy.empty(0.1)).count == 0


def test_a_union_of_different_resolutions_or_of_grids_too_far_apart_is_refused():
    with pytest.raises(ValueError, match=r"expected two grids of the same resolution, got 0.1 and 0.05 m"):
        random_grid(1) | Occupancy.empty(0.05)
    with pytest.raises(ValueError, match=r"expected at most 67108864 voxels"):
        Occupancy.from_keys([[0, 0, 0]], 0.1) | Occupancy.from_keys([[1000, 1000, 1000]], 0.1)


def test_carving_the_boxes_that_were_added_restores_the_grid():
    lower, upper = [[0.1, -0.2, 0.3], [5.0, 5.0, 5.0]], [[0.3, 0.1, 0.7], [5.5, 5.2, 5.1]]
    wall = Occupancy.from_boxes([[-1.0, 2.0, 0.0]], [[1.0, 2.1, 1.0]], 0.1)
    added = wall.with_boxes(lower, upper)
    assert added.count == wall.count + 24 + 10
    assert added.carved(lower, upper).keys().tolist() == wall.keys().tolist()


def test_a_carved_box_is_free_and_the_rest_is_unchanged():
    block = Occupancy.from_boxes([[0.0, 0.0, 0.0]], [[1.0, 0.8, 0.6]], 0.1)
    carved = block.carved([[0.25, -1.0, 0.2]], [[0.5, 9.0, 0.4]])
    assert block.count - carved.count == 3 * 8 * 2
    assert not carved.contains([[0.26, 0.4, 0.3], [0.49, 0.0, 0.39]]).any()
    assert carved.contains([[0.19, 0.4, 0.3], [0.51, 0.4, 0.3], [0.3, 0.4, 0.19], [0.3, 0.4, 0.41]]).all()
    assert same(block.carved([[5.0, 0.0, 0.0], [-9.0, 0, 0]], [[6.0, 1.0, 1.0], [-8.0, 1, 1]]), block)
    assert block.carved([[-1e300, -1.0, -1.0]], [[1e300, 1.0, 1.0]]).count == 0
    with pytest.raises(ValueError, match=r"upper: expected"):
        block.carved([[0.0, 0.0, 0.0]], [[1.0, 0.0, 1.0]])


def test_from_scene_clears_and_adds_boxes_before_it_fills():
    grid = torch.cartesian_prod(torch.arange(0, 2, 0.03), torch.arange(0, 1.5, 0.03), torch.tensor([0.0]))
    scene = SimpleNamespace(
        pieces=[lambda: blobs(grid, 0.02)],
        bounds=((0.0, 0.0, 0.0), (2.0, 1.5, 1.0)),
        free=None,
        cached=lambda kind, settings, build, most: json.loads(json.dumps(settings)) and build(),
    )
    shell = [[[0.5, 0.5, 0.1], [1.0, 1.0, 0.8]]]
    hollow = [[[0.6, 0.6, 0.2], [0.9, 0.9, 0.7]]]
    middle, floor = [[0.75, 0.75, 0.45]], [[0.25, 0.25, 0.01]]
    added = Occupancy.from_scene(scene, resolution=0.1, add=shell, clear=[[[0.0, 0.0, -1.0], [0.4, 0.4, 1.0]]])
    assert added.contains(middle).all()
    assert not added.contains(floor).any()
    top = [[[0.5, 0.5, 0.7], [1.0, 1.0, 0.8]]]
    sides = [[[0.5, 0.5, 0.1], [0.6, 1.0, 0.8]], [[0.9, 0.5, 0.1], [1.0, 1.0, 0.8]]]
    sides += [[[0.5, 0.5, 0.1], [1.0, 0.6, 0.8]], [[0.5, 0.9, 0.1], [1.0, 1.0, 0.8]]]
    assert not Occupancy.from_scene(scene, resolution=0.1, add=top + sides, clear=hollow).contains(middle).any()
    seeds, around = [[0.2, 0.2, 0.6]], ((0.0, 0.0, 0.3), (2.0, 1.5, 1.2))
    filled = Occupancy.from_scene(scene, seeds, around, fill=0.2, resolution=0.1, add=top + sides, clear=hollow)
    assert filled.contains(middle).all()
    assert not filled.contains(seeds).any()
    with pytest.raises(ValueError, match=r"add: expected a lower corner"):
        Occupancy.from_scene(scene, add=[[[0, 0, 0], [1, 0, 1]]])


def test_a_report_counts_solid_voxels_pieces_and_volumes():
    boxes = Occupancy.from_boxes([[0.0, 0.0, 0.0], [0.5, 0.0, 0.0]], [[0.2, 0.2, 0.2], [0.6, 0.1, 0.1]], 0.1)
    report = boxes.report()
    assert (report.occupied, report.components, report.shape) == (9, 2, (6, 2, 2))
    assert report.occupied_volume == pytest.approx(0.009)
    assert report.free_volume == pytest.approx(0.015)
    assert "9 voxels, 0.009 m³, in 2 pieces" in str(report)
    assert Occupancy.empty().report().components == 0


def test_the_count_of_dropped_floaters_is_reported_and_survives_edits():
    floor = torch.cartesian_prod(torch.arange(0, 1.6, 0.03), torch.arange(0, 1.1, 0.03), torch.tensor([0.0]))
    scene = blobs(torch.cat([floor, torch.tensor([[0.5, 0.4, 0.3]])]), 0.02)
    kept, every = (
        Occupancy.from_gaussians(scene),
        Occupancy.from_gaussians(scene, density=DensitySettings(min_volume=0.0)),
    )
    assert kept.report().floaters == every.count - kept.count > 0
    assert (kept | every).carved([[0, 0, 0]], [[1, 1, 1]]).trimmed().floaters == kept.floaters
    assert Occupancy.from_arrays(kept.to_arrays()).floaters == kept.floaters
