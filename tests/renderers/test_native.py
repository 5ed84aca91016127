import math
from collections.abc import Iterable

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from splatrl.cameras import Cameras, intrinsics, look_at
from splatrl.native import _core
from splatrl.renderers import NativeRenderer, ReferenceRenderer, RenderOutput, native
from splatrl.renderers.base import to_pixels
from splatrl.scenes import Gaussians, similarity
from splatrl.waits import Bar, late_bar
from tests.renderers.cases import LIKENESS, ahead, double, gaussians, psnr, random_cameras, random_gaussians


def assert_alike(fast: RenderOutput, reference: RenderOutput) -> None:
    assert psnr(fast.rgb, reference.rgb) >= LIKENESS
    assert psnr(fast.alpha, reference.alpha) >= LIKENESS
    covered = reference.alpha > 0.05  # mean depth is unstable where almost nothing is blended
    errors = ((fast.depth - reference.depth).abs() / reference.depth)[covered]
    few = errors.numel() < 64  # all may see something right before the camera, where rounding is a larger part
    assert errors.numel() == 0 or errors.mean() < (1e-3 if few else 1e-4)


@settings(max_examples=30)
@given(
    seed=st.integers(0, 10_000),
    count=st.integers(1, 700),
    degree=st.integers(0, 3),
    antialiased=st.booleans(),
    size=st.tuples(st.integers(1, 40), st.integers(1, 40)),
    background=st.tuples(*[st.floats(0, 1)] * 3),
)
def test_any_scene_and_camera_look_like_the_reference(
    seed: int,
    count: int,
    degree: int,
    antialiased: bool,
    size: tuple[int, int],
    background: tuple[float, float, float],
) -> None:
    scene, cameras = random_gaussians(seed, count, degree), random_cameras(seed + 1, 2, *size)
    fast = NativeRenderer(scene, antialiased, background).render(cameras)
    assert_alike(fast, ReferenceRenderer(double(scene), antialiased, background).render(cameras))


@pytest.mark.parametrize("isa", _core.supported_isas())
@pytest.mark.parametrize("antialiased", [False, True])
def test_every_instruction_set_draws_images_like_the_reference(
    isa: str, antialiased: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SPLATRL_ISA", isa)
    assert _core.isa() == isa
    scene, cameras = random_gaussians(1, 900, 3), random_cameras(2, 4, 70, 45)
    fast = NativeRenderer(scene, antialiased).render(cameras)
    assert_alike(fast, ReferenceRenderer(double(scene), antialiased).render(cameras))


def test_an_unknown_instruction_set_is_refused_with_the_choices(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SPLATRL_ISA", "mmx")
    with pytest.raises(ValueError, match=r"SPLATRL_ISA: expected one of portable.* on this processor, got mmx"):
        NativeRenderer(gaussians([[1.0, 0.0, 0.0]]))


def test_a_frame_has_the_same_bytes_alone_and_in_any_batch_and_order_with_any_threads() -> None:
    scene, cameras = random_gaussians(3, 2000, 2), random_cameras(4, 11, 50, 33)
    renderer = NativeRenderer(scene, threads=1)
    together, views = renderer.pixels(cameras), renderer.render(cameras)
    order = torch.randperm(11, generator=torch.Generator().manual_seed(0))
    for threads in (1, 2, 5):
        others = NativeRenderer(scene, threads=threads)
        assert torch.equal(others.pixels(cameras[order]), together[order])
        assert all(torch.equal(a, b[order]) for a, b in zip(others.render(cameras[order]), views, strict=True))
    for row in range(11):
        assert torch.equal(renderer.pixels(cameras[row : row + 1]), together[row : row + 1])


@pytest.mark.parametrize(("width", "height"), [(33, 41), (150, 70), (64, 3)])
def test_a_few_frames_are_split_into_tiles_for_the_threads_and_have_the_same_bytes(width: int, height: int) -> None:
    scene, cameras = random_gaussians(3, 2000, 2), random_cameras(4, 2, width, height)
    renderer = NativeRenderer(scene, threads=1)
    whole, view = renderer.pixels(cameras), renderer.render(cameras)
    for threads in (2, 3, 8, 50):
        cut = NativeRenderer(scene, threads=threads)
        assert torch.equal(cut.pixels(cameras), whole)
        assert all(torch.equal(a, b) for a, b in zip(cut.render(cameras[1:]), [v[1:] for v in view], strict=True))


def test_large_images_look_like_the_reference() -> None:
    scene, cameras = random_gaussians(3, 400, 1), random_cameras(8, 1, 300, 170)
    assert_alike(NativeRenderer(scene).render(cameras), ReferenceRenderer(double(scene)).render(cameras))


def test_the_reference_is_as_accurate_far_from_the_origin_in_single_precision() -> None:
    scene, cameras = random_gaussians(3, degree=3), random_cameras(4)
    scene.means += torch.tensor([500_000.0, -500_000.0, 400.0])
    cameras.camera_to_world[:, :3, 3] += torch.tensor([500_000.0, -500_000.0, 400.0])
    reference = ReferenceRenderer(scene).render(cameras)
    assert psnr(reference.rgb, ReferenceRenderer(double(scene)).render(cameras).rgb) > 90
    assert_alike(NativeRenderer(scene).render(cameras), reference)


def test_pixels_are_drawn_into_the_tensor_that_is_given() -> None:
    renderer, cameras = NativeRenderer(random_gaussians(3, 300)), random_cameras(4, 3)
    out = torch.zeros(5, 22, 37, 3, dtype=torch.uint8)
    assert renderer.pixels(cameras, out=out[1:4]).data_ptr() == out[1:].data_ptr()
    assert torch.equal(out[1:4], renderer.pixels(cameras))
    assert not out[0].any() and not out[4].any()


@pytest.mark.parametrize(
    "out",
    [
        torch.zeros(2, 22, 37, 3, dtype=torch.uint8),
        torch.zeros(3, 22, 37, 3),
        torch.zeros(3, 37, 22, 3, dtype=torch.uint8).transpose(1, 2),
    ],
)
def test_a_tensor_that_pixels_cannot_be_drawn_into_is_refused(out: torch.Tensor) -> None:
    with pytest.raises(ValueError, match=r"out: expected \(3, 22, 37, 3\) torch.uint8 on cpu, contiguous, got"):
        NativeRenderer(random_gaussians(3, 300)).pixels(random_cameras(4, 3), out=out)


def test_efforts_count_visible_projected_and_blended_gaussians() -> None:
    scene = gaussians([[2.0, 0.0, 0.0], [3.0, 0.3, 0.0], [-2.0, 0.0, 0.0]], scale=0.01)
    effort = NativeRenderer(scene, threads=1).efforts(ahead())
    assert effort.visible.tolist() == [2] and effort.projected.tolist() == [16]  # sixteen are projected at a time
    assert 2 <= effort.blended.item() <= 8
    assert all((stage > 0).all() for stage in (effort.project_ms, effort.sort_ms, effort.blend_ms))


@pytest.mark.parametrize("antialiased", [False, True])
@pytest.mark.parametrize("size", [1e6, 1e18, 1e30])
def test_absurdly_large_positions_and_scales_give_finite_images(size: float, antialiased: bool) -> None:
    scene = random_gaussians(7, 900, 1)
    scene.means[::3] *= size
    scene.scales[1::3] *= size
    for tolerance in (0.0, 1.0):
        view = NativeRenderer(scene, antialiased, tolerance=tolerance).render(random_cameras(4, 6, 70, 45))
        assert view.rgb.isfinite().all() and view.alpha.isfinite().all()


def test_a_frame_does_not_depend_on_the_sizes_that_were_rendered_before() -> None:
    scene, cameras = random_gaussians(3, 500), random_cameras(4, 2, 50, 33)
    renderer = NativeRenderer(scene)
    before = renderer.pixels(cameras)
    for width, height in ((5, 9), (130, 140), (1, 1)):
        renderer.pixels(random_cameras(4, 2, width, height))
    assert torch.equal(renderer.pixels(cameras), before)


def test_pixels_are_the_rounded_colours_of_render() -> None:
    renderer = NativeRenderer(random_gaussians(5, 800, 1), background=(0.3, 0.6, 0.9))
    cameras = random_cameras(6, 3, 61, 35)
    assert torch.equal(renderer.pixels(cameras), to_pixels(renderer.render(cameras).rgb))


def test_more_gaussians_on_a_block_of_pixels_than_one_slab_holds_are_all_blended() -> None:
    count = 3000  # each covers all 35 · 25 blocks: more pairs than are binned at once
    g = torch.Generator().manual_seed(0)
    means = torch.cat([1 + torch.rand(count, 1, generator=g), 0.1 * torch.randn(count, 2, generator=g)], 1)
    scene = gaussians(means.tolist(), torch.rand(count, 3, generator=g).tolist(), 3.0, opacity=0.005)
    cameras = ahead(140, 100, 60.0)
    assert_alike(NativeRenderer(scene).render(cameras), ReferenceRenderer(scene).render(cameras))


@pytest.mark.parametrize("run", [2, 3, 600])
def test_gaussians_of_equal_depth_are_blended_in_the_order_of_the_scene(run: int) -> None:
    g = torch.Generator().manual_seed(1)
    offsets = 0.3 * torch.randn(600, 2, generator=g)
    depths = 2.0 + 0.001 * (torch.arange(600) // run).unsqueeze(1)
    means = torch.cat([depths, offsets], 1)[torch.randperm(600, generator=g)]
    scene = gaussians(means.tolist(), torch.rand(600, 3, generator=g).tolist(), scale=0.2, opacity=0.3)
    cameras = ahead()
    assert psnr(NativeRenderer(scene).render(cameras).rgb, ReferenceRenderer(scene).render(cameras).rgb) > LIKENESS


@pytest.mark.parametrize("isa", _core.supported_isas())
def test_splats_of_every_size_show_on_all_pixels_that_they_touch(isa: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SPLATRL_ISA", isa)
    g = torch.Generator().manual_seed(2)
    for scale in (0.01, 0.03, 0.06, 0.1, 0.2, 0.5):  # from one block of 4×4 pixels to more than 4×4 blocks
        means = torch.cat([torch.full((6, 1), 2.0), 0.8 * torch.randn(6, 2, generator=g)], 1)
        for mean, across, down in zip(means.tolist(), (1, 1, 0.2, 5, 1, 3), (1, 4, 1, 1, 0.3, 1), strict=True):
            scene = gaussians([mean], scale=[scale, scale * across, scale * down])
            fast, reference = (made(scene).render(ahead(64, 64)) for made in (NativeRenderer, ReferenceRenderer))
            assert psnr(fast.alpha, reference.alpha) >= LIKENESS


@pytest.mark.parametrize("isa", _core.supported_isas())
@pytest.mark.parametrize("faint", [0, 1, 2, 3])
def test_in_exact_images_the_splat_that_would_saturate_a_pixel_is_left_out(
    isa: str, faint: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SPLATRL_ISA", isa)
    sheets = gaussians([[1.0 + 0.1 * i, 0.0, 0.0] for i in range(faint + 3)], scale=50.0, opacity=0.995)
    sheets.opacities[:faint] = 0.01
    sheets.opacities[-1] = 0.5  # lies behind the sheet that finishes the pixel
    alpha = NativeRenderer(sheets).render(ahead(9, 6)).alpha[0, 3, 4]
    assert float(alpha) == pytest.approx(1 - 0.99**faint * 0.005, abs=1e-4)


def test_the_alpha_of_a_splat_is_capped_at_its_maximum() -> None:
    for opacity in (0.998, 0.999, 1.0):
        sheet = gaussians([[1.0, 0.0, 0.0]], scale=50.0, opacity=opacity)
        alpha = NativeRenderer(sheet).render(ahead(9, 6)).alpha
        assert alpha.flatten().tolist() == pytest.approx([min(opacity, 0.999)] * 54, abs=1e-4)


def test_an_opaque_splat_changes_nothing_outside_the_pixels_that_it_covers() -> None:
    g = torch.Generator().manual_seed(3)
    means = torch.cat([1.5 + torch.rand(300, 1, generator=g), 0.4 + 0.2 * torch.randn(300, 2, generator=g)], 1)
    scene = gaussians(means.tolist(), torch.rand(300, 3, generator=g).tolist(), 0.05)
    scene.opacities = 0.2 + 0.79 * torch.rand(300, generator=g, dtype=torch.float64)
    opaque = gaussians([[1.0, -0.9, 0.0]], scale=0.1, opacity=1.0)
    both: Gaussians = torch.cat([scene, opaque])  # type: ignore[assignment]
    alone, beside = (NativeRenderer(shown).render(ahead(64, 48)) for shown in (scene, both))
    assert torch.equal(alone.rgb[:, :, :48], beside.rgb[:, :, :48]) and alone.rgb[:, :, :48].any()
    assert not torch.equal(alone.rgb[:, :, 48:], beside.rgb[:, :, 48:])


@pytest.mark.parametrize(
    ("name", "scene"),
    [
        ("dust", gaussians([[1.0, 0.0, 0.0]], scale=1e-6)),
        ("dust at the lens", gaussians([[0.011, 0.0, 0.0]], scale=1e-4)),
        ("a planet", gaussians([[1.0, 0.0, 0.0]], scale=1e3)),
        ("a planet beside the camera", gaussians([[0.02, 300.0, 0.0]], scale=1e3)),
        ("a needle along the line of sight", gaussians([[3.0, 0.1, 0.0]], scale=[10.0, 1e-4, 1e-4])),
        ("a needle across the line of sight", gaussians([[3.0, 0.0, 0.1]], scale=[1e-4, 10.0, 1e-4])),
        ("a tilted needle", gaussians([[2.0, 0.0, 0.0]], scale=[1e-5, 5.0, 1e-3]).transformed(similarity())),
        ("a wall of opacity one", gaussians([[1.0, 0.0, 0.0]], scale=2.0, opacity=1.0)),
        ("almost invisible", gaussians([[1.0, 0.0, 0.0]], scale=2.0, opacity=1.001 / 255)),
        ("invisible", gaussians([[1.0, 0.0, 0.0]], scale=2.0, opacity=0.0)),
    ],
)
@pytest.mark.parametrize("antialiased", [False, True])
def test_extreme_gaussians_look_like_the_reference(name: str, scene: Gaussians, antialiased: bool) -> None:
    cameras = Cameras(
        torch.stack([look_at([0.0, 0.0, 0.0], [1.0, 0.0, 0.0]), look_at([0.0, 0.1, 0.1], [1.0, 0.3, 0.4])]),
        intrinsics(1.4, 45, 30),
        45,
        30,
    )
    fast = NativeRenderer(scene, antialiased).render(cameras)
    reference = ReferenceRenderer(scene, antialiased).render(cameras)
    assert all(value.isfinite().all() for value in fast), name
    assert psnr(fast.rgb, reference.rgb) >= LIKENESS, name


def test_a_camera_that_sees_nothing_shows_the_background() -> None:
    renderer = NativeRenderer(gaussians([[-2.0, 0.0, 0.0]]), background=(0.0, 0.5, 1.0))
    view = renderer.render(ahead(9, 6))
    assert torch.equal(view.rgb, torch.tensor([0.0, 0.5, 1.0]).expand(1, 6, 9, 3))
    assert not view.alpha.any() and not view.depth.any()
    assert renderer.efforts(ahead(9, 6)).visible.tolist() == [0]
    assert renderer.pixels(ahead(9, 6))[0, 0, 0].tolist() == [0, 128, 255]


def test_an_empty_batch_gives_no_images() -> None:
    cameras = random_cameras(0)[:0]
    renderer = NativeRenderer(gaussians([[1.0, 0.0, 0.0]]))
    assert renderer.pixels(cameras).shape == (0, 22, 37, 3)
    assert renderer.render(cameras).depth.shape == (0, 22, 37)


def test_large_gaussians_beside_the_image_are_not_culled_by_their_centre() -> None:
    scene = gaussians([[1.0, 3.0, 0.0], [0.5, 0.0, -4.0]], scale=1.5)
    view = NativeRenderer(scene).render(ahead())
    assert view.alpha.max() > 0.1
    assert_alike(view, ReferenceRenderer(scene).render(ahead()))


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_camera_that_is_not_finite_is_refused_by_its_row(bad: float) -> None:
    renderer = NativeRenderer(gaussians([[1.0, 0.0, 0.0]]))
    cameras = random_cameras(0, 4)
    poses, K = cameras.camera_to_world.clone(), cameras.K.clone()
    poses[2, 0, 3] = bad
    K[1, 0, 0] = bad
    with pytest.raises(ValueError, match=r"camera_to_world\[2\]: expected finite"):
        renderer.pixels(Cameras(poses, cameras.K, 37, 22))
    with pytest.raises(ValueError, match=r"K\[1\]: expected finite"):
        renderer.render(Cameras(cameras.camera_to_world, K, 37, 22))


def test_a_focal_length_that_is_not_positive_is_refused_by_its_row() -> None:
    cameras = random_cameras(0, 3)
    K = cameras.K.clone()
    K[2, 1, 1] = 0.0
    with pytest.raises(ValueError, match=r"K\[2\]"):
        NativeRenderer(gaussians([[1.0, 0.0, 0.0]])).pixels(Cameras(cameras.camera_to_world, K, 37, 22))


def test_wrong_settings_are_refused_by_name() -> None:
    scene = random_gaussians(0, 3)
    with pytest.raises(ValueError, match="threads: expected a whole number of at least 1"):
        NativeRenderer(scene, threads=0)
    with pytest.raises(ValueError, match="background"):
        NativeRenderer(scene, background=(0.0, 0.0, 1.5))
    scene.scales[1, 2] = math.nan
    with pytest.raises(ValueError, match=r"gaussians\.scales\[1\]"):
        NativeRenderer(scene)


@pytest.mark.parametrize("antialiased", [pytest.param(False, marks=pytest.mark.slow), True])
def test_views_of_a_real_kitchen_look_like_the_reference(kitchen: Gaussians, antialiased: bool) -> None:
    positions = torch.tensor([[0.0, 0.0, 1.05], [0.7, -0.3, 1.05], [-0.6, 0.4, 0.9]])
    targets = positions + torch.tensor([[1.0, 0.2, 0.0], [-0.5, 1.0, -0.1], [0.1, -1.0, -0.4]])
    cameras = Cameras(look_at(positions, targets), intrinsics(math.pi / 2, 24, 17), 24, 17)
    fast = NativeRenderer(kitchen, antialiased).render(cameras)
    assert fast.alpha.mean() > 0.3
    reference = ReferenceRenderer(double(kitchen), antialiased).render(cameras)
    assert psnr(fast.rgb, reference.rgb) >= 75
    assert_alike(fast, reference)


def test_the_models_of_many_scenes_are_counted_on_a_bar_if_that_takes_long(monkeypatch: pytest.MonkeyPatch) -> None:
    bars = list[Bar]()

    def bar(what: str, total: int, unit: str, counted: Iterable[None]) -> Bar:
        bars.append(late_bar(what, total, unit, counted))
        return bars[-1]

    monkeypatch.setattr(native, "late_bar", bar)
    NativeRenderer([random_gaussians(seed, 20) for seed in range(3)])
    assert [(one.desc, one.n, one.total) for one in bars] == [("models to draw", 3, 3)]
