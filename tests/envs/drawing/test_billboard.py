"""Where sprites are drawn, how large they are, and what hides them."""

import math

import pytest
import torch
from torch import Tensor

from splatrl.cameras import look_at
from splatrl.envs.drawing import Sprite, billboard, load_sprite, overlay
from tests.envs.transforms.views import plain_sprite

WIDTH, HEIGHT = 40, 24
K = torch.tensor([[30.0, 0.0, 17.0], [0.0, 20.0, 14.0], [0.0, 0.0, 1.0]])
"""Intrinsics with non-square pixels and an off-centre principal point."""


APPLE = load_sprite("apple")


def blank(count: int = 1, height: int = HEIGHT, width: int = WIDTH) -> tuple[Tensor, Tensor]:
    """Return grey images of nothing, which is infinitely far away."""
    return torch.full((count, height, width, 3), 100, dtype=torch.uint8), torch.full((count, height, width), torch.inf)


def ahead(*places: tuple[float, float, float]) -> tuple[Tensor, Tensor]:
    """Return cameras at the world's origin, and positions in their frame: x right, y down, z ahead."""
    return torch.eye(4).expand(len(places), 4, 4), torch.tensor(places)


def chequered(side: int = 16) -> Sprite:
    """Make a sprite in which every other texel is opaque white and the rest are transparent."""
    alpha = (torch.arange(side).view(-1, 1) + torch.arange(side)) % 2 * 255
    white = torch.full((side, side, 3), 255)
    return Sprite.of(torch.cat([white, alpha.unsqueeze(2)], 2).to(torch.uint8))


def test_a_square_is_where_the_pinhole_projection_puts_it() -> None:
    images, depth = blank()
    pose, place = ahead((0.5, -0.2, 2.0))
    drawn, share, _ = overlay(images, depth, pose, K, place, plain_sprite(), size=0.8)
    # centre 30 · 0.25 + 17 = 24.5, 20 · −0.1 + 14 = 12; width 30 · 0.4 = 12, height 20 · 0.4 = 8
    columns, rows = slice(19, 30), slice(8, 16)  # 18.5 to 30.5: half of columns 18 and 30
    assert (drawn[0, rows, columns] == torch.tensor([0, 255, 0])).all()
    for half in (18, 30):
        assert (drawn[0, rows, half] == torch.tensor([50, 178, 50])).all()
    changed = (drawn != images).any(-1)[0]
    assert changed.sum() == 8 * 13 and changed[rows, 18:31].all()
    assert share.shape == (1, 1) and share.item() == pytest.approx(12 * 8 / (WIDTH * HEIGHT), abs=1e-6)


def test_any_camera_sees_the_sprite_at_the_projection_of_its_position() -> None:
    generator = torch.Generator().manual_seed(0)
    eyes = 2 * torch.rand(20, 3, generator=generator) - 1
    place = torch.tensor([2.5, 0.3, 0.4])
    poses = look_at(eyes, place + 0.3 * torch.randn(20, 3, generator=generator))
    images, depth = blank(20)
    drawn, *_ = overlay(images, depth, poses, K, place, plain_sprite(), size=0.3)
    cover = (drawn[..., 1].double() - 100) / 155
    camera = torch.linalg.solve(poses.double(), torch.cat([place.double(), torch.ones(1)])).T[:3]
    column, row, _ = (K.double() @ camera) / camera[2]
    wide, high = 30 * 0.3 / camera[2], 20 * 0.3 / camera[2]
    whole = (column - wide / 2 > 0) & (column + wide / 2 < WIDTH) & (row - high / 2 > 0) & (row + high / 2 < HEIGHT)
    assert whole.sum() > 8
    total = cover.sum((1, 2))
    center_x = (cover.sum(1) * (torch.arange(WIDTH) + 0.5)).sum(1) / total
    center_y = (cover.sum(2) * (torch.arange(HEIGHT) + 0.5)).sum(1) / total
    torch.testing.assert_close(
        center_x[whole], column[whole], atol=0.1, rtol=0
    )  # a partly covered pixel counts at its centre
    torch.testing.assert_close(center_y[whole], row[whole], atol=0.1, rtol=0)
    torch.testing.assert_close(total[whole], (wide * high)[whole], atol=0, rtol=0.03)


def test_the_sprite_is_upright_and_not_mirrored() -> None:
    corners = torch.zeros(32, 32, 4, dtype=torch.uint8)
    corners[..., 3] = 255
    corners[:16, :16, 0], corners[:16, 16:, 1], corners[16:, :16, 2] = 255, 255, 255  # red, green above blue, black
    pose, place = ahead((0.0, 0.0, 1.0))
    images, depth = blank()
    drawn, *_ = overlay(images, depth, pose, K, place, Sprite.of(corners), size=0.8)
    for (row, column), color in {
        (9, 8): [255, 0, 0],
        (9, 25): [0, 255, 0],
        (19, 8): [0, 0, 255],
        (19, 25): [0, 0, 0],
    }.items():
        assert drawn[0, row, column].tolist() == color, (row, column)


@pytest.mark.parametrize("far", [5.0, math.inf])
def test_a_sprite_is_half_hidden_by_an_edge_of_the_scene(far: float) -> None:
    images, depth = blank()
    depth[0, :, :24] = 1.0  # something near, to the left
    depth[0, :, 24:] = far  # something far, or nothing, to the right
    pose, place = ahead((0.7, 0.0, 3.0))  # 24 ± 6
    drawn, share, solid = overlay(images, depth, pose, K, place, plain_sprite(), size=1.2)
    expected = depth.clone()
    expected[0, 10:18, 24:30] = 3.0
    assert torch.equal(solid, expected)
    assert torch.equal(drawn[0, :, :24], images[0, :, :24])
    assert (drawn[0, 10:18, 24:30] == torch.tensor([0, 255, 0])).all()
    assert share.item() == pytest.approx(6 * 8 / (WIDTH * HEIGHT), abs=1e-6)


@pytest.mark.parametrize(("scene", "shown"), [(math.inf, True), (2.0, True), (2.001, True), (1.999, False)])
def test_depth_along_the_optical_axis_decides_what_is_nearer(scene: float, shown: bool) -> None:
    images, depth = blank()
    pose, place = ahead((1.0, 0.3, 2.0))  # farther than 2 m from the camera, but 2 m along the axis
    _, share, _ = overlay(images, torch.full_like(depth, scene), pose, K, place, plain_sprite(), size=0.3)
    assert (share > 0).item() == shown


def test_a_sprite_that_fills_the_image_has_a_share_of_1() -> None:
    images, depth = blank()
    pose, place = ahead((0.0, 0.0, 0.1))
    drawn, share, _ = overlay(images, depth, pose, K, place, plain_sprite(), size=0.5)
    assert share.item() == 1.0
    assert (drawn == torch.tensor([0, 255, 0])).all()


@pytest.mark.parametrize("z", [0.0499, 0.0, -0.001, -2.0])
def test_a_sprite_too_near_or_behind_the_camera_is_not_drawn(z: float) -> None:
    images, depth = blank()
    drawn, share, _ = overlay(images, depth, *_with_k(ahead((0.0, 0.0, z))), plain_sprite(), size=0.5, near=0.05)
    assert share.item() == 0.0 and torch.equal(drawn, images)


def _with_k(view: tuple[Tensor, Tensor]) -> tuple[Tensor, Tensor, Tensor]:
    return view[0], K, view[1]


@pytest.mark.parametrize("sprite", [plain_sprite(), chequered(), APPLE], ids=["plain", "fine", "apple"])
@pytest.mark.parametrize("distance", [1.5, 3.0, 7.3, 20.0, 55.0, 140.0])
def test_a_small_sprite_keeps_its_share_of_the_image_wherever_it_stands(sprite: Sprite, distance: float) -> None:
    generator = torch.Generator().manual_seed(0)
    places = torch.rand(50, 3, generator=generator) * torch.tensor([0.1, 0.1, 0.0]) * distance
    places[:, 2] = distance
    images, depth = blank(50)
    _, share, _ = overlay(images, depth, torch.eye(4).expand(50, 4, 4), K, places, sprite, size=0.5)
    mean = sprite.texels[-9, 3].item()  # alpha of the last level, which is one texel padded with eight
    expected = mean * 30 * 20 * (0.5 / distance) ** 2 / (WIDTH * HEIGHT)
    steps = 1 / billboard.ALPHA_STEPS / (WIDTH * HEIGHT) * 20
    torch.testing.assert_close(share, torch.full((50, 1), expected), rtol=2e-3, atol=steps)


def test_a_sprite_that_moves_by_part_of_a_pixel_changes_smoothly() -> None:
    places = torch.zeros(200, 3)
    places[:, 0], places[:, 2] = torch.linspace(-0.5, 0.5, 200), 10.0  # sprites of 1.5 pixels, 0.015 pixels apart
    images, depth = blank(200)
    drawn, *_ = overlay(images, depth, torch.eye(4).expand(200, 4, 4), K, places, chequered(), size=0.5)
    assert (drawn[1:].int() - drawn[:-1].int()).abs().max() <= 3
    assert (drawn[0] != drawn[-1]).any()


def test_fine_detail_is_averaged_instead_of_sampled() -> None:
    images, depth = blank()
    pose, place = ahead((0.0, 0.0, 1.0))  # 9 × 6 pixels show 64 × 64 texels
    drawn, *_ = overlay(images, depth, pose, K, place, chequered(64), size=0.3)
    inner = drawn[0, 12:16, 14:20].int()
    assert ((inner - 178).abs() <= 6).all()  # half white, half 100


def test_a_magnified_sprite_is_interpolated() -> None:
    step = torch.zeros(2, 2, 4, dtype=torch.uint8)
    step[..., 3] = 255
    step[:, 1, :3] = 255
    images, depth = blank()
    pose, place = ahead((0.0, 0.0, 1.0))
    drawn, *_ = overlay(images, depth, pose, K, place, Sprite.of(step), size=1.0)  # texels of 15 pixels
    ramp = drawn[0, 14, :, 0].float()
    expected = 255 * ((torch.arange(WIDTH) + 0.5 - 17) / 15 + 0.5).clamp(0, 1)
    torch.testing.assert_close(ramp[10:24], expected[10:24], atol=0.51, rtol=0)


def test_an_image_does_not_depend_on_the_others_of_its_batch() -> None:
    generator = torch.Generator().manual_seed(1)
    images = torch.randint(0, 256, (9, HEIGHT, WIDTH, 3), dtype=torch.uint8, generator=generator)
    depth = 4 * torch.rand(9, HEIGHT, WIDTH, generator=generator)
    places = torch.rand(9, 3, generator=generator) * torch.tensor([0.4, 0.4, 3.0]) + torch.tensor([-0.2, -0.2, 0.02])
    poses = torch.eye(4).repeat(9, 1, 1)
    together = overlay(images, depth, poses, K, places, APPLE, size=0.4)
    for row in range(9):
        one = slice(row, row + 1)
        alone = overlay(images[one], depth[one], poses[one], K, places[one], APPLE, size=0.4)
        assert all(torch.equal(mine, whole[one]) for mine, whole in zip(alone, together, strict=True))


def test_drawing_all_pixels_as_a_gpu_does_gives_the_same_bytes(monkeypatch: pytest.MonkeyPatch) -> None:
    images, depth = blank(3)
    depth[1, :, :20] = 0.5
    view = (
        images,
        depth,
        *_with_k(ahead((0.0, 0.0, 1.0), (0.1, 0.0, 1.2), (0.0, 0.0, -1.0))),
        APPLE,
        0.4,
    )
    few = overlay(*view)
    monkeypatch.setattr(billboard, "_points", lambda inside: torch.arange(len(inside)))
    for left, right in zip(few, overlay(*view), strict=True):
        assert torch.equal(left, right)


def test_batches_of_any_shape_are_drawn_alike() -> None:
    images, depth = blank(6)
    poses, places = ahead(*[(0.1 * i, 0.0, 1.0) for i in range(6)])
    flat = overlay(images, depth, poses, K, places, plain_sprite(), size=0.2)
    nested = overlay(
        images.unflatten(0, (2, 3)), depth.unflatten(0, (2, 3)), poses.unflatten(0, (2, 3)), K,
        places.unflatten(0, (2, 3)), plain_sprite(), size=0.2,
    )  # fmt: skip
    single = overlay(images[4], depth[4], poses[4], K, places[4], plain_sprite(), size=0.2)
    empty = overlay(images[:0], depth[:0], poses[:0], K, places[:0], plain_sprite(), size=0.2)
    for one, rows, all_rows in zip(single, nested, flat, strict=True):
        assert torch.equal(rows.flatten(0, 1), all_rows) and torch.equal(one, all_rows[4])
    assert [part.shape for part in empty] == [(0, HEIGHT, WIDTH, 3), (0, 1), (0, HEIGHT, WIDTH)]


@pytest.mark.gpu
def test_a_gpu_draws_the_same_within_one_grey_level() -> None:
    if not torch.cuda.is_available():
        pytest.skip("needs a CUDA device")
    images, depth = blank(4)
    poses, places = ahead((0.0, 0.0, 1.0), (0.1, 0.1, 3.0), (0.0, 0.0, -1.0), (0.0, 0.0, 0.1))
    sprite = APPLE
    here = overlay(images, depth, poses, K, places, sprite, size=0.4)
    there = overlay(*(x.cuda() for x in (images, depth, poses, K, places)), sprite.to("cuda"), size=0.4)
    assert (here[0].int() - there[0].cpu().int()).abs().max() <= 1
    torch.testing.assert_close(here[1], there[1].cpu(), atol=1e-4, rtol=0)
    assert math.isclose(there[1][3].item(), here[1][3].item(), abs_tol=1e-4)


def test_drawing_on_another_device_never_synchronises() -> None:
    images, depth = blank(3)
    poses, places = ahead((0.0, 0.0, 1.0), (0.1, 0.0, 1.2), (0.0, 0.0, -1.0))
    meta = [x.to("meta") for x in (images, depth, poses, K, places)]  # has shapes, but no values to read
    drawn, share, _ = overlay(*meta, APPLE.to("meta"), size=0.4)
    assert drawn.shape == images.shape and share.shape == (3, 1)
