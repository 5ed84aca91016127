"""Views per second of the fit of Gaussians on a GPU, and the agreement of its gradients with the CPU's."""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from gpu_bench import Bench, on
from gpu_device import Rate, in_turns, peak_memory, rate
from torch import Tensor

from splatrl.cameras import Cameras
from splatrl.capture.fitting.cuda import CudaFitter
from splatrl.capture.fitting.model import Model
from splatrl.native import _core
from splatrl.scenes import Gaussians

DEGREE, NEAR = 1, 0.02
SSIM_WEIGHT, DEPTH_WEIGHT = 0.2, 0.1
BETAS, EPSILON = (0.9, 0.999), 1e-15
STILL = 1e-12
"""Scale of the MCMC noise, which is computed but moves nothing, so that every step does the same work; the learning
rates are 0 for the same reason."""


@dataclass(frozen=True)
class Fit:
    """A row of the table: views per second of whole steps, with rendering, loss, backward pass and a step of Adam.

    ``cosine`` is the cosine similarity of all gradients of one view with the CPU's.
    """

    what = "fit"
    gaussians: int
    width: int
    height: int
    views_a_step: int
    views_per_second: Rate
    cosine: float
    memory_bytes: int


@dataclass(frozen=True)
class Photos:
    """Views and photos to which Gaussians are fitted, on the fit's device; see ``CudaFitter.compare``."""

    cameras: Cameras
    pixels: Tensor
    known: Tensor
    exposure: Tensor


def fitting(bench: Bench) -> None:
    """Measure the step of a finished fit at each number of views per step."""
    fitter = bench.fitter()
    for number, (name, width, height) in enumerate(bench.sizes.fits):
        subject = bench.fitted(name)
        model = model_of(subject.scene.gaussians, bench.device)
        views = subject.room.views(max(bench.sizes.fit_views), width, height)
        photos = photos_of(bench, subject.scene.gaussians, views)
        steps = {count: stepping(fitter, model, photos, count) for count in bench.sizes.fit_views}
        with peak_memory(bench.device) as memory:
            times = in_turns(steps, bench.device, 0.7 * bench.left / (len(bench.sizes.fits) - number))
        likeness = agreement(fitter, model, photos)
        for count, seconds in times.items():
            found = rate(count, seconds)
            bench.keep(Fit(model.count, width, height, count, found, likeness, memory[0]))
        bench.free()


def model_of(gaussians: Gaussians, device: torch.device) -> Model:
    """Return the Gaussians as parameters of a fit, with slightly wrong colours."""
    count, harmonics = len(gaussians.means), min(gaussians.sh.shape[1], (DEGREE + 1) ** 2)
    columns = torch.zeros(11 + 3 * (DEGREE + 1) ** 2, count)
    columns[0:3], columns[3:6], columns[6:10] = gaussians.means.T, gaussians.scales.log().T, gaussians.quats.T
    columns[10] = gaussians.opacities.clamp(0.01, 0.99).logit()
    columns[11 : 11 + 3 * harmonics] = gaussians.sh[:, :harmonics].flatten(1).T
    columns[11:] += 0.05 * torch.randn(columns[11:].shape, generator=torch.Generator().manual_seed(0))
    model = Model(count, DEGREE, device)
    model.add(columns)
    return model


def photos_of(bench: Bench, gaussians: Gaussians, views: Cameras) -> Photos:
    """Render views of the true Gaussians as photos, with inverse depths where something solid is seen."""
    renderer = bench.renderer(gaussians)
    seen = renderer.render(on(views, bench.device))
    known = torch.where(seen.alpha > 0.9, 1.0 / seen.depth.clamp_min(NEAR), 0.0)
    exposure = torch.tensor([[[1.0, 0.0]] * 3] * len(views))
    return Photos(views, (255 * seen.rgb + 0.5).to(torch.uint8), known.contiguous(), exposure)


def compare(
    fitter: CudaFitter | _core.Fitter, values: Tensor, count: int, photos: Photos, views: int, gradients: Tensor
) -> Tensor:
    """Compute the losses and gradients of the first views against their photos, and return the losses."""
    cameras, losses = photos.cameras, torch.empty(views, 16)
    K = cameras.K.expand(len(cameras), 3, 3)[:views].contiguous()
    chosen = torch.arange(views)
    fitter.compare(
        values, count, NEAR, cameras.camera_to_world[:views].contiguous(), K, photos.pixels, photos.known, chosen,
        photos.exposure, SSIM_WEIGHT, DEPTH_WEIGHT, gradients, losses, 1,
    )  # fmt: skip
    return losses


def stepping(fitter: CudaFitter, model: Model, photos: Photos, views: int) -> Callable[[], None]:
    """Return a step of the fit that leaves the Gaussians unchanged."""
    rows, stride = model.values.shape
    gradients, rates = torch.zeros(views, rows, stride, device=model.values.device), torch.zeros(rows)

    def step() -> None:
        compare(fitter, model.values, model.count, photos, views, gradients)
        fitter.update(
            model.values, gradients, model.first, model.second, rates, 1, *BETAS, EPSILON, 0.0, 0.0, STILL, 0, 1
        )  # fmt: skip

    return step


def agreement(fitter: CudaFitter, model: Model, photos: Photos) -> float:
    """Return the cosine similarity of one view's gradients with those of the CPU."""
    there = Photos(photos.cameras, photos.pixels.cpu(), photos.known.cpu(), photos.exposure)
    found = torch.zeros(1, *model.values.shape, device=model.values.device)
    expected = torch.zeros(1, *model.values.shape)
    compare(fitter, model.values, model.count, photos, 1, found)
    compare(_core.Fitter(), model.values.cpu().clone(), model.count, there, 1, expected)
    return float(torch.nn.functional.cosine_similarity(found.cpu().double().flatten(), expected.double().flatten(), 0))
