"""Selected rows of a batch are drawn as in the whole batch, and no others are drawn."""

from collections.abc import Callable

import pytest
import torch

from splatrl.renderers import LatticeRenderer, NativeRenderer, ReferenceRenderer, Renderer
from tests.renderers.cases import random_cameras, random_gaussians

SCENE = random_gaussians(5, 60)
MAKERS: list[Callable[[], Renderer]] = [
    lambda: ReferenceRenderer(SCENE, background=(0.2, 0.4, 0.6)),
    lambda: NativeRenderer(SCENE, background=(0.2, 0.4, 0.6)),
    lambda: LatticeRenderer(NativeRenderer(SCENE, background=(0.2, 0.4, 0.6))),
]


@pytest.mark.parametrize("make", MAKERS, ids=["reference", "native", "lattice"])
@pytest.mark.parametrize("rows", [[], [2], [0, 3], [0, 1, 2, 3]])
def test_rows_that_are_not_asked_for_are_zero_and_the_others_unchanged(
    make: Callable[[], Renderer], rows: list[int]
) -> None:
    renderer, cameras = make(), random_cameras(6, 4, 19, 13)
    only = torch.zeros(4, dtype=torch.bool)
    only[rows] = True
    pixels, whole = renderer.pixels(cameras, only=only), renderer.pixels(cameras)
    assert pixels.dtype == torch.uint8 and pixels.shape == whole.shape
    assert torch.equal(pixels, whole * only.view(-1, 1, 1, 1)) and whole[0, 0, 0].any()
    for part, expected in zip(renderer.render(cameras, only=only), renderer.render(cameras), strict=True):
        assert torch.equal(part[only], expected[only]) and not part[~only].any()


@pytest.mark.parametrize("only", [torch.zeros(3, dtype=torch.bool), torch.zeros(4), torch.tensor([0, 1, 0, 1])])
@pytest.mark.parametrize("make", MAKERS, ids=["reference", "native", "lattice"])
def test_anything_but_a_mask_over_the_batch_is_refused(make: Callable[[], Renderer], only: torch.Tensor) -> None:
    with pytest.raises(ValueError, match=r"only: expected \[4\] torch.bool, got"):
        make().pixels(random_cameras(6, 4, 19, 13), only=only)


def test_gradients_reach_the_scene_through_the_rows_that_are_drawn() -> None:
    scene = SCENE.clone()
    scene.opacities.requires_grad_()
    rgb = ReferenceRenderer(scene).render(random_cameras(6, 3, 19, 13), only=torch.tensor([False, True, False])).rgb
    rgb[0].sum().backward(retain_graph=True)
    assert not scene.opacities.grad.any()
    rgb[1].sum().backward()
    assert scene.opacities.grad.any()


def test_a_tensor_to_draw_into_cannot_be_combined_with_a_mask() -> None:
    cameras, out = random_cameras(6, 3, 19, 13), torch.zeros(3, 13, 19, 3, dtype=torch.uint8)
    with pytest.raises(ValueError, match="out: cannot be combined with only"):
        NativeRenderer(SCENE).pixels(cameras, only=torch.ones(3, dtype=torch.bool), out=out)
