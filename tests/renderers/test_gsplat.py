"""gsplat behind our interface: without a GPU, the arguments that it gets; on a GPU, the images that it draws."""

import sys
from typing import Any

import pytest
import torch

from splatrl.renderers import ReferenceRenderer
from splatrl.renderers.gsplat import GsplatRenderer
from tests.renderers.cases import double, gaussians, psnr, random_cameras, random_gaussians
from tests.renderers.parts_cases import random_parts
from tests.renderers.pretended_gsplat import modules, rasterization

BACKGROUND = (0.2, 0.5, 0.9)


@pytest.fixture
def batches(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Install a fake gsplat that draws with the reference, and return how many cameras each of its calls gets."""
    calls: list[int] = []

    def noted(**arguments: Any) -> Any:
        calls.append(len(arguments["viewmats"]))
        return rasterization(**arguments)

    pretend(monkeypatch, rasterization=noted)
    return calls


def pretend(monkeypatch: pytest.MonkeyPatch, **contents: Any) -> None:
    """Install a fake gsplat with these contents."""
    for name, module in modules(**contents).items():
        monkeypatch.setitem(sys.modules, name, module)


@pytest.mark.usefixtures("batches")
@pytest.mark.parametrize("antialiased", [True, False])
@pytest.mark.parametrize("degree", [0, 2])
def test_gsplat_gets_scene_and_cameras_in_its_own_conventions(antialiased: bool, degree: int) -> None:
    scene, cameras = random_gaussians(1, 80, degree), random_cameras(2)
    renderer = GsplatRenderer(double(scene), antialiased, BACKGROUND, device="cpu")
    reference = ReferenceRenderer(scene, antialiased, BACKGROUND)
    image, expected = renderer.render(cameras), reference.render(cameras)
    assert all(part.dtype == torch.float32 for part in image)
    for part, truth in zip(image, expected, strict=True):
        torch.testing.assert_close(part, truth, atol=1e-4, rtol=1e-4)  # not exact, since poses are inverted twice
    assert (renderer.pixels(cameras).int() - reference.pixels(cameras).int()).abs().max() <= 1


def test_large_batches_are_split_to_fit_into_memory(batches: list[int]) -> None:
    scene, cameras = random_gaussians(1, 80), random_cameras(2, 5)
    whole = GsplatRenderer(scene, device="cpu").pixels(cameras)
    renderer = GsplatRenderer(scene, device="cpu", memory=2 * 80 * 140)
    assert torch.equal(renderer.pixels(cameras), whole)
    assert batches == [5, 2, 2, 1]
    assert GsplatRenderer(scene, device="cpu", memory=0).at_once == 1


def test_only_the_rows_that_are_asked_for_are_drawn(batches: list[int]) -> None:
    renderer, cameras = GsplatRenderer(random_gaussians(1, 80), True, BACKGROUND, device="cpu"), random_cameras(2, 4)
    whole, only = renderer.pixels(cameras), torch.tensor([True, False, False, True])
    assert torch.equal(renderer.pixels(cameras, only=only), whole * only.view(-1, 1, 1, 1))
    assert batches == [4, 2]
    nothing = torch.zeros(4, dtype=torch.bool)
    assert not renderer.pixels(cameras, only=nothing).any() and not renderer.render(cameras, only=nothing).rgb.any()
    assert renderer.render(cameras[:0]).rgb.shape == (0, 22, 37, 3) and batches == [4, 2]


@pytest.mark.usefixtures("batches")
def test_parts_and_several_models_are_refused() -> None:
    scene, cameras = random_gaussians(1, 80), random_cameras(2, 4)
    with pytest.raises(ValueError, match=r"parts: expected none, .* got \[4, 4\]$"):
        GsplatRenderer(scene, device="cpu").pixels(cameras, random_parts(3, 4))
    with pytest.raises(ValueError, match=r"scene: expected one model, .* got 2$"):
        GsplatRenderer([scene, scene], device="cpu")
    one = GsplatRenderer([scene], device="cpu").pixels(cameras)
    assert torch.equal(one, GsplatRenderer(scene, device="cpu").pixels(cameras))


@pytest.mark.usefixtures("batches")
def test_a_camera_that_is_not_finite_is_refused() -> None:
    cameras = random_cameras(2, 4)
    cameras.camera_to_world[2, 0, 0] = torch.nan
    with pytest.raises(ValueError, match=r"camera_to_world\[2\]: expected finite numbers"):
        GsplatRenderer(random_gaussians(1, 80), device="cpu").pixels(cameras)


def test_without_gsplat_the_error_says_how_to_install_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "gsplat", None)
    with pytest.raises(ImportError, match=r"pip install 'splatrl\[gsplat\]'"):
        GsplatRenderer(gaussians([[1.0, 0.0, 0.0]]), device="cpu")


def test_with_gsplat_but_no_compiler_the_error_says_what_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    pretend(monkeypatch, extension=None)
    with pytest.raises(ImportError, match=r"gsplat 1.5.3 is installed, but nvcc was not found"):
        GsplatRenderer(gaussians([[1.0, 0.0, 0.0]]), device="cpu")


@pytest.mark.gpu
@pytest.mark.parametrize("degree", [0, 3])
def test_classic_images_match_those_of_the_reference(cuda_device: torch.device, degree: int) -> None:
    pytest.importorskip("gsplat")
    scene, cameras = random_gaussians(3, 300, degree), random_cameras(4)
    try:
        renderer = GsplatRenderer(scene, False, BACKGROUND, device=cuda_device)
    except ImportError as error:
        pytest.skip(str(error))
    image, truth = renderer.render(cameras), ReferenceRenderer(double(scene), False, BACKGROUND).render(cameras)
    assert psnr(image.rgb, truth.rgb) >= 50.0  # a Gaussian at the limit of 1/255 may fall on either side of it
    assert psnr(image.alpha, truth.alpha) >= 50.0
    covered = truth.alpha > 0.05
    assert ((image.depth - truth.depth).abs() / truth.depth)[covered].mean() < 1e-3
