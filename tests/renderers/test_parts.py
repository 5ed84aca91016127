"""Placed models are drawn into one image as if they were one scene."""

import pytest
import torch

from splatrl.cameras import Cameras
from splatrl.native import _core
from splatrl.renderers import ABSENT, NativeRenderer, Parts, ReferenceRenderer, Renderer
from splatrl.renderers.native import in_models
from splatrl.renderers.parts import camera_to_models
from tests.renderers.cases import LIKENESS, ahead, double, gaussians, psnr, random_cameras, random_gaussians
from tests.renderers.parts_cases import (
    BACKGROUND,
    IDENTITY,
    MAKERS,
    Maker,
    assert_like,
    assert_same_bytes,
    at,
    drawn_in_world,
    in_world,
    make_native,
    make_reference,
    placed,
    random_models,
    random_parts,
    random_poses,
    walls,
)

every_maker = pytest.mark.parametrize("maker", MAKERS.values(), ids=MAKERS)


def images(renderer: Renderer, cameras: Cameras, parts: Parts | None = None) -> list[torch.Tensor]:
    """Return everything that a renderer draws: pixels, rgb, depth and alpha."""
    return [renderer.pixels(cameras, parts), *renderer.render(cameras, parts)]


def assert_equal(some: list[torch.Tensor], others: list[torch.Tensor]) -> None:
    assert all(torch.equal(a, b) for a, b in zip(some, others, strict=True))


@every_maker
@pytest.mark.parametrize("antialiased", [False, True])
@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_parts_look_like_their_gaussians_moved_to_the_world(maker: Maker, degree: int, antialiased: bool) -> None:
    models, cameras, parts = random_models([degree] * 3), random_cameras(31, 4, 45, 28), random_parts(32, 4)
    renderer = maker.make(models, antialiased)
    expected, pixels = drawn_in_world(lambda model: maker.make(model, antialiased), models, cameras, parts)
    assert_like(renderer.render(cameras, parts), expected, maker.rgb)
    assert_same_bytes(renderer.pixels(cameras, parts), pixels, maker.turned_share if degree else maker.share)


@every_maker
@pytest.mark.parametrize("degree", [1, 3])
def test_parts_that_are_not_rotated_differ_in_at_most_one_byte_in_ten_thousand(maker: Maker, degree: int) -> None:
    """Only rotated harmonics, which a renderer may store rounded, may make more bytes differ."""
    models, cameras, parts = random_models([degree] * 3), random_cameras(31, 4, 45, 28), random_parts(32, 4)
    parts.model_to_world[..., :3, :3] = torch.eye(3)
    expected, pixels = drawn_in_world(lambda model: maker.make(model), models, cameras, parts)
    assert_like(maker.make(models).render(cameras, parts), expected, maker.rgb)
    assert_same_bytes(maker.make(models).pixels(cameras, parts), pixels, maker.share)


@every_maker
def test_one_part_that_is_not_moved_has_the_same_bytes_as_the_scene_itself(maker: Maker) -> None:
    models, cameras = random_models([1, 2, 3]), random_cameras(31, 4)
    renderer = maker.make(models)
    assert_equal(images(renderer, cameras, placed(4, (0, IDENTITY))), images(renderer, cameras))
    assert_equal(images(maker.make(models[:1]), cameras), images(renderer, cameras))
    second = images(renderer, cameras, placed(4, (ABSENT, torch.full((4, 4), torch.nan)), (1, IDENTITY)))
    assert_equal(second, images(maker.make(models[1:]), cameras))


@every_maker
def test_parts_that_are_not_moved_equal_one_scene_and_blend_equal_depths_in_their_order(maker: Maker) -> None:
    g = torch.Generator().manual_seed(1)
    flat = []  # two depths, each with too many Gaussians to be in order by chance
    for count in (300, 200):
        means = torch.cat([torch.full((count, 1), 2.0), 0.3 * torch.randn(count, 2, generator=g)], 1)
        means[::7, 0] = 2.5
        flat.append(gaussians(means.tolist(), torch.rand(count, 3, generator=g).tolist(), 0.2, 0.3).float())
    renderer = maker.make(flat)
    both = [placed(1, (first, IDENTITY), (1 - first, IDENTITY)) for first in (0, 1)]
    drawn = [images(renderer, ahead(), parts) for parts in both]
    for parts, image in zip(both, drawn, strict=True):
        assert_equal(image, images(maker.make([in_world(flat, parts, 0)]), ahead()))
    assert not torch.equal(drawn[0][0], drawn[1][0])


@every_maker
def test_the_nearer_part_hides_the_one_behind_it_whatever_their_order(maker: Maker) -> None:
    red, green = [0.9, 0.1, 0.1], [0.1, 0.9, 0.1]
    renderer, cameras = maker.make(walls(red, green)), ahead(19, 13)
    for depths, expected in (((2.0, 3.0), red), ((3.0, 2.0), green), ((2.0, 2.0), red)):
        parts = placed(1, (0, at(depths[0])), (1, at(depths[1])))
        image = renderer.render(cameras, parts)
        assert (image.rgb[0, 6, 9] - torch.tensor(expected)).abs().max() < 2e-3
        assert image.depth[0, 6, 9].item() == pytest.approx(min(depths), abs=0.01)
    turned = placed(1, (1, at(2.0)), (0, at(2.0)))  # at equal depth, the first part is in front
    assert (renderer.render(cameras, turned).rgb[0, 6, 9] - torch.tensor(green)).abs().max() < 2e-3


@every_maker
def test_a_row_without_parts_shows_the_background(maker: Maker) -> None:
    models, cameras = random_models([1, 0, 2]), random_cameras(31, 3, 9, 7)
    renderer, poses = maker.make(models), torch.eye(4).repeat(3, 2, 1, 1)
    poses[:, 1] = torch.nan
    for parts in (Parts(torch.full((3, 2), ABSENT), poses), Parts(torch.zeros(3, 0, dtype=torch.long), poses[:, :0])):
        pixels, rgb, depth, alpha = images(renderer, cameras, parts)
        assert (pixels == torch.tensor([51, 102, 153], dtype=torch.uint8)).all()
        assert torch.allclose(rgb.float(), torch.tensor(BACKGROUND)) and not depth.any() and not alpha.any()


@every_maker
def test_only_the_rows_that_are_asked_for_are_drawn_each_with_its_own_parts(maker: Maker) -> None:
    models, cameras, parts = random_models([1, 1, 1]), random_cameras(31, 4, 19, 13), random_parts(32, 4)
    renderer, only = maker.make(models), torch.tensor([False, True, True, False])
    whole = images(renderer, cameras, parts)
    for part, expected in zip(renderer.render(cameras, parts, only), whole[1:], strict=True):
        assert torch.equal(part[only], expected[only]) and not part[~only].any()
    assert torch.equal(renderer.pixels(cameras, parts, only), whole[0] * only.view(-1, 1, 1, 1))


@every_maker
@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (
            Parts(torch.zeros(3, 2, dtype=torch.int64), random_poses(0, 3, 2)),
            r"parts\.model: expected \[4, M\] torch.int64",
        ),
        (Parts(torch.zeros(4, dtype=torch.int64), random_poses(0, 4)), r"parts\.model: expected \[4, M\]"),
        (
            Parts(torch.zeros(4, 2, dtype=torch.int32), random_poses(0, 4, 2)),
            r"parts\.model: .* got \[4, 2\] torch.int32",
        ),
        (
            Parts(torch.zeros(4, 2, dtype=torch.int64), random_poses(0, 4, 3)),
            r"model_to_world: expected \[4, 2, 4, 4\]",
        ),
        (
            Parts(torch.zeros(4, 2, dtype=torch.int64), random_poses(0, 4, 2).double()),
            r"model_to_world: .* torch.float64",
        ),
    ],
)
def test_parts_of_another_shape_or_type_are_refused(maker: Maker, wrong: Parts, message: str) -> None:
    renderer = maker.make(random_models([0, 0, 0]))
    with pytest.raises(ValueError, match=message):
        renderer.pixels(random_cameras(31, 4, 9, 7), wrong)
    with pytest.raises(ValueError, match=message):
        renderer.render(random_cameras(31, 4, 9, 7), wrong, torch.tensor([True, False, False, False]))


@every_maker
@pytest.mark.parametrize("model", [-2, 3])
def test_a_model_that_does_not_exist_is_refused_by_row_and_part(maker: Maker, model: int) -> None:
    parts = random_parts(32, 4)
    parts.model[2, 1] = model
    with pytest.raises(ValueError, match=rf"parts\.model\[2, 1\]: expected -1 or a model in \[0, 3\), got {model}$"):
        maker.make(random_models([0, 0, 0])).pixels(random_cameras(31, 4, 9, 7), parts)


@every_maker
@pytest.mark.parametrize(
    ("pose", "expected"),
    [
        (torch.full((4, 4), torch.nan), "finite numbers"),
        (torch.diag(torch.tensor([1.1, 1.1, 1.1, 1.0])), "an orthonormal rotation"),
        (torch.diag(torch.tensor([1.0, -1.0, 1.0, 1.0])), "a rotation, not a reflection"),
        (torch.diag(torch.tensor([1.0, 1.0, 1.0, 2.0])), "a bottom row of 0, 0, 0, 1"),
    ],
)
def test_a_pose_that_is_not_rigid_is_refused_by_row_and_part(maker: Maker, pose: torch.Tensor, expected: str) -> None:
    parts = random_parts(32, 4)
    parts.model[3, 2], parts.model_to_world[3, 2] = 1, pose
    with pytest.raises(ValueError, match=rf"parts\.model_to_world\[3, 2\]: expected {expected}, got \[\["):
        maker.make(random_models([0, 0, 0])).pixels(random_cameras(31, 4, 9, 7), parts)


def test_the_core_finds_the_first_invalid_part_and_ignores_poses_of_absent_ones() -> None:
    model, poses = torch.zeros(4, 3, dtype=torch.int64), random_poses(33, 4, 3)
    model[0, 1], poses[0, 1] = ABSENT, torch.nan
    assert _core.first_bad_part(model, poses, 1) == -1
    for row, part, broken in ((3, 2, 2.0), (2, 0, torch.inf), (1, 2, -torch.inf)):
        poses[row, part, 0, 3 if abs(broken) == torch.inf else 0] = broken
        assert _core.first_bad_part(model, poses, 1) == 3 * row + part
    model[0, 2] = 1
    assert _core.first_bad_part(model, poses, 1) == 2
    with pytest.raises(ValueError, match="expected one pose per model"):
        _core.first_bad_part(model, poses[:, :2].contiguous(), 1)


@every_maker
def test_an_empty_list_of_models_is_refused(maker: Maker) -> None:
    with pytest.raises(ValueError, match="scene: expected at least one model, got none"):
        maker.make([])


@pytest.mark.parametrize("antialiased", [False, True])
@pytest.mark.parametrize("degrees", [(0, 0, 0), (3, 0, 1), (0, 2, 3)])
def test_models_of_different_degrees_look_like_the_reference(degrees: tuple[int, ...], antialiased: bool) -> None:
    models, cameras, parts = random_models(degrees), random_cameras(33, 8, 50, 33), random_parts(34, 8)
    fast = make_native(models, antialiased).render(cameras, parts)
    reference = make_reference(models, antialiased).render(cameras, parts)
    assert psnr(fast.rgb, reference.rgb) >= LIKENESS and psnr(fast.alpha, reference.alpha) >= LIKENESS
    covered = reference.alpha > 0.05
    assert ((fast.depth - reference.depth).abs() / reference.depth)[covered].mean() < 1e-4


@pytest.mark.parametrize("tolerance", [0.0, 1.0])
@pytest.mark.parametrize(("width", "height"), [(50, 33), (150, 70)])
def test_a_frame_has_the_same_bytes_in_any_batch_and_order_with_any_threads_and_tiles(
    width: int, height: int, tolerance: float
) -> None:
    models, cameras = random_models([2, 0, 1], (2000, 700, 300)), random_cameras(35, 7, width, height)
    parts, settings = random_parts(36, 7), {"tolerance": tolerance}
    renderer = make_native(models, threads=1, **settings)
    together, order = images(renderer, cameras, parts), torch.randperm(7, generator=torch.Generator().manual_seed(0))
    for threads in (1, 2, 5):
        others = make_native(models, threads=threads, **settings)
        assert_equal(images(others, cameras[order], parts.rows(order)), [image[order] for image in together])
        for row in range(0, 7, 3):
            one = slice(row, row + 1)
            assert_equal(images(others, cameras[one], parts.rows(one)), [image[one] for image in together])


@pytest.mark.parametrize("antialiased", [False, True])
@pytest.mark.parametrize("tolerance", [0.0, 1.0])
def test_a_part_is_drawn_at_the_level_of_detail_of_its_own_model(tolerance: float, antialiased: bool) -> None:
    models, settings = (
        random_models([1, 2, 0], (3000, 2000, 1000)),
        {"antialiased": antialiased, "tolerance": tolerance},
    )
    cameras, parts = random_cameras(37, 6, 30, 22), random_parts(38, 6, most=1)
    renderer, poses = make_native(models, **settings), camera_to_models(cameras, parts)[:, 0]
    for row, model in enumerate(parts.model[:, 0].tolist()):
        alone, one = make_native([models[model]], **settings), slice(row, row + 1)
        in_model = Cameras(poses[one], cameras.K[one], 30, 22)
        assert_equal(images(renderer, cameras[one], parts.rows(one)), images(alone, in_model))


@pytest.mark.parametrize("antialiased", [False, True])
def test_several_parts_with_level_of_detail_look_like_all_their_gaussians(antialiased: bool) -> None:
    models = random_models([1, 1, 1], (6000, 4000, 3000))
    cameras, parts = random_cameras(37, 6, 16, 12), random_parts(38, 6)
    exact, merged = make_native(models, antialiased), make_native(models, antialiased, tolerance=0.5)
    assert isinstance(exact, NativeRenderer) and isinstance(merged, NativeRenderer)
    assert psnr(merged.render(cameras, parts).rgb, exact.render(cameras, parts).rgb) >= 35
    assert merged.efforts(cameras, parts).projected.sum() < 0.9 * exact.efforts(cameras, parts).projected.sum()


def test_efforts_of_parts_add_up() -> None:
    models, cameras, parts = random_models([1, 0, 2]), random_cameras(39, 5), random_parts(40, 5)
    renderer = NativeRenderer(models)
    whole = renderer.efforts(cameras, parts)
    each = [
        renderer.efforts(cameras, Parts(m[:, None], p[:, None]))
        for m, p in zip(*(v.unbind(1) for v in parts), strict=True)
    ]
    assert torch.equal(whole.projected, torch.stack([one.projected for one in each]).sum(0))
    assert torch.equal(whole.visible, torch.stack([one.visible for one in each]).sum(0)) and whole.visible.all()


def test_a_frame_does_not_depend_on_how_many_parts_were_drawn_before() -> None:
    models, cameras, few = random_models([1, 0, 2], (900, 90, 40)), random_cameras(39, 5), random_parts(40, 5, most=1)
    renderer = make_native(models)
    before = images(renderer, cameras, few)
    many = placed(5, *[(number % 3, pose) for number, pose in enumerate(random_poses(41, 200))])
    crowd = images(renderer, cameras, many)
    assert_equal(images(make_native(models), cameras, many), crowd)
    assert_equal(images(renderer, cameras, few), before)


def test_parts_with_more_splats_than_one_slab_holds_look_like_their_gaussians() -> None:
    models, cameras = random_models([0, 0, 0]), random_cameras(39, 2, 70, 45)
    parts = placed(2, *[(number % 3, pose) for number, pose in enumerate(random_poses(42, 60))])
    expected, pixels = drawn_in_world(make_native, models, cameras, parts)
    assert_like(make_native(models).render(cameras, parts), expected, 1e-3)
    assert_same_bytes(make_native(models).pixels(cameras, parts), pixels, 1e-3)


@pytest.mark.parametrize("far", [1e6, 1e18, 1e38])
def test_parts_absurdly_far_away_give_finite_images(far: float) -> None:
    cameras, parts = random_cameras(39, 4), random_parts(40, 4)
    parts.model_to_world[:, :, 0, 3] *= far
    view = make_native(random_models([1, 2, 0])).render(cameras, parts)
    assert view.rgb.isfinite().all() and view.alpha.isfinite().all()


def test_gradients_reach_every_model_and_pose_that_is_drawn() -> None:
    models, parts = [double(model) for model in random_models([1, 1, 1])], placed(2, (0, at(0.1)), (2, at(0.0, 0.2)))
    parts.model[0, 1] = ABSENT
    for model in models:
        model.opacities.requires_grad_()
    poses = parts.model_to_world.requires_grad_()
    ReferenceRenderer(models).render(random_cameras(31, 2, 9, 7), Parts(parts.model, poses)).rgb.sum().backward()
    assert models[0].opacities.grad.any() and models[2].opacities.grad.any() and models[1].opacities.grad is None
    assert poses.grad[:, 0].flatten(1).any(1).all() and poses.grad[1, 1].any() and not poses.grad[0, 1].any()


def test_pixels_of_parts_are_drawn_into_the_tensor_that_is_given() -> None:
    cameras, parts, renderer = random_cameras(31, 3), random_parts(32, 3), NativeRenderer(random_models([1, 0, 1]))
    out = torch.zeros(3, 22, 37, 3, dtype=torch.uint8)
    assert renderer.pixels(cameras, parts, out=out) is out
    assert torch.equal(out, renderer.pixels(cameras, parts))


def test_cameras_moved_into_models_are_exact_for_the_identity_and_can_be_moved_back() -> None:
    cameras, poses = random_cameras(43, 9), random_poses(44, 9, 2)
    poses[:, 0] = IDENTITY
    in_models = camera_to_models(cameras, Parts(torch.zeros(9, 2, dtype=torch.int64), poses))
    assert torch.equal(in_models[:, 0], cameras.camera_to_world)
    back = poses[:, 1].double() @ in_models[:, 1].double()
    assert torch.allclose(back, cameras.camera_to_world.double(), atol=1e-6)


def test_the_core_moves_cameras_into_models_as_its_readable_twin_does() -> None:
    cameras, poses = random_cameras(45, 7), random_poses(46, 7, 3)
    poses[:, 0] = IDENTITY
    parts = Parts(torch.zeros(7, 3, dtype=torch.int64), poses)
    placed_by_core = in_models(cameras.camera_to_world, parts)
    torch.testing.assert_close(placed_by_core, camera_to_models(cameras, parts), rtol=0, atol=1e-6)
    assert torch.equal(placed_by_core[:, 0], cameras.camera_to_world)
    with pytest.raises(ValueError, match="expected model_to_world and out of equal shape, with one row per camera"):
        _core.camera_to_models(cameras.camera_to_world[:5], poses, placed_by_core)


def test_gaussians_by_themselves_are_accepted_as_one_model() -> None:
    model, cameras = random_gaussians(0, 60), random_cameras(1)
    assert_equal(images(NativeRenderer(model), cameras), images(NativeRenderer([model]), cameras))
