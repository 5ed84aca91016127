import json
import pickle
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from hydra.utils import instantiate
from hypothesis import given, settings
from hypothesis import strategies as st
from omegaconf import OmegaConf

from splatrl.collision import DensitySettings, Occupancy
from splatrl.collision.point_clouds import write_points
from splatrl.scenes import Gaussians, backyard
from splatrl.scenes.scene import FreeSpace


def same(a: Occupancy, b: Occupancy) -> bool:
    return np.array_equal(a.occupied, b.occupied) and a.origin_key == b.origin_key and a.resolution == b.resolution


def blobs(means: torch.Tensor, scale: float) -> Gaussians:
    count = len(means)
    return Gaussians(
        means=means,
        quats=torch.tensor([1.0, 0, 0, 0]).expand(count, 4),
        scales=torch.full((count, 3), scale),
        opacities=torch.full((count,), 0.9),
        sh=torch.zeros(count, 1, 3),
        batch_size=[count],
    )


def test_a_voxel_contains_its_lower_faces_but_not_its_upper_ones():
    occupancy = Occupancy(np.ones((1, 1, 1), bool), (2, -1, 0), 0.5)
    points = torch.tensor([[1.0, -0.5, 0.0], [1.49, -0.01, 0.49], [1.5, -0.5, 0.0], [1.0, 0.0, 0.0], [0.99, -0.1, 0.1]])
    assert occupancy.contains(points).tolist() == [True, True, False, False, False]


def test_from_points_fills_the_voxels_that_hold_points():
    points = torch.tensor([[0.05, 0.12, -0.01], [0.07, 0.11, -0.02], [0.31, -0.29, 0.4]])
    occupancy = Occupancy.from_points(points, 0.1)
    assert occupancy.keys().tolist() == [[0, 1, -1], [3, -3, 4]]
    assert occupancy.origin_key == (0, -3, -1)
    assert occupancy.occupied.shape == (4, 5, 6)


def test_from_points_leaves_out_what_lies_outside_the_crop():
    points = np.array([[0.05, 0.05, 0.05], [5.0, 0.0, 0.0], [0.0, 0.0, -2000.0]])
    occupancy = Occupancy.from_points(points, 0.1, crop=((0, 0, 0), (1, 2, 3)))
    assert occupancy.keys().tolist() == [[0, 0, 0]]
    assert Occupancy.from_points(points, 0.1, crop=((7, 7, 7), (8, 8, 8))).count == 0


def test_from_boxes_fills_the_box_and_nothing_beside_it():
    occupancy = Occupancy.from_boxes([[0.1, -0.2, 0.3]], [[0.3, 0.1, 0.7]], 0.1)
    assert occupancy.bounds[0] == pytest.approx([0.1, -0.2, 0.3])
    assert occupancy.bounds[1] == pytest.approx([0.3, 0.1, 0.7])
    assert occupancy.occupied.all()
    assert occupancy.count == 2 * 3 * 4
    assert occupancy.volume == pytest.approx(0.2 * 0.3 * 0.4)


def test_a_box_thinner_than_a_voxel_fills_one_layer():
    occupancy = Occupancy.from_boxes([[0.0, 0.0, 0.12]], [[0.3, 0.2, 0.13]], 0.1)
    assert occupancy.occupied.shape == (3, 2, 1)
    assert occupancy.origin_key == (0, 0, 1)


def test_a_face_on_a_voxel_boundary_fills_nothing_beyond_it_despite_rounding():
    assert 0.3 / 0.1 < 3
    assert Occupancy.from_boxes([[0.3, 0.3, 0.3]], [[0.4, 0.5, 0.6]], 0.1).occupied.shape == (1, 2, 3)
    lower, upper = torch.tensor([[[-10.3, 0.3, 90.1]], [[-10.2, 0.7, 90.4]]])  # float32
    assert Occupancy.from_boxes(lower, upper, 0.1).occupied.shape == (1, 4, 3)


def test_a_box_thinner_than_rounding_fills_the_voxels_that_hold_it():
    sliver = Occupancy.from_boxes([[0.1, 0.0, 0.0]], [[0.1 + 1e-9, 0.2, 0.1]], 0.1)
    assert sliver.keys().tolist() == [[1, 0, 0], [1, 1, 0]]


def test_centers_lie_in_their_own_voxels():
    occupancy = Occupancy.from_boxes([[-1.0, 0.0, 0.0], [2.0, 1.0, 0.3]], [[-0.7, 0.1, 0.2], [2.1, 1.3, 0.4]], 0.05)
    centers = occupancy.centers()
    assert centers.shape == (occupancy.count, 3)
    assert centers[0] == pytest.approx([-0.975, 0.025, 0.025])
    assert occupancy.contains(centers).all()
    assert not occupancy.contains(centers + np.array([0.0, 0.0, 0.25])).any()


def test_an_empty_occupancy_holds_no_point():
    empty = Occupancy.empty(0.1)
    assert empty.count == 0
    assert empty.centers().shape == (0, 3)
    assert not empty.contains(torch.zeros(4, 3)).any()
    assert Occupancy.from_points(np.zeros((0, 3)), 0.1).count == 0
    assert Occupancy.from_boxes(np.zeros((0, 3)), np.zeros((0, 3)), 0.1).count == 0


def test_trimming_keeps_every_solid_voxel_in_the_smallest_grid():
    occupied = np.zeros((6, 7, 8), bool)
    occupied[2, 3, 4] = occupied[3, 3, 6] = True
    loose = Occupancy(occupied, (10, -20, 30), 0.1)
    trimmed = loose.trimmed()
    assert trimmed.occupied.shape == (2, 1, 3)
    assert trimmed.keys().tolist() == loose.keys().tolist() == [[12, -17, 34], [13, -17, 36]]
    assert Occupancy(np.zeros((2, 3, 4), bool), (1, 1, 1), 0.1).trimmed().occupied.size == 0


@settings(max_examples=30)
@given(
    seed=st.integers(0, 2**32 - 1),
    shape=st.tuples(*[st.integers(0, 6)] * 3),
    origin=st.tuples(*[st.integers(-1000, 1000)] * 3),
)
def test_an_occupancy_round_trips_through_arrays_and_pickles(seed, shape, origin):
    occupancy = Occupancy(np.random.default_rng(seed).random(shape) < 0.4, origin, 0.07)
    assert same(Occupancy.from_arrays(occupancy.to_arrays()), occupancy)
    assert same(pickle.loads(pickle.dumps(occupancy)), occupancy)


def test_a_digest_changes_with_every_voxel_its_position_and_the_resolution() -> None:
    occupied = np.arange(24).reshape(2, 3, 4) % 3 == 0
    grids = [Occupancy(occupied, origin, 0.1) for origin in ((1, 2, 3), (2, 2, 3), (1, 3, 3), (1, 2, 4))]
    other = occupied.copy()
    other[1, 2, 3] ^= True
    grids += [Occupancy(other, (1, 2, 3), 0.1), Occupancy(occupied, (1, 2, 3), 0.2)]
    grids += [Occupancy(occupied.reshape(3, 2, 4), (1, 2, 3), 0.1)]
    assert len({grid.digest for grid in grids}) == len(grids)
    assert Occupancy(occupied.copy(), (1, 2, 3), 0.1).digest == grids[0].digest


def test_arrays_survive_an_npz_file(tmp_path):
    occupancy = Occupancy.from_boxes([[0.0, 0.0, 0.0]], [[0.3, 0.2, 0.5]], 0.1)
    np.savez(tmp_path / "occupancy.npz", **occupancy.to_arrays())
    with np.load(tmp_path / "occupancy.npz") as arrays:
        assert same(Occupancy.from_arrays(arrays), occupancy)


def remembering(gaussians: Gaussians, bounds=((0.0, 0.0, 0.0), (1.0, 0.6, 1.2))) -> tuple[SimpleNamespace, list[str]]:
    """Make a scene with a cache in memory, and the list of cache keys under which anything was built."""
    kept: dict[str, dict] = {}

    def cached(kind, settings, build, most):
        if (key := json.dumps([kind, settings])) not in kept:
            kept[key] = build()
            builds.append(key)
        return kept[key]

    builds: list[str] = []
    scene = SimpleNamespace(gaussians=gaussians, pieces=[lambda: gaussians], bounds=bounds, cached=cached, free=None)
    return scene, builds


def slab() -> Gaussians:
    return blobs(
        torch.cartesian_prod(torch.arange(0, 1, 0.03), torch.arange(0, 0.6, 0.03), torch.arange(0, 0.3, 0.03)), 0.02
    )


def test_from_scene_builds_once_and_then_reads_the_cache():
    scene, builds = remembering(slab())
    first = Occupancy.from_scene(scene, resolution=0.1)
    assert same(first, Occupancy.from_scene(scene, resolution=0.1))
    assert same(first, Occupancy.from_gaussians(scene.gaussians, 0.1))
    assert len(builds) == 1


@pytest.mark.parametrize(
    "change",
    [
        {"resolution": 0.2},
        {"density": DensitySettings(min_opacity=0.2)},
        {"density": DensitySettings(cutoff=0.4)},
        {"density": DensitySettings(min_volume=0.0)},
        {"density": DensitySettings(max_scale=0.7)},
        {"crop": ((0.0, 0.0, 0.0), (0.5, 0.5, 0.5))},
        {"max_voxels": 10**6},
        {"fill": 0.3},
        {"fill": None},
        {"seeds": [[0.5, 0.3, 0.9]]},
        {"around": ((0.0, 0.0, 0.0), (1.0, 0.6, 1.5))},
        {"clear": [[[0.0, 0.0, 0.0], [0.2, 0.2, 0.2]]]},
        {"add": [[[0.0, 0.0, 0.0], [0.2, 0.2, 0.2]]]},
    ],
    ids=str,
)
def test_from_scene_builds_again_when_any_argument_changes(change):
    scene, builds = remembering(slab())
    stated = {"seeds": [[0.5, 0.3, 1.0]], "around": ((0.0, 0.0, 0.0), (1.0, 0.6, 1.2)), "resolution": 0.1, "fill": 0.2}
    for arguments in (stated, stated | change, stated | change):
        Occupancy.from_scene(scene, **arguments)
    assert len(builds) == 2


def test_settings_from_yaml_give_the_same_occupancy_as_from_python():
    node = OmegaConf.create(
        """
        _target_: splatrl.collision.Occupancy.from_scene
        _partial_: true
        resolution: 0.1
        density: {_target_: splatrl.collision.DensitySettings, cutoff: 0.3, max_scale: null}
        crop: [[0, 0, 0], [0.5, 0.5, 0.5]]
        cloud: null
        clear: [[[0, 0, 0], [0.2, 0.2, 0.2]]]
        """
    )
    scene, builds = remembering(slab())
    crop, clear = ((0.0, 0.0, 0.0), (0.5, 0.5, 0.5)), [((0.0, 0.0, 0.0), (0.2, 0.2, 0.2))]
    stated = Occupancy.from_scene(scene, None, None, 0.1, DensitySettings(cutoff=0.3), crop, clear=clear)
    assert same(instantiate(node)(scene), stated)
    assert len(builds) == 1


def test_from_scene_extends_a_tenth_beyond_the_bounds_or_to_the_crop():
    grid = torch.cartesian_prod(torch.arange(-3, 3, 0.08), torch.arange(-3, 3, 0.08), torch.tensor([0.0]))
    scene = SimpleNamespace(
        free=None,
        pieces=[lambda: blobs(grid, 0.06)],
        bounds=((0.0, 0.0, 0.0), (2.0, 1.0, 0.0)),  # flat, as the sheet is
        cached=lambda kind, settings, build, most: build(),
    )
    bounds = Occupancy.from_scene(scene, resolution=0.1).bounds
    assert bounds[0][:2] == pytest.approx([-0.2, -0.2])
    assert bounds[1][:2] == pytest.approx([2.2, 1.2])
    crop, around = ((-1, -1, -1), (0.5, 0.3, 1)), ((-1.0, 0.2, 0.0), (1.0, 2.2, 0.4))
    for where in (None, around):
        bounds = Occupancy.from_scene(scene, around=where, resolution=0.1, crop=crop).bounds
        assert bounds[0][:2] == pytest.approx([-1.0, -1.0])
        assert bounds[1][:2] == pytest.approx([0.5, 0.3])


def test_from_scene_also_extends_a_tenth_beyond_where_robots_are():
    grid = torch.cartesian_prod(torch.arange(-3, 3, 0.08), torch.arange(-3, 3, 0.08), torch.tensor([0.0]))
    scene = SimpleNamespace(
        free=None,
        pieces=[lambda: blobs(grid, 0.06)],
        bounds=((0.0, 0.0, 0.0), (2.0, 1.0, 0.0)),
        cached=lambda kind, settings, build, most: build(),
    )
    bounds = Occupancy.from_scene(scene, around=((-0.95, 0.2, 0.0), (1.05, 2.15, 0.4)), resolution=0.1).bounds
    assert bounds[0][:2] == pytest.approx([-1.2, -0.2])  # rounded to whole voxels
    assert bounds[1][:2] == pytest.approx([2.2, 2.4])


@pytest.mark.parametrize(("resolution", "gone"), [(0.05, 6**3), (0.1, 3**3), (0.2, 1)])
def test_only_voxels_that_are_entirely_free_are_removed(resolution, gone):
    solid = Occupancy.from_boxes([[0.0, 0.0, 0.0]], [[0.6, 0.6, 0.6]], resolution)
    free = Occupancy.from_boxes([[0.1, 0.1, 0.1]], [[0.4, 0.4, 0.4]], 0.1)
    left = solid.without(free)
    assert solid.count - left.count == gone
    assert same(left | solid, solid), "nothing becomes solid"


def test_space_that_a_scene_knows_to_be_free_is_not_solid(tmp_path):
    scene, builds = remembering(slab())
    every = Occupancy.from_scene(scene, resolution=0.1)
    write_points(tmp_path / "free.ply", every.centers()[:40])
    scene.free = FreeSpace(tmp_path / "free.ply", 0.1)
    some = Occupancy.from_scene(scene, resolution=0.1)
    assert len(builds) == 2 and every.count - some.count == 40
    assert not some.contains(every.centers()[:40]).any()


def test_the_backyards_occupancy_is_read_back_from_the_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("SPLATRL_CACHE", str(tmp_path))
    scene = backyard()
    built = Occupancy.from_scene(scene, resolution=0.1)
    assert built.contains([[0.0, 0.0, -0.02], [0.0, -0.4, 0.4]]).tolist() == [True, False]
    monkeypatch.setattr("splatrl.collision.occupancy.solid_voxels", lambda *_: pytest.fail("built again"))
    assert same(Occupancy.from_scene(scene, resolution=0.1), built)


def test_a_grid_above_the_cap_is_refused_with_its_bounds_and_resolution():
    message = r"grid from \[0.0, 0.0, 0.0\] to \[100.1, 0.1, 0.1\] m at a resolution of 0.1 m: expected at most 1000"
    with pytest.raises(ValueError, match=message):
        Occupancy.from_points([[0.01, 0.01, 0.01], [100.01, 0.0, 0.0]], 0.1, max_voxels=1000)
    with pytest.raises(ValueError, match=r"at a resolution of 0.01 m"):
        Occupancy.from_boxes([[0.0, 0.0, 0.0]], [[1e3, 1e3, 1e3]], 0.01)


@pytest.mark.parametrize("resolution", [0.0, -0.1, float("nan"), float("inf")])
def test_a_resolution_that_is_not_a_valid_length_is_refused(resolution):
    with pytest.raises(ValueError, match=r"resolution: expected 0\.0001 to 1000 metres"):
        Occupancy.empty(resolution)
    with pytest.raises(ValueError, match=r"resolution: expected 0\.0001 to 1000 metres"):
        Occupancy.from_points([[0.0, 0.0, 0.0]], resolution)


def test_malformed_arguments_are_refused_by_name():
    with pytest.raises(ValueError, match=r"points: expected finite coordinates, got .* in row 1"):
        Occupancy.from_points([[0.0, 0.0, 0.0], [0.0, float("nan"), 0.0]], 0.1)
    with pytest.raises(ValueError, match=r"points: expected shape \[N, 3\], got \[4, 2\]"):
        Occupancy.from_points(torch.zeros(4, 2), 0.1)
    with pytest.raises(ValueError, match=r"upper: expected .* above lower"):
        Occupancy.from_boxes([[0.0, 0.0, 0.0]], [[1.0, 0.0, 1.0]], 0.1)
    with pytest.raises(ValueError, match="crop: expected a lower corner"):
        Occupancy.from_points([[0.0, 0.0, 0.0]], 0.1, crop=((0, 0, 0), (1, -1, 1)))
    with pytest.raises(ValueError, match=r"keys: expected integers of shape \[M, 3\], got float64"):
        Occupancy.from_keys([[0.5, 0.0, 0.0]], 0.1)
    with pytest.raises(ValueError, match=r"occupied: expected bool \[X, Y, Z\]"):
        Occupancy(np.zeros((2, 2, 2), np.uint8), (0, 0, 0), 0.1)
    with pytest.raises(ValueError, match="origin_key: expected 3 integers"):
        Occupancy(np.zeros((2, 2, 2), bool), (0, 0), 0.1)


def arrays(**changes: Any) -> dict[str, np.ndarray]:
    """Return the saved arrays of a 2 × 2 × 2 occupancy, with some of them replaced, or removed if None."""
    kept = Occupancy(np.ones((2, 2, 2), bool), (0, 0, 0), 0.1).to_arrays()
    return {key: np.array(value) for key, value in {**kept, **changes}.items() if value is not None}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"shape": [1 << 20, 1 << 20, 1 << 20]},
            r"shape: expected at most 67108864 voxels, .*; raise collision.occupancy.max_voxels",
        ),
        ({"shape": [1 << 12] * 3, "occupied_bits": np.zeros(24_000, np.uint8)}, "shape: expected at most"),
        ({"shape": [-2, -2, 2]}, "occupied_bits: expected"),
        ({"shape": 8}, "expected the arrays"),
        ({"shape": [2.5, 2, np.nan]}, "cannot convert"),
        ({"shape": None}, "expected the arrays written by to_arrays, got 'shape'"),
        ({"resolution": 1e-310}, "resolution: expected 0.0001 to 1000 metres"),
        ({"resolution": 1e300}, "resolution: expected 0.0001 to 1000 metres"),
        ({"resolution": [0.1, 0.2]}, "expected the arrays"),
        ({"origin_key": [0, 0, 2**62]}, "origin_key: expected 3 integers"),
        ({"origin_key": [0.5, 0, 0]}, "origin_key: expected 3 integers"),
        ({"origin_key": [np.inf, 0, 0]}, "expected the arrays"),
        ({"origin_key": ["a", "b", "c"]}, ""),
        ({"floaters": [1, 2]}, "expected the arrays"),
    ],
)
def test_saved_arrays_that_are_not_an_occupancy_are_refused(changes: dict[str, Any], message: str) -> None:
    assert Occupancy.from_arrays(arrays()).count == 8
    with pytest.raises(ValueError, match=message):
        Occupancy.from_arrays(arrays(**changes))


def test_the_voxel_limit_also_applies_on_loading() -> None:
    with pytest.raises(ValueError, match="expected at most 7 voxels"):
        Occupancy.from_arrays(arrays(), max_voxels=7)
