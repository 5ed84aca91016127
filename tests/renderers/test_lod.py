import math
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from splatrl import backyard
from splatrl.cameras import Cameras, intrinsics, look_at
from splatrl.native import _core
from splatrl.renderers import LatticeRenderer, NativeRenderer
from splatrl.renderers import lod as lod_module
from splatrl.renderers.lod import build_levels, gaussian_arrays
from splatrl.renderers.packed import packed_model
from splatrl.scenes import Gaussians, Scene
from splatrl.scenes.cache import Arrays
from tests.renderers.cases import ahead, ball, dust, gaussians, psnr, random_cameras, random_gaussians


def arrays_of(gaussians: Gaussians) -> dict[str, Tensor]:
    """Return the arguments of ``build_levels``, with axes from the covariances."""
    axes = torch.linalg.cholesky(gaussians.covariances().double()).float().contiguous()
    return {"means": gaussians.means, "axes": axes, "opacities": gaussians.opacities, "sh": gaussians.sh}


def level_views(lower: list[float], upper: list[float], batch: int, size: int = 64) -> Cameras:
    """Return nearly level views, 90 degrees wide, from anywhere in a box."""
    g = torch.Generator().manual_seed(1)
    low, high = torch.tensor(lower), torch.tensor(upper)
    positions = low + torch.rand(batch, 3, generator=g) * (high - low)
    yaws, pitches = 2 * math.pi * torch.rand(batch, generator=g), 0.6 * torch.rand(batch, generator=g) - 0.3
    forward = torch.stack([yaws.cos() * pitches.cos(), yaws.sin() * pitches.cos(), pitches.sin()], 1)
    return Cameras(look_at(positions, positions + forward), intrinsics(math.pi / 2, size, size), size, size)


def psnrs(
    gaussians: Gaussians, cameras: Cameras, tolerance: float, antialiased: bool = True, exact: Tensor | None = None
) -> Tensor:
    """Return the PSNR of each view with level of detail against the exact view, decibels, at most 80."""
    if exact is None:
        exact = NativeRenderer(gaussians, antialiased).render(cameras).rgb
    fast = NativeRenderer(gaussians, antialiased, tolerance=tolerance).render(cameras).rgb
    return torch.tensor([min(80.0, psnr(a[None], b[None])) for a, b in zip(fast, exact, strict=True)])


@pytest.fixture(scope="module")
def yard() -> Gaussians:
    return backyard().gaussians


@pytest.fixture(scope="module")
def levels() -> Arrays:
    return build_levels(arrays_of(random_gaussians(3, 3000, 1)), 1)


def test_every_gaussian_is_in_one_leaf_and_only_inner_nodes_have_an_error(levels: Arrays) -> None:
    assert np.array_equal(np.sort(levels["order"]), np.arange(3000))
    nodes, errors = levels["nodes"].reshape(-1, 4), levels["errors"]
    leaves = nodes[:, 3] == 1
    assert nodes[leaves, 1].sum() == 3000 and leaves.sum() == 12
    assert (nodes[:, 1] <= 256).all() and (nodes[~leaves, 1] > 0).all()
    assert nodes[0, 2] == len(nodes)
    assert (errors[leaves] == 0).all() and (errors[~leaves] > 0).all() and np.isfinite(errors).all()


def thin(count: int = 3000) -> Gaussians:
    """Return needles, 1 to 10 cm long and a micrometre thick."""
    cloud = random_gaussians(3, count, 1)
    cloud.scales = torch.full_like(cloud.scales, 1e-6)
    cloud.scales[:, 0] = torch.linspace(0.01, 0.1, count)
    return cloud


def specked() -> Gaussians:
    """Return Gaussians among specks of a micrometre, far too small to be seen."""
    cloud = random_gaussians(3, 6000, 1)
    cloud.scales[::2] = 2e-6
    return cloud


@pytest.mark.parametrize("scene", [random_gaussians(3, 3000, 1), thin()], ids=["any shape", "needles"])
def test_merging_keeps_mass_mean_and_covariance(scene: Gaussians) -> None:
    arrays = gaussian_arrays(scene)
    levels = build_levels(arrays, 1)
    root = levels["nodes"].reshape(-1, 4)[0]
    kept = slice(root[0], root[0] + root[1])

    def moments(means: Tensor, axes: Tensor, opacities: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        minors = torch.linalg.cross(axes, axes.roll(1, 2), dim=1)
        mass = opacities * (minors.square().sum((1, 2)) / 3).sqrt()
        mean = (mass[:, None] * means).sum(0) / mass.sum()
        offsets = means - mean
        spread = axes @ axes.mT + offsets[:, :, None] * offsets[:, None]
        return mass.sum(), mean, (mass[:, None, None] * spread).sum(0) / mass.sum()

    def merged(name: str, *shape: int) -> Tensor:
        return torch.from_numpy(levels[name]).double().reshape(-1, *shape)[kept]

    below = moments(*(arrays[name].double() for name in ("means", "axes", "opacities")))
    above = moments(merged("means", 3), merged("axes", 3, 3), merged("opacities"))
    for a, b in zip(above, below, strict=True):
        torch.testing.assert_close(a, b, rtol=1e-3, atol=1e-4 if b.ndim > 0 else 0)
    assert merged("sums").sum() == pytest.approx(float(scene.opacities.sum()), rel=1e-4)
    assert merged("members").min() >= 1


@pytest.mark.parametrize("scene", [thin(), specked()], ids=["needles", "specks"])
def test_gaussians_too_thin_to_be_seen_stay_invisible_when_they_are_merged(scene: Gaussians) -> None:
    assert psnrs(scene, random_cameras(4, 3, 48, 40), 0.5).min() >= 40.0


def test_a_tolerance_that_no_node_meets_gives_the_bytes_of_exact_images() -> None:
    scene, cameras = random_gaussians(3, 3000, 2), random_cameras(4, 5, 50, 33)
    exact = NativeRenderer(scene).pixels(cameras)
    assert torch.equal(NativeRenderer(scene, tolerance=1e-7).pixels(cameras), exact)


def test_a_scene_of_one_group_or_none_has_no_levels_to_choose_from() -> None:
    cameras = random_cameras(4, 2)
    for count in (0, 1, 16):
        scene = random_gaussians(3, count)
        at_a_pixel = NativeRenderer(scene, tolerance=1.0).pixels(cameras)
        assert torch.equal(NativeRenderer(scene, tolerance=9.0).pixels(cameras), at_a_pixel)
        assert psnr(at_a_pixel / 255.0, NativeRenderer(scene).pixels(cameras) / 255.0) >= 45.0


@pytest.mark.parametrize("count", [200, 800])
def test_a_small_model_is_shown_by_fewer_gaussians_the_farther_away_it_is(count: int) -> None:
    model, distances = ball(count), [0.5, 1.0, 2.0, 4.0, 8.0, 16.0]
    poses = look_at([[-away, 0.1 * away, 0.2 * away] for away in distances], [0.0, 0.0, 0.0])
    cameras = Cameras(poses, intrinsics(math.pi / 2, 64, 64), 64, 64)
    projected = NativeRenderer(model, tolerance=0.5).efforts(cameras).projected.tolist()
    assert projected == sorted(projected, reverse=True) and projected[-1] == 16
    assert len(set(projected)) >= 4
    assert psnrs(model, cameras, 0.5).min() >= 33.0


def test_a_frame_has_the_same_bytes_in_any_batch_and_order_with_any_threads_and_when_cached(
    yard: Gaussians,
) -> None:
    cameras = level_views([-2, -2, 0.3], [2, 2, 1.0], 9, 44)
    renderer = NativeRenderer(yard, threads=1, tolerance=1.0)
    together = renderer.pixels(cameras)
    order = torch.randperm(9, generator=torch.Generator().manual_seed(0))
    for threads in (2, 3):
        assert torch.equal(NativeRenderer(yard, threads=threads, tolerance=1.0).pixels(cameras[order]), together[order])
    for row in range(9):
        for threads in (1, 4):
            renderer.threads = threads
            assert torch.equal(renderer.pixels(cameras[row : row + 1]), together[row : row + 1])
    remembering = LatticeRenderer(renderer)
    for _ in range(2):
        assert torch.equal(remembering.pixels(cameras[order]), together[order])


@pytest.mark.parametrize(("tolerance", "worst", "mean"), [(0.5, 38.0, 42.0), (1.0, 34.0, 40.0)])
def test_views_of_the_backyard_reach_the_promised_psnr(
    yard: Gaussians, tolerance: float, worst: float, mean: float
) -> None:
    cameras = level_views([-2.7, -2.7, 0.15], [2.7, 2.7, 1.5], 48)
    seen = psnrs(yard, cameras, tolerance)
    assert seen.min() >= worst and seen.mean() >= mean, seen


@pytest.mark.parametrize("size", [32, 160])
def test_the_tolerance_is_in_pixels_of_images_of_any_size(yard: Gaussians, size: int) -> None:
    seen = psnrs(yard, level_views([-2.5, -2.5, 0.2], [2.5, 2.5, 1.2], 12, size), 0.5)
    assert seen.min() >= 36.0, seen


@pytest.mark.parametrize("isa", _core.supported_isas())
def test_every_instruction_set_draws_the_same_level_of_detail(
    yard: Gaussians, isa: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    cameras = level_views([-2.5, -2.5, 0.2], [2.5, 2.5, 1.2], 4, 48)
    fastest = NativeRenderer(yard, tolerance=1.0).render(cameras)
    monkeypatch.setenv("SPLATRL_ISA", isa)
    assert psnr(NativeRenderer(yard, tolerance=1.0).render(cameras).rgb, fastest.rgb) >= 75.0


def test_with_a_tolerance_the_splat_that_saturates_a_pixel_is_blended_and_none_behind_it() -> None:
    sheets = gaussians([[1.0, 0.0, 0.0], [2.0, 0.0, 0.0], [3.0, 0.0, 0.0]], scale=50.0, opacity=0.995)

    def alpha(tolerance: float, count: int) -> float:
        return float(NativeRenderer(sheets[:count], tolerance=tolerance).render(ahead(9, 6)).alpha[0, 3, 4])

    assert alpha(0.0, 3) == pytest.approx(0.995, abs=1e-4)  # the second sheet would leave less than 0.0001
    assert alpha(1.0, 3) == pytest.approx(1 - 0.005**2, abs=5e-6)
    assert alpha(1.0, 3) == alpha(1.0, 2)


def deep_cloud(opacity: float) -> Gaussians:
    """Return sixty thousand small Gaussians 3 to 9 m ahead, behind two sheets of this opacity at 1 m."""
    g = torch.Generator().manual_seed(0)
    sheets = gaussians([[1.0, 0.0, 0.0], [1.1, 0.0, 0.0]], scale=50.0, opacity=opacity)
    cloud = gaussians([[6.0, 0.0, 0.0]], scale=0.01, opacity=0.5).expand(60_000).clone().float()
    cloud.means += (torch.rand(60_000, 3, generator=g) - 0.5) * torch.tensor([6.0, 5.0, 5.0])
    cloud.sh += torch.randn(60_000, 1, 3, generator=g)
    return torch.cat([sheets.float(), cloud])


def test_gaussians_behind_a_veil_are_drawn_with_less_detail_and_look_the_same() -> None:
    def effort(cloud: Gaussians) -> int:
        return int(NativeRenderer(cloud, tolerance=0.5).efforts(ahead(64, 64)).projected)

    veiled, clear = deep_cloud(0.9), effort(deep_cloud(0.1))
    assert effort(deep_cloud(0.2)) == pytest.approx(clear, rel=0.01)  # more than half of the light comes through
    assert effort(veiled) < 0.6 * clear
    assert psnrs(veiled, ahead(64, 64), 0.5).min() >= 50.0


def test_a_frame_drawn_in_steps_has_the_same_bytes_with_any_threads_and_in_any_batch() -> None:
    cloud, turns = deep_cloud(0.9), torch.tensor([-0.3, 0.0, 0.4])
    forward = torch.stack([turns.cos(), turns.sin(), torch.zeros(3)], 1)
    cameras = Cameras(look_at(torch.zeros(3, 3), forward), intrinsics(1.2, 96, 60), 96, 60)
    renderer = NativeRenderer(cloud, threads=1, tolerance=0.5)
    together, depth = renderer.pixels(cameras), renderer.render(cameras).depth
    for threads in (1, 2, 3, 8):
        alone = NativeRenderer(cloud, threads=1, tolerance=0.5)
        alone.threads = threads
        for row in range(3):
            assert torch.equal(alone.pixels(cameras[row : row + 1]), together[row : row + 1])
            assert torch.equal(alone.render(cameras[row : row + 1]).depth, depth[row : row + 1])


@pytest.mark.parametrize("isa", _core.supported_isas())
def test_every_instruction_set_draws_the_same_behind_a_veil(isa: str, monkeypatch: pytest.MonkeyPatch) -> None:
    cloud = deep_cloud(0.9)
    fastest = NativeRenderer(cloud, tolerance=0.5).render(ahead(64, 64)).rgb
    monkeypatch.setenv("SPLATRL_ISA", isa)
    assert psnr(NativeRenderer(cloud, tolerance=0.5).render(ahead(64, 64)).rgb, fastest) >= 60.0


@pytest.mark.parametrize("tolerance", [0.0, 0.5])
def test_depths_a_tenth_of_a_millimetre_apart_are_told_apart(tolerance: float) -> None:
    means = [[3.03, 0.0, 0.0], [3.0301, 0.0, 0.0]]
    sheets = gaussians(means, [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], scale=[0.01, 2.0, 2.0], opacity=0.9)
    renderer = NativeRenderer(sheets, tolerance=tolerance)
    for eye, nearer in ((0.0, 0), (6.0, 2)):
        cameras = Cameras(look_at([eye, 0.0, 0.0], [3.0, 0.0, 0.0])[None], intrinsics(1.0, 9, 9), 9, 9)
        pixel = renderer.render(cameras).rgb[0, 4, 4]
        assert pixel[nearer] > 0.8 > pixel[2 - nearer]


@pytest.mark.parametrize(
    ("tolerance", "antialiased", "levels"), [(0, True, 0.25), (0.5, True, 1), (9, True, 1), (1, False, 1)]
)
def test_splats_fade_out_at_one_grey_level_with_a_tolerance_and_at_a_quarter_without(
    tolerance: float, antialiased: bool, levels: float
) -> None:
    disc = gaussians([[2.0, 0.0, 0.0]], scale=0.3, opacity=0.5)
    alpha = NativeRenderer(disc, antialiased, tolerance=tolerance).render(ahead(90, 90)).alpha
    faintest = float(alpha[alpha > 0].min())
    assert levels / 255 <= faintest < 1.2 * levels / 255


def test_more_tolerance_draws_fewer_gaussians(yard: Gaussians) -> None:
    cameras = level_views([-2.5, -2.5, 0.2], [2.5, 2.5, 1.2], 6)
    counts = [int(NativeRenderer(yard, tolerance=t).efforts(cameras).projected.sum()) for t in (0.0, 0.3, 0.6, 1.2)]
    assert counts == sorted(counts, reverse=True) and counts[3] < 0.8 * counts[0]


@pytest.mark.parametrize("antialiased", [False, True])
@pytest.mark.parametrize("unit", [2.0**-6, 2.0**24])
def test_level_of_detail_is_the_same_in_any_unit(unit: float, antialiased: bool) -> None:
    """Merged Gaussians are stored as half floats, whose range is smaller than that of lengths."""
    pixels = []
    for scale in (1.0, unit):
        cloud = random_gaussians(3, 3000, 1)
        cloud.means *= scale
        cloud.scales *= scale
        poses = look_at([[6.0 * scale, 1.0 * scale, 0.5 * scale]], [0.0, 0.0, 0.0])
        cameras = Cameras(poses, intrinsics(1.2, 64, 64), 64, 64)
        pixels.append(NativeRenderer(cloud, antialiased, tolerance=12.0).pixels(cameras))
    assert torch.equal(*pixels) and pixels[0].float().std() > 20


def test_the_error_of_a_node_includes_how_far_rounding_moves_its_means() -> None:
    """Half floats are relative to the centre of a group, which is far from most members if one of them is far away."""
    cloud = random_gaussians(5, 300)
    cloud.means *= 0.02
    cloud.means[::100] += torch.tensor([40000.0, -30000.0, 500.0])
    levels = build_levels(arrays_of(cloud), 0)
    packed = packed_model(cloud, True, (0.0, 0.0, 0.0), True)
    records = packed["merged"]
    headers = np.ascontiguousarray(records[:, :16]).view(np.float32)
    halves = np.ascontiguousarray(records[:, 32:128]).view(np.float16).reshape(-1, 3, 16).astype(np.float64)
    means = (headers[:, :3, None] + headers[:, 3:, None] * halves).swapaxes(1, 2)  # [M, 16, 3]
    most = 0.0
    for node, (first, groups, _), error in zip(
        levels["nodes"].reshape(-1, 4), packed["nodes"], packed["errors"], strict=True
    ):
        if node[3] == 1:
            continue
        at = first - len(packed["geometry"])
        kept = means[at : at + groups].reshape(-1, 3)[: node[1]]
        moved = np.linalg.norm(kept - levels["means"].reshape(-1, 3)[node[0] : node[0] + node[1]], axis=1).max()
        assert error >= 0.999 * moved
        most = max(most, moved)
    assert most > 0.05


def test_classic_images_are_held_to_a_stricter_tolerance(yard: Gaussians) -> None:
    cameras = level_views([-2.5, -2.5, 0.2], [2.5, 2.5, 1.2], 12)
    seen = psnrs(yard, cameras, 0.5, antialiased=False)
    assert seen.min() >= 28.0 and seen.mean() >= 32.0, seen
    counts = [NativeRenderer(yard, kind, tolerance=0.5).efforts(cameras).projected.sum() for kind in (False, True)]
    assert counts[0] > 1.2 * counts[1]


def test_views_of_a_real_kitchen_reach_the_promised_psnr(kitchen: Gaussians) -> None:
    cameras = level_views([-0.8, -0.5, 0.6], [0.8, 0.5, 1.5], 64)
    exact = NativeRenderer(kitchen).render(cameras).rgb
    for tolerance, worst, mean in ((0.5, 38.0, 42.0), (1.0, 34.0, 40.0)):
        seen = psnrs(kitchen, cameras, tolerance, exact=exact)
        assert seen.min() >= worst and seen.mean() >= mean, (tolerance, seen)


def test_levels_are_built_once_for_a_scene_and_then_read_from_the_cache(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SPLATRL_CACHE", str(tmp_path))
    scene = Scene("cloud", random_gaussians(5, 2000, 1), ((-1, -1, -1), (1, 1, 1)))
    cameras = random_cameras(4, 3)
    built = NativeRenderer(scene, tolerance=0.7).pixels(cameras)
    assert torch.equal(NativeRenderer(scene.gaussians, tolerance=0.7).pixels(cameras), built)

    def refuse(*_: object) -> Arrays:
        raise AssertionError("built again")

    monkeypatch.setattr(lod_module, "build_levels", refuse)
    assert torch.equal(NativeRenderer(scene, tolerance=0.7).pixels(cameras), built)
    assert [path.name.split("-")[0] for path in tmp_path.iterdir()] == ["levels"]


@pytest.mark.parametrize(
    ("name", "index", "value"),
    [
        ("order", 0, 10_000),
        ("nodes", 1, 10_000),
        ("nodes", 0, 99_999),
        ("nodes", 2, 0),
        ("nodes", 2, 10_000),
        ("errors", 0, 0),
    ],
)
def test_levels_that_are_no_valid_tree_of_the_model_are_refused(
    levels: Arrays, name: str, index: int, value: int
) -> None:
    bad = {key: values.copy() for key, values in levels.items()}
    bad[name][index] = value
    renderer = _core.Renderer(True, (0, 0, 0), 1.0)
    with pytest.raises(ValueError, match="levels: expected a tree"):
        renderer.add_model(0, **arrays_of(random_gaussians(3, 3000, 1)), degree=1, levels=bad)
    with pytest.raises(ValueError, match="levels"):
        renderer.add_model(0, **arrays_of(random_gaussians(3, 2000, 1)), degree=1, levels=levels)


@pytest.mark.parametrize("tolerance", [-0.1, math.inf, math.nan])
def test_a_negative_or_non_finite_tolerance_is_refused(tolerance: float) -> None:
    with pytest.raises(ValueError, match="tolerance: expected a finite number of pixels"):
        NativeRenderer(random_gaussians(0, 3), tolerance=tolerance)


@pytest.mark.parametrize("antialiased", [False, True])
@pytest.mark.parametrize(("opacity", "scale"), [(0.9, 1e-4), (0.5, 1e-3), (0.02, 1e-3)])
def test_merged_dust_is_not_cut_off_at_the_edges_of_tiles(antialiased: bool, opacity: float, scale: float) -> None:
    scene = dust(0, opacity, scale)
    whole, cut = (NativeRenderer(scene, antialiased, tolerance=64.0, threads=threads) for threads in (1, 16))
    for k in range(8):
        pose = look_at([0.0, 0.0, 0.0], [20.0, (-1) ** k * k * 0.35, k * 0.33])[None]
        cameras = Cameras(pose, intrinsics(math.pi / 2, 64, 64), 64, 64)
        assert torch.equal(whole.pixels(cameras), cut.pixels(cameras))
