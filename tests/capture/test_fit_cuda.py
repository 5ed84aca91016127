"""The GPU fit against the CPU fit: its kernels run in an emulator and, where there is one, on a GPU."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor

from splatrl.capture.base import Reconstruction
from splatrl.capture.fitting import cuda as fit_cuda
from splatrl.capture.fitting.cuda import CudaFitter
from splatrl.capture.fitting.fit import FitSettings, Fitting, fit
from splatrl.capture.fitting.structs import kernel_defines
from splatrl.capture.stereo import IGNORED
from splatrl.native import _core
from tests.capture.test_fit import COUNT as FEW
from tests.capture.test_fit import (
    GROUPS,
    HEIGHT,
    SETTINGS,
    WIDTH,
    cosine,
    held_out_psnr,
    known_depths,
    random_values,
    same_bytes,
    tiny_capture,
)
from tests.emulator import emulated
from tests.renderers.cases import random_cameras, random_gaussians

NEAR = 0.01
PHOTOS = 3
CHOSEN = torch.tensor([2, 0])
"""Indices of the photos that the two views are compared with."""


@pytest.fixture(params=["emulated", pytest.param("gpu", marks=pytest.mark.gpu)])
def fitter(request: pytest.FixtureRequest) -> CudaFitter:
    """A fitter that runs its kernels in the emulator or on the GPU."""
    if request.param == "gpu":
        return CudaFitter(request.getfixturevalue("cuda_device"))
    return CudaFitter("cpu", emulated)


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Reconstruction:
    return tiny_capture(tmp_path_factory.mktemp("photos"))


def crowd() -> tuple[Tensor, int]:
    """Return parameters of more faint Gaussians than a block loads at once, and the number of Gaussians."""
    cloud = random_gaussians(4, 700, 1)
    values = torch.zeros(23, 704)
    values[6] = 1.0
    columns = (cloud.means.T, cloud.scales.log().T, cloud.quats.T, cloud.opacities.clamp(0.01, 0.3).logit()[None])
    values[:, :700] = torch.cat([*columns, 0.3 * cloud.sh.flatten(1).T])
    return values, 700


MODELS: dict[str, Callable[[], tuple[Tensor, int]]] = {
    **{f"degree {degree}": lambda degree=degree: (random_values(degree), FEW) for degree in range(4)},
    "a crowd": crowd,
}


def photos() -> tuple[Tensor, Tensor, Tensor]:
    """Return pixels, known depths and exposures of the photos."""
    pixels = torch.randint(
        0, 256, (PHOTOS, HEIGHT, WIDTH, 3), dtype=torch.uint8, generator=torch.Generator().manual_seed(2)
    )
    known = torch.cat([known_depths(2).flip(0), known_depths(1)])
    known[1] = 9.0  # no view is compared with this photo
    known[2, 3:9, 12:25] = IGNORED
    exposure = torch.tensor([[[0.9, 0.1]] * 3, [[5.0, 5.0]] * 3, [[1.1, 0.02], [0.9, -0.01], [1.2, 0.0]]])
    return pixels, known, exposure


def there(device: torch.device, *values: Any) -> list[Any]:
    """Return copies of tensors on a device, and everything else unchanged."""
    return [value.to(device, copy=True) if isinstance(value, Tensor) else value for value in values]


def drawn(fitter: Any, values: Tensor, count: int, device: str | torch.device = "cpu") -> list[Tensor]:
    """Return images of two views, and gradients of parameters and poses for random gradients of these, on the CPU."""
    cameras = random_cameras(5, 2, WIDTH, HEIGHT)
    slopes = torch.randn(2, HEIGHT, WIDTH, 5, generator=torch.Generator().manual_seed(1))
    images = torch.empty(2, HEIGHT, WIDTH, 3), torch.empty(2, HEIGHT, WIDTH), torch.empty(2, HEIGHT, WIDTH)
    gradients, poses = torch.zeros(2, *values.shape), torch.empty(2, 6)
    out = there(torch.device(device), *images, gradients, poses)
    model = values, count, NEAR, cameras.camera_to_world, cameras.K.contiguous(), known_depths(2)
    fitter.render(*there(torch.device(device), *model), *out[:3], 1)
    fitter.pull(*there(torch.device(device), *model, slopes), *out[3:], 1)
    return [value.cpu() for value in out]


def compared(fitter: Any, values: Tensor, count: int, device: str | torch.device = "cpu") -> tuple[Tensor, Tensor]:
    """Return gradients of the parameters, and losses, of two views against their photos."""
    cameras = random_cameras(5, 2, WIDTH, HEIGHT)
    pixels, known, exposure = photos()
    here = there(torch.device(device), values, count, NEAR)
    seen = there(torch.device(device), pixels, known)
    gradients, losses = torch.zeros(2, *values.shape, device=device), torch.empty(2, 16)
    lenses = cameras.camera_to_world, cameras.K.contiguous()
    fitter.compare(*here, *lenses, *seen, CHOSEN, exposure, 0.2, 0.3, gradients, losses, 1)
    return gradients.cpu(), losses


def assert_same_slopes(found: Tensor, expected: Tensor, count: int) -> None:
    """Check that gradients [V, R, C] have the same direction and length in every group of parameters."""
    for name, (first, last) in GROUPS.items():
        mine, true = found[:, first:last, :count], expected[:, first:last, :count]
        assert cosine(mine, true) > 0.99999, name
        assert float(mine.norm() / true.norm()) == pytest.approx(1.0, abs=1e-4), name


@pytest.mark.parametrize("model", MODELS)
def test_views_and_gradients_match_the_cpu(fitter: CudaFitter, model: str) -> None:
    values, count = MODELS[model]()
    found, expected = drawn(fitter, values, count, fitter.device), drawn(_core.Fitter(), values, count)
    for mine, true in zip(found[:3], expected[:3], strict=True):
        apart = (mine - true).abs()  # a faint splat may end the blending of a pixel earlier on one device
        assert float((apart > 1e-4).float().mean()) < 1e-3 and float(apart.max()) < 1e-3
    assert expected[1].amax() > 0.3 and expected[2].amax() > 0.5
    assert_same_slopes(found[3], expected[3], count)
    assert (found[3][:, :, count:] == 0).all()
    assert torch.allclose(found[4], expected[4], rtol=1e-3, atol=1e-3 * float(expected[4].abs().max()))


@pytest.mark.parametrize("model", MODELS)
def test_the_loss_and_its_gradients_match_the_cpu(fitter: CudaFitter, model: str) -> None:
    values, count = MODELS[model]()
    gradients, losses = compared(fitter, values, count, fitter.device)
    true_gradients, true_losses = compared(_core.Fitter(), values, count)
    assert torch.allclose(losses[:, :4], true_losses[:, :4], rtol=1e-5, atol=1e-6)
    assert (true_losses[:, 3] > 0.1).all()
    for part in (slice(4, 10), slice(10, 16)):  # gradients of the exposure and of the pose
        assert torch.allclose(losses[:, part], true_losses[:, part], rtol=1e-3, atol=1e-5)
        assert cosine(losses[:, part], true_losses[:, part]) > 0.99999
    assert_same_slopes(gradients, true_gradients, count)


@pytest.mark.parametrize("noise", [0.0, 1e2])
def test_an_optimiser_step_matches_the_cpu(fitter: CudaFitter, noise: float) -> None:
    random, values = torch.Generator().manual_seed(7), random_values(1)
    gradients = torch.randn(3, *values.shape, generator=random)
    first, second = torch.randn(values.shape, generator=random), torch.rand(values.shape, generator=random)
    rates = torch.rand(len(values), generator=random) * 0.01
    numbers = 5, 0.8, 0.997, 1e-15, 0.4, 0.3, noise, (3 << 40) + 12345, 1
    found, expected = there(fitter.device, values, gradients, first, second), [values, gradients, first, second]
    before = values.clone()
    fitter.update(*found, rates, *numbers)
    _core.Fitter().update(*expected, rates, *numbers)
    for mine, true in zip(found, expected, strict=True):
        assert torch.allclose(mine.cpu(), true, rtol=1e-5, atol=1e-6)
    means = (values - before)[:3]
    assert (means.norm(dim=0) > 0.05).any() == (noise > 0)


def test_a_view_of_nothing_is_black_and_has_zero_gradients(fitter: CudaFitter) -> None:
    values = random_values(0)
    values[2] += 1e4
    rgb, agreement, alpha, gradients, poses = drawn(fitter, values, FEW, fitter.device)
    for value in (rgb, agreement, alpha, gradients, poses):
        assert (value == 0).all()


@pytest.mark.parametrize("seed", [1, 2])
def test_the_order_in_which_threads_run_changes_no_byte(seed: int) -> None:
    fitter = CudaFitter("cpu", emulated)
    values, count = MODELS["degree 1"]()
    expected = compared(fitter, values, count)
    for kernels in fitter._kernels.values():
        kernels.seed = seed  # type: ignore[attr-defined]
    assert all(torch.equal(*pair) for pair in zip(compared(fitter, values, count), expected, strict=True))


def test_parameters_whose_rows_match_no_harmonic_degree_are_refused() -> None:
    with pytest.raises(ValueError, match="values: expected 14, 23, 38 or 59 rows, got 15"):
        drawn(CudaFitter("cpu", emulated), torch.zeros(15, 16), 1)


SHORT = replace(SETTINGS, cap=130, start_share=1.0, levels=((0.0, 0.5),), refine=(0.0, 1.0), refine_every=3, poses=1e-3)


def test_a_short_fit_matches_the_cpu(capture: Reconstruction) -> None:
    """The fit also relocates and adds Gaussians, and learns exposures and poses."""
    fittings = Fitting(capture, SHORT), Fitting(capture, SHORT)
    fittings[1]._core = CudaFitter("cpu", emulated)
    for one in fittings:
        one.model.values[10, :20] = -6.0  # these count as dead
    losses = torch.tensor([[one.step(step, 8) for one in fittings] for step in range(8)])
    assert torch.allclose(losses[:, 0], losses[:, 1], rtol=1e-3)
    one, other = fittings
    assert one.model.count == other.model.count
    assert cosine(one.exposure.values - 1, other.exposure.values - 1) > 0.999
    assert one.moves.values.abs().max() > 0 and cosine(one.moves.values, other.moves.values) > 0.99


class NoKernels:
    """Stub kernels that check the device of their tensors, record their name and compute nothing."""

    def __init__(self, *_: Any) -> None:
        self.launched: list[str] = []

    def launch(self, name: str, blocks: int, threads: int, *arguments: Any, shared: int = 0) -> None:
        assert all(value.device.type == "meta" for value in arguments if isinstance(value, Tensor)), name
        self.launched.append(name)


def test_a_step_mixes_no_devices_and_reads_back_only_list_lengths_and_losses(
    capture: Reconstruction, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The meta device holds no data, and its tensors cannot be mixed with those of another device."""
    read: list[tuple[int, ...]] = []

    def pretend(values: Tensor, device: torch.device) -> Tensor:
        read.append(tuple(values.shape))
        return torch.full(values.shape, 300, dtype=values.dtype, device=device)

    fitting = Fitting(capture, replace(SHORT, device="meta"))
    monkeypatch.setattr(fit_cuda, "CudaKernels", NoKernels)
    monkeypatch.setattr(fit_cuda, "_read", pretend)
    for step in range(2):
        fitting.step(step, 4)
    launched = fitting._core._kernels[0].launched
    assert launched[:8] == launched[8:] and len(set(launched)) == 8
    assert read == [(1,), (2, 21)] * 2  # the length of the lists, and the terms of the losses


@pytest.mark.gpu
def test_a_fit_on_a_gpu_looks_like_its_held_out_photos_and_is_reproducible(
    cuda_device: torch.device, capture: Reconstruction
) -> None:
    settings = replace(SETTINGS, device=str(cuda_device))
    fitted = fit(capture, settings)
    assert held_out_psnr(fitted, capture) > 25.0 and fitted.means.device.type == "cpu"
    assert same_bytes(fitted, fit(capture, settings))


@pytest.mark.gpu
def test_all_tensors_that_a_step_needs_are_on_the_gpu(cuda_device: torch.device, capture: Reconstruction) -> None:
    fitting = Fitting(capture, FitSettings(width=48, cap=600, device=str(cuda_device)))
    model, (seen, known) = fitting.model, fitting.level(0.0)
    tensors = (model.values, model.first, model.second, seen.pixels, known, fitting._gradients)
    assert {value.device for value in tensors} == {cuda_device}


def test_no_kernel_needs_more_shared_memory_than_a_block_may_have() -> None:
    assert max(size for name, size in kernel_defines(0).items() if name.endswith("_BYTES")) <= 48 * 1024
