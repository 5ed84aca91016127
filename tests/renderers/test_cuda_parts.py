"""Placed models on a GPU: the kernels' own source, emulated on the CPU and, if there is a GPU, run on that as well."""

from collections.abc import Callable, Sequence
from typing import Any

import pytest
import torch
from torch import Tensor

from splatrl.cameras import Cameras
from splatrl.renderers import ABSENT, NativeRenderer, Parts
from splatrl.renderers import cuda_models as cuda_models_module
from splatrl.renderers import cuda_parts as cuda_parts_module
from splatrl.renderers.cuda import CudaRenderer
from splatrl.renderers.cuda_parts import MOST_PARTS
from splatrl.renderers.parts import camera_to_models
from splatrl.scenes import Gaussians
from tests.emulator import emulated
from tests.envs.devices import NoHostReads
from tests.renderers.cases import LIKENESS, ahead, gaussians, psnr, random_cameras, random_gaussians
from tests.renderers.parts_cases import (
    BACKGROUND,
    IDENTITY,
    assert_like,
    assert_same_bytes,
    at,
    drawn_in_world,
    in_world,
    placed,
    random_models,
    random_parts,
    random_poses,
    walls,
)

Make = Callable[..., CudaRenderer]
MODES = [
    ((0, 0, 0), True),
    pytest.param((1, 1, 1), False, marks=pytest.mark.slow),
    ((2, 2, 2), True),
    ((3, 0, 1), False),
]
"""Degrees of models, and whether images are antialiased. All tests together, those with ``-m slow`` included, draw each
degree both ways, with parts and without, and with level of detail and without; no single test does, since each
combination takes seconds to compile."""


@pytest.fixture(params=["emulated", pytest.param("gpu", marks=pytest.mark.gpu)])
def make(request: pytest.FixtureRequest) -> Make:
    """A function that makes renderers, emulated or on a GPU."""
    where = {"load": emulated} if request.param == "emulated" else {"device": request.getfixturevalue("cuda_device")}

    def make_there(models: Sequence[Gaussians], antialiased: bool = True, **settings: Any) -> CudaRenderer:
        return CudaRenderer(models, antialiased, BACKGROUND, **where, **settings)

    return make_there


def images(renderer: CudaRenderer, cameras: Cameras, parts: Parts | None = None) -> list[Tensor]:
    """Return everything that a renderer draws: pixels, rgb, depth and alpha. Cameras may be on another device."""
    return [renderer.pixels(cameras, parts), *renderer.render(cameras, parts)]


def assert_equal(some: list[Tensor], others: list[Tensor]) -> None:
    assert all(torch.equal(a, b) for a, b in zip(some, others, strict=True))


@pytest.mark.parametrize(("degrees", "antialiased"), MODES)
def test_parts_look_like_their_gaussians_moved_to_the_world(
    make: Make, degrees: tuple[int, ...], antialiased: bool
) -> None:
    models, cameras, parts = random_models(degrees), random_cameras(31, 4, 45, 38), random_parts(32, 4)
    renderer = make(models, antialiased)
    expected, pixels = drawn_in_world(lambda model: make(model, antialiased), models, cameras, parts)
    assert_like(renderer.render(cameras, parts), expected, 1e-3)
    turned = max(degrees) > 0  # harmonics are stored as half floats, so rotated ones round differently
    assert_same_bytes(renderer.pixels(cameras, parts), pixels, 0.02 if turned else 1e-4)
    renderer.raise_faults()


@pytest.mark.parametrize(
    ("degree", "tolerance", "antialiased"),
    [
        pytest.param(2, 0.0, True, marks=pytest.mark.slow),
        (3, 0.0, False),
        (1, 1.0, True),
        pytest.param(2, 1.0, False, marks=pytest.mark.slow),
    ],
)
def test_one_part_that_is_not_moved_has_the_same_bytes_as_the_scene_itself(
    make: Make, degree: int, tolerance: float, antialiased: bool
) -> None:
    models, cameras = random_models([degree] * 3, (900, 700, 40)), random_cameras(31, 3, 40, 35)
    settings = {"antialiased": antialiased, "tolerance": tolerance}
    renderer = make(models, **settings)
    bare = images(renderer, cameras)
    assert_equal(images(renderer, cameras, placed(3, (0, IDENTITY))), bare)
    assert_equal(images(make(models[:1], **settings), cameras), bare)
    second = images(renderer, cameras, placed(3, (ABSENT, torch.full((4, 4), torch.nan)), (1, IDENTITY)))
    assert_equal(second, images(make(models[1:], **settings), cameras))


@pytest.mark.parametrize(
    ("degrees", "antialiased"), [((1, 1, 1), True), pytest.param((0, 2, 0), False, marks=pytest.mark.slow)]
)
def test_a_part_is_drawn_at_the_level_of_detail_of_its_own_model(
    make: Make, degrees: tuple[int, ...], antialiased: bool
) -> None:
    models, settings = random_models(degrees, (3000, 2000, 600)), {"antialiased": antialiased, "tolerance": 3.0}
    cameras, parts = random_cameras(37, 4, 33, 22), random_parts(38, 4, most=1)
    renderer, poses = make(models, **settings), camera_to_models(cameras, parts)[:, 0]
    for row, model in enumerate(parts.model[:, 0].tolist()):
        one = slice(row, row + 1)
        alone = make([models[model]], **settings).render(Cameras(poses[one], cameras.K[one], 33, 22))
        assert_like(renderer.render(cameras[one], parts.rows(one)), alone, 1e-3)
    finer = make(models, antialiased, tolerance=0.01).efforts(cameras, parts)[:, 0]
    assert (renderer.efforts(cameras, parts)[:, 0] < 0.8 * finer).any()


@pytest.mark.parametrize(
    ("degrees", "antialiased"), [pytest.param((1, 3, 0), True, marks=pytest.mark.slow), ((2, 0, 1), False)]
)
def test_parts_with_level_of_detail_look_the_same_as_on_the_cpu(
    make: Make, degrees: tuple[int, ...], antialiased: bool
) -> None:
    models, cameras, parts = random_models(degrees, (3000, 2000, 600)), random_cameras(33, 4), random_parts(34, 4)
    image = make(models, antialiased, tolerance=2.0).render(cameras, parts)
    expected = NativeRenderer(models, antialiased, BACKGROUND, tolerance=2.0).render(cameras, parts)
    assert psnr(image.rgb, expected.rgb) >= LIKENESS and psnr(image.alpha, expected.alpha) >= LIKENESS


def test_a_part_in_front_of_another_is_composited_over_it(make: Make) -> None:
    models, cameras = random_models([1, 1, 0], (2500, 1500, 9)), ahead(41, 35)
    renderer = make(models, tolerance=1.0)
    near, far = (renderer.render(cameras, placed(1, part)) for part in ((1, at(6.0)), (0, at(20.0))))
    both = renderer.render(cameras, placed(1, (0, at(20.0)), (1, at(6.0))))
    over = near.rgb + (1 - near.alpha).unsqueeze(-1) * (far.rgb - torch.tensor(BACKGROUND))
    assert (both.rgb - over).abs().max() < 2e-3
    assert (both.alpha - near.alpha - (1 - near.alpha) * far.alpha).abs().max() < 2e-3


@pytest.mark.parametrize(("degrees", "tolerance"), [((2, 0, 1), 0.0), ((1, 0, 1), 1.0)])
def test_a_frame_has_the_same_bytes_alone_and_in_any_batch_and_order(
    make: Make, degrees: tuple[int, ...], tolerance: float
) -> None:
    models, cameras = random_models(degrees, (900, 700, 300)), random_cameras(35, 5, 50, 33)
    parts, order = random_parts(36, 5), torch.tensor([3, 0, 4, 2, 1])
    renderer, others = (
        make(models, tolerance=tolerance, memory=1),
        make(models, tolerance=tolerance),
    )  # one thread block
    together = images(renderer, cameras, parts)
    assert_equal(images(others, cameras[order], parts.rows(order)), [image[order] for image in together])
    for row in range(5):
        one = slice(row, row + 1)
        assert_equal(images(others, cameras[one], parts.rows(one)), [image[one] for image in together])


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_order_of_threads_between_barriers_changes_nothing(seed: int) -> None:
    models, cameras, parts = (
        random_models([1, 0, 0], (1200, 90, 40)),
        random_cameras(35, 2, 40, 35),
        random_parts(36, 2),
    )
    renderer = CudaRenderer(models, tolerance=1.0, load=emulated)
    expected = renderer.pixels(cameras, parts)
    renderer._for_parts()[0].seed = seed  # type: ignore[attr-defined]
    renderer._for_parts()[1]._kernels.seed = seed  # type: ignore[attr-defined]
    assert torch.equal(renderer.pixels(cameras, parts), expected)


@pytest.mark.parametrize("counts", [(300, 200), (900, 700)])  # one slab, and several
def test_gaussians_of_equal_depth_are_blended_in_the_order_of_part_and_index(
    make: Make, counts: tuple[int, int]
) -> None:
    g, flat = torch.Generator().manual_seed(1), []
    for count in counts:
        means = torch.cat([torch.full((count, 1), 2.0), 0.3 * torch.randn(count, 2, generator=g)], 1)
        means[::7, 0] = 2.5
        flat.append(gaussians(means.tolist(), torch.rand(count, 3, generator=g).tolist(), 0.2, 0.1).float())
    renderer = make(flat)
    both = [placed(1, (first, IDENTITY), (1 - first, IDENTITY)) for first in (0, 1)]
    drawn = [images(renderer, ahead(), parts) for parts in both]
    for parts, image in zip(both, drawn, strict=True):
        assert_equal(image, images(make([in_world(flat, parts, 0)]), ahead()))
    assert not torch.equal(drawn[0][0], drawn[1][0])


def test_the_nearer_part_hides_the_one_behind_it_whatever_their_order(make: Make) -> None:
    red, green = [0.9, 0.1, 0.1], [0.1, 0.9, 0.1]
    renderer, cameras = make(walls(red, green)), ahead(19, 13)
    for depths, expected in (((2.0, 3.0), red), ((3.0, 2.0), green), ((2.0, 2.0), red)):
        image = renderer.render(cameras, placed(1, (0, at(depths[0])), (1, at(depths[1]))))
        assert (image.rgb[0, 6, 9] - torch.tensor(expected)).abs().max() < 2e-3
        assert image.depth[0, 6, 9].item() == pytest.approx(min(depths), abs=0.01)


def test_the_maximum_number_of_parts_is_drawn_correctly_and_one_more_is_refused(make: Make) -> None:
    models, cameras = random_models([0, 0, 0], (60, 30, 9)), random_cameras(39, 1, 40, 35)
    numbers = torch.arange(MOST_PARTS) % 4 - 1  # a quarter of them absent
    parts = Parts(numbers[None], random_poses(42, 1, MOST_PARTS))
    expected, pixels = drawn_in_world(make, models, cameras, parts)
    assert_like(make(models).render(cameras, parts), expected, 1e-3)
    assert_same_bytes(make(models).pixels(cameras, parts), pixels, 1e-3)
    more = placed(1, *[(0, IDENTITY)] * (MOST_PARTS + 1))
    with pytest.raises(ValueError, match=r"parts\.model: expected at most 128 parts per row, got 129"):
        make(models).pixels(cameras, more)


def test_a_row_without_parts_shows_the_background(make: Make) -> None:
    models, cameras = random_models([1, 0, 2]), random_cameras(31, 3, 9, 7)
    nothing = torch.full((3, 2, 4, 4), torch.nan)
    renderer = make(models)
    for parts in (Parts(torch.full((3, 2), ABSENT), nothing), Parts(torch.zeros(3, 0).long(), nothing[:, :0])):
        pixels, rgb, depth, alpha = images(renderer, cameras, parts)
        assert (pixels == torch.tensor([51, 102, 153], dtype=torch.uint8)).all()
        assert torch.allclose(rgb, torch.tensor(BACKGROUND)) and not depth.any() and not alpha.any()
    renderer.raise_faults()


def test_only_the_rows_that_are_asked_for_are_drawn_and_the_parts_of_others_are_not_read(make: Make) -> None:
    models, cameras, parts = random_models([2, 1, 1]), random_cameras(31, 4, 19, 13), random_parts(32, 4)
    renderer, only = make(models), torch.tensor([False, True, True, False])
    whole = images(renderer, cameras, parts)
    parts.model[0] = 99
    for part, expected in zip(renderer.render(cameras, parts, only), whole[1:], strict=True):
        assert torch.equal(part[only], expected[only]) and not part[~only].any()
    assert torch.equal(renderer.pixels(cameras, parts, only), whole[0] * only.view(-1, 1, 1, 1))
    renderer.raise_faults()


FAULTS = {
    "model": (3, IDENTITY),
    "negative": (-2, IDENTITY),
    "nan": (1, torch.full((4, 4), torch.nan)),
    "scaled": (1, torch.diag(torch.tensor([1.1, 1.1, 1.1, 1.0]))),
    "mirrored": (1, torch.diag(torch.tensor([1.0, -1.0, 1.0, 1.0]))),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_part_that_cannot_be_placed_is_not_drawn_and_the_fault_is_reported_later(make: Make, fault: str) -> None:
    models, cameras = random_models([0, 0, 0]), random_cameras(31, 4, 19, 13)
    right, wrong = (placed(4, (0, IDENTITY), (ABSENT, IDENTITY), (2, at(0.3))) for _ in range(2))
    renderer = make(models)
    wrong.model[2, 1], wrong.model_to_world[2, 1] = FAULTS[fault]
    assert_equal(images(renderer, cameras, wrong), images(renderer, cameras, right))
    with pytest.raises(ValueError, match=r"parts\[2\]: expected -1 or models in \[0, 3\), rigid model_to_world"):
        renderer.raise_faults()
    renderer.raise_faults()  # a fault is reported once


@pytest.mark.parametrize("bound", ["memory", "index"])
def test_a_row_with_more_gaussians_than_fit_shows_the_background_and_is_reported_later(
    make: Make, bound: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    models, cameras = random_models([0, 0, 0]), random_cameras(31, 3, 19, 13)  # of 250, 90 and 40 Gaussians
    if bound == "index":
        monkeypatch.setattr(cuda_parts_module, "MOST_INDICES", 340)
    renderer = make(models, most_gaussians=340) if bound == "memory" else make(models)
    parts = Parts(torch.tensor([[0, 1, ABSENT], [0, 1, 2], [1, 1, 1]]), IDENTITY.repeat(3, 3, 1, 1))
    pixels = renderer.pixels(cameras, parts)
    assert (pixels[1] == torch.tensor([51, 102, 153], dtype=torch.uint8)).all()
    expected = make(models).pixels(cameras, Parts(parts.model[:, :2], parts.model_to_world[:, :2]))
    assert torch.equal(pixels[0], expected[0])
    with pytest.raises(ValueError, match=r"parts\[1\]: .* together at most (340|268,435,456) Gaussians"):
        renderer.raise_faults()


def test_the_image_of_an_invalid_camera_is_black_with_parts_too(make: Make) -> None:
    renderer, cameras, parts = make(random_models([0, 0, 0])), random_cameras(31, 4, 19, 13), random_parts(32, 4)
    cameras.camera_to_world[2, 0, 3] = torch.inf
    pixels = renderer.pixels(cameras, parts)
    assert not pixels[2].any() and pixels[[0, 1, 3]].flatten(1).any(1).all()
    with pytest.raises(ValueError, match=r"cameras\[2\]: expected rigid"):
        renderer.raise_faults()
    renderer.raise_faults()


def test_efforts_of_parts_add_up(make: Make) -> None:
    models, cameras, parts = random_models([1, 0, 2]), random_cameras(39, 3), random_parts(40, 3)
    renderer = make(models)
    each = [
        renderer.efforts(cameras, Parts(model[:, None], pose[:, None]))
        for model, pose in zip(*(value.unbind(1) for value in parts), strict=True)
    ]
    assert torch.equal(renderer.efforts(cameras, parts)[:, 0], torch.stack(each).sum(0)[:, 0])


def test_drawing_parts_never_synchronises_with_the_host() -> None:
    renderer = CudaRenderer(random_models([0, 0, 0]), load=emulated)
    cameras, parts, only = random_cameras(31, 3, 9, 7), random_parts(32, 3), torch.tensor([True, False, True])
    with NoHostReads():
        renderer.pixels(cameras, parts)
        renderer.render(cameras, parts, only)


def test_invalid_parts_models_and_limits_are_refused() -> None:
    renderer, cameras = CudaRenderer(random_gaussians(0, 9), load=emulated), random_cameras(31, 3, 9, 7)
    with pytest.raises(ValueError, match=r"parts\.model: expected \[3, M\] torch.int64"):
        renderer.pixels(cameras, placed(4, (0, IDENTITY)))
    with pytest.raises(ValueError, match="scene: expected at least one model, got none"):
        CudaRenderer([], load=emulated)
    with pytest.raises(ValueError, match="most_gaussians: expected a number from 1 to 268,435,456, got 268,435,457"):
        CudaRenderer(random_gaussians(0, 9), most_gaussians=2**28 + 1, load=emulated)


def test_a_model_with_more_gaussians_than_a_key_can_address_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cuda_models_module, "MOST_INDICES", 89)
    with pytest.raises(ValueError, match=r"scene\[1\]: expected at most 89 Gaussians, merged ones included, got 90"):
        CudaRenderer(random_models([0, 0, 0], (40, 90, 40)), load=emulated)
