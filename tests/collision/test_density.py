import math

import numpy as np
import pytest
import torch
from scipy import ndimage

from splatrl.collision import DensitySettings, Occupancy
from splatrl.geometry import axis_rotations, quats_to_rotations, rotations_to_quats
from splatrl.native._core import add_density
from splatrl.scenes.gaussians import Gaussians
from tests.collision.density_twin import density_of

EVERY_PIECE = DensitySettings(min_volume=0.0)
"""Density settings under which no floater is dropped."""


def gaussians(means, scales, opacities=0.9, quats=(1.0, 0.0, 0.0, 0.0)) -> Gaussians:
    means = torch.as_tensor(means, dtype=torch.float32).reshape(-1, 3)
    count = len(means)
    return Gaussians(
        means=means,
        quats=torch.nn.functional.normalize(torch.as_tensor(quats, dtype=torch.float32).expand(count, 4), dim=1),
        scales=torch.as_tensor(scales, dtype=torch.float32).expand(count, 3).contiguous(),
        opacities=torch.as_tensor(opacities, dtype=torch.float32).expand(count).contiguous(),
        sh=torch.zeros(count, 1, 3),
        batch_size=[count],
    )


def joined(*parts: Gaussians) -> Gaussians:
    return torch.cat(parts)


def sheet(first, second, spacing: float, z: float = 0.0) -> torch.Tensor:
    """Return a horizontal sheet of points."""
    return torch.cartesian_prod(torch.arange(*first, spacing), torch.arange(*second, spacing), torch.tensor([z]))


def brute_force(g: Gaussians, occupancy: Occupancy, cutoff: float) -> np.ndarray:
    """Return the keys of the solid voxels, computed for every voxel of a padded grid."""
    lower = np.array(occupancy.origin_key) - 3
    keys = np.argwhere(np.ones(np.array(occupancy.occupied.shape) + 6, bool)) + lower
    density = density_of(g, (keys + 0.5) * occupancy.resolution, occupancy.resolution)
    return keys[1 - np.exp(-density) >= cutoff]


@pytest.mark.parametrize(("seed", "shape"), [(0, (9, 14, 11)), (1, (17, 6, 8))])
def test_the_density_matches_the_readable_reference(seed: int, shape: tuple[int, int, int]) -> None:
    generator = torch.Generator().manual_seed(seed)
    count = 60
    g = gaussians(
        torch.rand(count, 3, generator=generator) * torch.tensor(shape),
        torch.exp(torch.rand(count, 3, generator=generator) * 5.0 - 4.0),  # 0.02 to 2.7 voxels
        torch.rand(count, generator=generator),
        torch.randn(count, 4, generator=generator),
    )
    means, axes, scales, opacities = (
        values.double().numpy() for values in (g.means, quats_to_rotations(g.quats.double()), g.scales, g.opacities)
    )
    reach = 3.0 * np.sqrt(((axes * scales[:, None]) ** 2).sum(2))
    first, end = np.floor(means - reach).astype(np.int64), np.ceil(means + reach).astype(np.int64)
    density = np.zeros(shape, np.float32)
    add_density(means, axes, scales, opacities, first, end, 3.0, density)
    expected = density_of(g, np.argwhere(np.ones(shape)) + 0.5, 1.0).reshape(shape)
    assert 0.0 < np.median(expected) < expected.max()
    np.testing.assert_allclose(density, expected, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("resolution", [0.05, 0.13])
def test_solid_voxels_match_a_brute_force_sum_over_all_pairs(resolution):
    generator = torch.Generator().manual_seed(3)
    count = 150
    g = gaussians(
        torch.rand(count, 3, generator=generator) * torch.tensor([1.0, 0.6, 0.4]) - 0.3,
        torch.rand(count, 3, generator=generator) * 0.06 + 0.003,
        torch.rand(count, generator=generator) * 0.9 + 0.1,
        torch.randn(count, 4, generator=generator),
    )
    crop = ((-2.0, -2.0, -2.0), (2.0, 2.0, 2.0))
    occupancy = Occupancy.from_gaussians(g, resolution, density=EVERY_PIECE, crop=crop)
    assert 20 < occupancy.count < 0.9 * occupancy.occupied.size
    assert occupancy.keys().tolist() == brute_force(g, occupancy, 0.5).tolist()


@pytest.mark.parametrize("turned", [True, False])
def test_large_thin_gaussians_fill_the_same_voxels_as_a_brute_force_sum(turned):
    generator = torch.Generator().manual_seed(5)
    count = 12
    g = gaussians(
        torch.rand(count, 3, generator=generator) - 0.5,
        10.0 ** (torch.rand(count, 3, generator=generator) * 2.0 - 2.6),  # 2.5 mm to 25 cm
        0.95,
        torch.randn(count, 4, generator=generator) if turned else (1.0, 0.0, 0.0, 0.0),
    )
    recipe = DensitySettings(cutoff=0.02, min_volume=0.0)
    occupancy = Occupancy.from_gaussians(g, 0.05, recipe, crop=((-2,) * 3, (2,) * 3))
    assert occupancy.count > 1000
    assert occupancy.keys().tolist() == brute_force(g, occupancy, 0.02).tolist()


def test_a_wall_is_solid_where_it_stands_and_free_beside_it():
    wall = gaussians(sheet((0.0, 2.0), (0.0, 1.2), 0.04, 0.52), (0.03, 0.03, 0.002))
    occupancy = Occupancy.from_gaussians(wall, 0.05)
    x, y = np.meshgrid(np.arange(0.02, 1.95, 0.01), np.arange(0.02, 1.15, 0.01))
    in_wall, below, above = (
        occupancy.contains(np.stack([x.ravel(), y.ravel(), np.full(x.size, z)], 1)) for z in (0.52, 0.44, 0.61)
    )
    assert in_wall.all()
    assert not below.any()
    assert not above.any()


@pytest.mark.parametrize("axis", [0, 1])
def test_a_slanted_sheet_of_thin_large_gaussians_has_no_hole(axis):
    tilt = axis_rotations(axis, torch.tensor(0.6))
    flat = sheet((-1.0, 1.0), (-0.8, 0.8), 0.1)
    slanted = gaussians(flat @ tilt.T, (0.08, 0.08, 0.001), quats=rotations_to_quats(tilt))
    occupancy = Occupancy.from_gaussians(slanted, 0.05, density=EVERY_PIECE)
    assert occupancy.contains(sheet((-0.9, 0.9), (-0.7, 0.7), 0.007) @ tilt.T).all()


def test_the_inside_of_a_closed_box_of_gaussians_is_free_and_separate_from_the_outside():
    faces = [sheet((0.0, 1.0), (0.0, 1.0), 0.03, z).roll(axis, dims=1) for axis in range(3) for z in (0.0, 0.99)]
    occupancy = Occupancy.from_gaussians(gaussians(torch.cat(faces), 0.015), 0.05)
    free, _ = ndimage.label(np.pad(~occupancy.occupied, 1, constant_values=True))
    middle = np.array(occupancy.occupied.shape) // 2 + 1
    assert not occupancy.contains([[0.5, 0.5, 0.5]])[0]
    assert free[tuple(middle)] not in (0, free[0, 0, 0])


def test_floaters_below_the_minimum_volume_are_dropped_and_larger_things_stay():
    floor = gaussians(sheet((0.0, 1.6), (0.0, 1.1), 0.03), 0.02)
    floater = gaussians([[0.5, 0.4, 0.3]], 0.04)
    ball = gaussians([[0.5, 0.4, 0.7]], 0.2)
    scene = joined(floor, floater, ball)
    every = Occupancy.from_gaussians(scene, density=EVERY_PIECE)
    assert every.contains([[0.5, 0.4, 0.3], [0.5, 0.4, 0.7]]).all()
    kept = Occupancy.from_gaussians(scene)
    assert kept.contains([[0.5, 0.4, 0.02], [0.5, 0.4, 0.3], [0.5, 0.4, 0.7]]).tolist() == [True, False, True]


def test_the_minimum_volume_means_the_same_at_every_resolution():
    rod = gaussians(sheet((0.0, 0.5), (0.0, 0.09), 0.02), 0.01)
    for resolution in (0.025, 0.05, 0.1):
        volume = Occupancy.from_gaussians(rod, resolution, EVERY_PIECE).volume
        below, above = (DensitySettings(min_volume=share * volume) for share in (0.99, 1.01))
        assert Occupancy.from_gaussians(rod, resolution, below).volume == volume
        assert Occupancy.from_gaussians(rod, resolution, above).count == 0


def test_diagonal_neighbours_belong_to_one_component():
    means = [[0.075 + 0.05 * i, 0.075 + 0.05 * i, 0.075 + 0.05 * i] for i in range(10)]
    chain = gaussians(means, 0.002)
    whole = Occupancy.from_gaussians(chain, density=DensitySettings(min_volume=10 * 0.05**3))
    assert whole.keys().tolist() == [[i + 1] * 3 for i in range(10)]


def test_haze_below_the_minimum_opacity_is_free():
    fog = gaussians(sheet((0.0, 1.0), (0.0, 1.0), 0.01), 0.05, opacities=0.09)
    assert Occupancy.from_gaussians(fog).count == 0
    assert Occupancy.from_gaussians(fog, density=DensitySettings(min_opacity=0.05)).count > 0


def test_a_lower_cutoff_makes_more_solid():
    thin = gaussians(sheet((0.0, 1.0), (0.0, 0.7), 0.06), 0.03, opacities=0.3)
    recipes = [DensitySettings(cutoff=cutoff, min_volume=0.0) for cutoff in (0.05, 0.3, 0.6, 0.95)]
    counts = [Occupancy.from_gaussians(thin, density=recipe).count for recipe in recipes]
    assert counts == sorted(counts, reverse=True)
    assert counts[0] > counts[1] > counts[2] > counts[3]


def test_sky_and_stray_gaussians_neither_grow_the_grid_nor_fill_it():
    room = gaussians(
        torch.rand(4000, 3, generator=torch.Generator().manual_seed(0)) * torch.tensor([3.0, 2.0, 0.1]), 0.04
    )
    strays = gaussians([[5e5, 0.0, 0.0], [0.0, -3e6, 0.0], [1.0, 1.0, 8e4], [1e30, 0.0, -1e30]], 0.5)
    sky = gaussians([[1.5, 1.0, 1.0], [1.5, 1.0, 400.0]], (60.0, 80.0, 50.0))
    alone, crowded = Occupancy.from_gaussians(room), Occupancy.from_gaussians(joined(room, strays, sky))
    assert crowded.keys().tolist() == alone.keys().tolist()


def test_gaussians_above_the_scale_limit_are_ignored():
    ball = gaussians([[0.0, 0.0, 0.0]], 1.5)
    assert Occupancy.from_gaussians(ball, 0.2).count > 0  # the default limit is 20 voxels, here 4 m
    assert Occupancy.from_gaussians(ball, 0.05).count == 0
    assert Occupancy.from_gaussians(ball, 0.2, density=DensitySettings(max_scale=1.4)).count == 0


def test_only_what_lies_in_the_crop_is_solid():
    floor = gaussians(sheet((-1.0, 1.0), (-1.0, 1.0), 0.03), 0.02)
    occupancy = Occupancy.from_gaussians(floor, crop=((-0.5, -0.25, -1.0), (0.5, 0.35, 1.0)))
    assert occupancy.bounds[0][:2] == pytest.approx([-0.5, -0.25])
    assert occupancy.bounds[1][:2] == pytest.approx([0.5, 0.35])
    assert Occupancy.from_gaussians(floor, crop=((5, 5, 5), (6, 6, 6))).count == 0


def test_a_single_gaussian_is_solid_up_to_the_radius_of_the_cutoff():
    occupancy = Occupancy.from_gaussians(gaussians([[0.3, -0.2, 0.1]], 0.2), 0.05)  # 0.9 e^(-d²/2) > ln 2: d < 0.72
    assert occupancy.contains([[0.3, -0.2, 0.1], [0.42, -0.2, 0.1], [0.3, -0.2, -0.02]]).all()
    assert not occupancy.contains([[0.51, -0.2, 0.1], [0.3, 0.01, 0.1]]).any()


def test_settings_out_of_range_are_refused_by_name():
    ball = gaussians([[0.0, 0.0, 0.0]], 0.2)
    with pytest.raises(ValueError, match=r"resolution: expected 0\.0001 to 1000 metres, got 0"):
        Occupancy.from_gaussians(ball, 0)
    with pytest.raises(ValueError, match=r"at a resolution of 0.001 m: expected at most 67108864 voxels"):
        Occupancy.from_gaussians(ball, 0.001)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("cutoff", 0.0),
        ("cutoff", 1.0),
        ("min_opacity", -0.1),
        ("min_opacity", math.nan),
        ("min_volume", -1.0),
        ("max_scale", 0.0),
    ],
)
def test_a_density_setting_out_of_range_is_refused_by_name(name, value):
    with pytest.raises(ValueError, match=f"{name}: expected .*, got {value}"):
        DensitySettings(**{name: value})


def test_building_from_pieces_gives_the_same_voxels_as_from_the_whole():
    g = gaussians(torch.rand(4000, 3, generator=torch.Generator().manual_seed(0)) * torch.tensor([3.0, 2.0, 0.1]), 0.04)
    pieces = [lambda rows=rows: g[rows] for rows in (slice(0, 500), slice(500, 1100), slice(1100, 4000))]
    for crop in (None, ((-1.0, -2.0, -1.0), (0.7, 0.33, 3.0))):
        whole, cut = Occupancy.from_gaussians(g, crop=crop), Occupancy.from_pieces(pieces, crop=crop)
        assert np.array_equal(whole.keys(), cut.keys())
        assert whole.count > 100
    assert Occupancy.from_pieces(pieces[:1]).count < Occupancy.from_gaussians(g).count
    assert Occupancy.from_pieces(pieces, crop=((90, 90, 90), (91, 91, 91))).count == 0
    assert Occupancy.from_pieces([lambda: g[:0]]).count == 0
