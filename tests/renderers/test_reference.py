import math

import pytest
import torch

from splatrl.cameras import Cameras, intrinsics, look_at
from splatrl.geometry import axis_rotations, rigid
from splatrl.renderers import ReferenceRenderer
from splatrl.scenes.gaussians import Gaussians
from tests.renderers.cases import ahead, double, gaussians, psnr, random_cameras, random_gaussians


def test_the_centre_of_a_gaussian_has_its_opacity_and_its_colour() -> None:
    scene = gaussians([[2.0, 0.0, 0.0]], [[0.9, 0.5, 0.1]], scale=0.2, opacity=0.7)
    view = ReferenceRenderer(scene, antialiased=False).render(ahead())
    torch.testing.assert_close(view.alpha[0, 15, 20], torch.tensor(0.7, dtype=torch.float64))
    expected = 0.7 * torch.tensor([0.9, 0.5, 0.1], dtype=torch.float64)
    torch.testing.assert_close(view.rgb[0, 15, 20], expected)


def test_left_of_the_robot_is_left_in_the_image_and_up_is_up() -> None:
    scene = gaussians([[2.0, 0.5, 0.25]], scale=0.02)
    alpha = ReferenceRenderer(scene).render(ahead()).alpha[0]
    row, column = divmod(int(alpha.argmax()), alpha.shape[1])
    assert (row, column) == (10, 10)  # 0.25 · 40 / 2 = 5 rows above and 10 columns left of the middle (15, 20)


def test_the_variance_in_the_image_is_the_projected_variance_plus_the_dilation() -> None:
    scene = gaussians([[2.0, 0.0, 0.0]], scale=0.1, opacity=0.9)
    alpha = ReferenceRenderer(scene, antialiased=False).render(ahead()).alpha[0]
    variance = (0.1 * 40 / 2) ** 2 + 0.3
    for offset in range(5):
        expected = 0.9 * math.exp(-0.5 * offset**2 / variance)
        assert alpha[15, 20 + offset].item() == pytest.approx(expected, rel=1e-6)


def test_antialiasing_lowers_the_opacity_as_much_as_the_dilation_adds_to_the_area() -> None:
    scene = gaussians([[2.0, 0.0, 0.0]], scale=0.01, opacity=0.9)
    alpha = ReferenceRenderer(scene, antialiased=True).render(ahead()).alpha[0, 15, 20]
    variance = (0.01 * 40 / 2) ** 2
    assert alpha.item() == pytest.approx(0.9 * variance / (variance + 0.3), rel=1e-5)


@pytest.mark.parametrize("near", [0, 1])
def test_the_nearer_of_two_gaussians_covers_the_other_whatever_their_order(near: int) -> None:
    depths = [2.0, 3.0] if near == 0 else [3.0, 2.0]
    colors = [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    scene = gaussians([[depths[0], 0.0, 0.0], [depths[1], 0.0, 0.0]], colors, scale=0.3, opacity=[0.6, 0.5])
    view = ReferenceRenderer(scene, antialiased=False).render(ahead())
    red, green, blue = view.rgb[0, 15, 20].tolist()
    opacities = [0.6, 0.5]
    shares = [opacities[i] * (1 if i == near else 1 - opacities[1 - i]) for i in (0, 1)]
    assert (red, green, blue) == pytest.approx((shares[0], 0.0, shares[1]), abs=1e-9)
    expected = (shares[0] * depths[0] + shares[1] * depths[1]) / sum(shares)
    assert view.depth[0, 15, 20].item() == pytest.approx(expected)


def test_gaussians_of_equal_depth_are_blended_in_the_order_of_the_scene() -> None:
    colors = [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    scene = gaussians([[2.0, 0.0, 0.0]] * 2, colors, scale=0.3, opacity=0.6)
    rgb = ReferenceRenderer(scene, antialiased=False).render(ahead()).rgb[0, 15, 20]
    assert rgb.tolist() == pytest.approx([0.6, 0.0, 0.24])


def test_a_colour_of_degree_one_is_brightest_from_the_side_that_its_sign_gives() -> None:
    scene = gaussians([[0.0, 0.0, 0.0]], [[0.5, 0.5, 0.5]], scale=0.3)
    sh = torch.zeros(1, 4, 3, dtype=torch.float64)
    sh[0, 3, 0] = -0.5  # the basis is -0.4886 x: red grows with x of the viewing direction
    scene = Gaussians(scene.means, scene.quats, scene.scales, scene.opacities, sh, batch_size=[1])
    K = intrinsics(1.0, 21, 15)
    sides = torch.stack([look_at([-2.0, 0.0, 0.0], [0.0, 0.0, 0.0]), look_at([2.0, 0.0, 0.0], [0.0, 0.0, 0.0])])
    rgb = ReferenceRenderer(scene, antialiased=False).render(Cameras(sides, K, 21, 15)).rgb[:, 7, 10]
    expected = [0.8 * (0.5 + 0.4886025 * 0.5), 0.8 * (0.5 - 0.4886025 * 0.5)]
    assert rgb[:, 0].tolist() == pytest.approx(expected, rel=1e-5)
    assert rgb[:, 1].tolist() == pytest.approx([0.4, 0.4])


def test_a_surface_of_gaussians_each_fainter_than_a_grey_level_shows_in_an_antialiased_image() -> None:
    side = (torch.arange(100) - 49.5) * 0.02
    y, z = torch.meshgrid(side, side, indexing="ij")
    points = torch.stack([torch.full((10_000,), 40.0), y.flatten(), z.flatten()], 1).tolist()
    alphas = []
    for scale in (0.01, 0.03):  # a pixel is 1 m wide there, with 2500 Gaussians around its centre
        view = ReferenceRenderer(gaussians(points, scale=scale, opacity=0.99)).render(ahead())
        alphas.append(float(view.alpha[0, 15, 20]))
    single = [0.99 * scale**2 / (scale**2 + 0.3) for scale in (0.01, 0.03)]
    assert single[0] < 1 / 1020 < single[1] < 1 / 255
    assert alphas[0] == 0 and alphas[1] > 0.9


def test_the_background_shows_where_nothing_covers_it() -> None:
    scene = gaussians([[2.0, 0.0, 0.0]], [[0.0, 0.0, 0.0]], scale=0.05, opacity=0.75)
    view = ReferenceRenderer(scene, antialiased=False, background=(0.2, 0.4, 0.8)).render(ahead())
    assert view.rgb[0, 0, 0].tolist() == pytest.approx([0.2, 0.4, 0.8])
    assert view.rgb[0, 15, 20].tolist() == pytest.approx([0.05, 0.1, 0.2])
    assert view.depth[0, 0, 0] == 0 and view.alpha[0, 0, 0] == 0


def test_a_pixel_is_finished_before_the_gaussian_that_would_saturate_it() -> None:
    scene = gaussians([[1.0 + i, 0.0, 0.0] for i in range(3)], scale=2.0, opacity=[0.99, 0.995, 0.9])
    alpha = ReferenceRenderer(scene, antialiased=False).render(ahead()).alpha[0, 15, 20]
    assert alpha.item() == pytest.approx(0.99)  # the second would leave 0.01 · 0.005 < 1e-4; the third would not


def test_an_opacity_of_one_lets_a_thousandth_of_the_light_through() -> None:
    scene = gaussians([[1.0, 0.0, 0.0]], scale=2.0, opacity=1.0)
    assert ReferenceRenderer(scene).render(ahead()).alpha[0, 15, 20].item() == pytest.approx(0.999)


def test_gaussians_nearer_than_the_near_plane_are_not_shown() -> None:
    for depth, shown in ((0.011, True), (0.009, False), (-1.0, False)):
        scene = gaussians([[depth, 0.0, 0.0]], scale=0.01)
        assert bool(ReferenceRenderer(scene).render(ahead()).alpha.any()) == shown


@pytest.mark.parametrize("antialiased", [False, True])
def test_moving_the_scene_together_with_the_camera_changes_nothing(antialiased: bool) -> None:
    scene, cameras = double(random_gaussians(3, degree=3)), random_cameras(4)
    move = rigid(axis_rotations(0, torch.tensor(0.7)) @ axis_rotations(2, torch.tensor(2.1)), torch.tensor([1.0, 2, 3]))
    moved = Cameras(move @ cameras.camera_to_world, cameras.K, cameras.width, cameras.height)
    before = ReferenceRenderer(scene, antialiased).render(cameras)
    after = ReferenceRenderer(scene.transformed(move), antialiased).render(moved)
    assert psnr(after.rgb, before.rgb) > 90
    torch.testing.assert_close(after.alpha, before.alpha, atol=1e-3, rtol=0)


def test_scaling_the_scene_together_with_the_camera_scales_only_the_depth() -> None:
    scene, cameras = double(random_gaussians(5)), random_cameras(6)
    poses = cameras.camera_to_world.clone()
    poses[:, :3, 3] *= 2
    before = ReferenceRenderer(scene).render(cameras)
    twice = torch.diag(torch.tensor([2.0, 2.0, 2.0, 1.0]))
    after = ReferenceRenderer(scene.transformed(twice)).render(Cameras(poses, cameras.K, 37, 22))
    assert psnr(after.rgb, before.rgb) > 90
    torch.testing.assert_close(after.depth, 2 * before.depth, atol=1e-2, rtol=0)


@pytest.mark.parametrize("antialiased", [False, True])
def test_gradients_reach_every_attribute_and_are_right(antialiased: bool) -> None:
    scene, cameras = double(random_gaussians(7, count=3, degree=1)), random_cameras(8, 1, 5, 4)
    values = [v.requires_grad_() for v in (scene.means, scene.quats, scene.scales, scene.opacities, scene.sh)]

    def image(*fields: torch.Tensor) -> torch.Tensor:
        view = ReferenceRenderer(Gaussians(*fields, batch_size=[3]), antialiased).render(cameras)
        return torch.cat([view.rgb.flatten(), view.alpha.flatten()])

    assert image(*values).max() > 0.1
    assert torch.autograd.gradcheck(image, values, eps=1e-7, atol=1e-4)


def test_pixels_are_the_rounded_colours() -> None:
    scene, cameras = random_gaussians(9), random_cameras(10)
    renderer = ReferenceRenderer(scene)
    expected = (renderer.render(cameras).rgb * 255 + 0.5).floor().to(torch.uint8)
    assert renderer.pixels(cameras).dtype == torch.uint8
    assert torch.equal(renderer.pixels(cameras), expected)
