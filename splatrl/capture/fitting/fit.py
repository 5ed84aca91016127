"""Fit Gaussians to photos with known poses, on a CPU or a GPU.

Every step renders a few views with ``splatrl.native``, on a CPU with one thread per view, compares them with their
photos by L1 and structural similarity, backpropagates to all parameters and takes a step of Adam. Gaussians that became
transparent are relocated to opaque ones (MCMC, Kheradmand et al. 2024). Results do not depend on the number of threads.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from splatrl.capture.base import CaptureError, Reconstruction
from splatrl.capture.fitting.cameras import Learned, turned
from splatrl.capture.fitting.checkpoint import Checkpoint
from splatrl.capture.fitting.cuda import CudaFitter
from splatrl.capture.fitting.model import LOG_SCALE, LOGIT, MEAN, QUAT, SH, Model
from splatrl.capture.fitting.pictures import Frame, Pictures, frame_of, pictures
from splatrl.capture.fitting.start import start
from splatrl.capture.stereo import Depths, find_depths
from splatrl.native import _core
from splatrl.native.threads import usable_cores
from splatrl.scenes.gaussians import Gaussians
from splatrl.values import require_number

HELD_OUT = 8
"""One view in this many is held out and never trained on."""
NEAR = 0.02
"""Near plane, in units of the cameras' extent: Gaussians nearer than this are not drawn."""
BETAS = (0.9, 0.999)
EPSILON = 1e-15
STEADY = 0.1
"""Fraction of the views that is drawn before exposures and poses are learned."""
EXPOSURE_RATE = 2e-3

Told = Callable[[int, int, float], None]
"""Progress callback: receives the number of views drawn so far, the total number, and the last loss."""


@dataclass(frozen=True)
class FitSettings:
    """Settings of a fit.

    Attributes:
        width: width of the images that are compared, pixels; at most that of the photos.
        cap: maximum number of Gaussians.
        views: number of views drawn in total; the duration of a fit is proportional to it.
        views_a_step: number of views drawn per step of the optimiser, each by its own thread.
        sh_degree: degree of the spherical harmonics, 0 to 3.
        levels: coarse-to-fine schedule: pairs of the fraction of the views from which an image size is used, and that
            size as a fraction of the width.
        start_share: minimum fraction of the cap that is filled at the start.
        refine: fractions of the views at which relocating and adding Gaussians begins and ends.
        refine_every: number of steps between two such refinements.
        ssim_weight: weight of the structural similarity in the loss, against L1.
        depth_weight: weight of the depth loss, which penalises what lies in front of or behind a pixel's known depth,
            and see-through pixels.
        opacity_weight: weight of the opacity regulariser.
        scale_weight: weight of the scale regulariser.
        noise: strength of MCMC's noise on the positions.
        exposure: whether each photo gets a brightness and a tint of its own.
        poses: learning rate of the poses, in radians and in units of the cameras' extent; 0 keeps them fixed.
        seed: seed of everything that is random.
        threads: number of threads; None uses all cores that this process may use.
        device: where the Gaussians are fitted: a CPU, or a GPU, whose kernels come with the extra ``cuda``.
    """

    width: int = 320
    cap: int = 60_000
    views: int = 7_000
    views_a_step: int = 2
    sh_degree: int = 1
    levels: tuple[tuple[float, float], ...] = ((0.0, 0.25), (0.3, 0.5), (0.7, 1.0))
    start_share: float = 0.5
    refine: tuple[float, float] = (0.04, 0.8)
    refine_every: int = 50
    ssim_weight: float = 0.2
    depth_weight: float = 0.2
    opacity_weight: float = 0.01
    scale_weight: float = 0.01
    noise: float = 5e5
    exposure: bool = True
    poses: float = 0.0
    seed: int = 0
    threads: int | None = None
    device: str = "cpu"

    def __post_init__(self) -> None:
        for name in ("width", "cap", "views", "views_a_step", "refine_every"):
            require_number(name, getattr(self, name), 1, whole=True)
        require_number("sh_degree", self.sh_degree, 0, 3, whole=True)
        if self.threads is not None:
            require_number("threads", self.threads, 1, whole=True)


def held_out(count: int) -> Tensor:
    """Return which of ``count`` views are held out, that is, never trained on: [n] int64."""
    return torch.arange(0, count, HELD_OUT)


def trained(count: int) -> Tensor:
    """Return which of ``count`` views are trained on, all that ``held_out`` leaves: [n] int64."""
    every = torch.arange(count)
    return every[~torch.isin(every, held_out(count))]


def fit(
    reconstruction: Reconstruction,
    settings: FitSettings,
    progress: Told | None = None,
    depths: Depths | None = None,
    checkpoint: Checkpoint | None = None,
) -> Gaussians:
    """Fit Gaussians to the photos of a reconstruction, except those that ``held_out`` returns.

    Args:
        reconstruction: the photos, in order, with their poses.
        settings: settings of the fit.
        progress: called after every step.
        depths: depths that ``find_depths`` found in the ``frame_of`` the cameras; None finds them here.
        checkpoint: where the state is saved from time to time; a fit that was killed resumes from it, with a
            bit-identical result. None saves nothing.

    Returns:
        Gaussians on the CPU, in the frame and unit of the reconstruction, meant to be drawn antialiased on black.

    Raises:
        CaptureError: for fewer than two photos, or no points.
    """
    count = len(reconstruction.paths)
    if count < 2:
        raise CaptureError(f"paths: expected at least 2 photos, got {count}")
    fitting = Fitting(reconstruction, settings, depths)
    total = math.ceil(settings.views / fitting.views)
    first = 0 if checkpoint is None else checkpoint.resume(fitting.restore)
    for step in range(first, total):
        loss = fitting.step(step, total)
        if progress is not None:
            progress(min((step + 1) * fitting.views, settings.views), settings.views, loss)
        if checkpoint is not None and checkpoint.due():
            checkpoint.write(fitting.state(step + 1))
    return fitting.model.gaussians(fitting.frame)


class Fitting:
    """The state of a fit.

    Attributes:
        model: the Gaussians.
        frame: the frame that they are in.
        trained: [n] int64, indices of the views that are trained on.
        views: number of views drawn per step.
        exposure: gain and offset of each photo's channels, [N, 3, 2].
        moves: corrections of the poses, [N, 6].
    """

    def __init__(self, reconstruction: Reconstruction, settings: FitSettings, depths: Depths | None = None) -> None:
        self.settings = settings
        self.frame: Frame = frame_of(reconstruction.camera_to_world)
        self.generator = torch.Generator().manual_seed(settings.seed)
        self.threads = settings.threads or usable_cores()
        self.trained = trained(len(reconstruction.paths))
        self.views = min(settings.views_a_step, len(self.trained))
        widest = min(settings.width, reconstruction.width)
        depths = depths or find_depths(reconstruction, self.frame, self.trained, self.threads)
        scales = sorted({scale for _, scale in settings.levels})
        sizes = pictures(reconstruction, self.frame, [max(1, round(widest * scale)) for scale in scales])
        self.levels = {scale: (seen, depths.at(seen, self.trained)) for scale, seen in zip(scales, sizes, strict=True)}
        device = torch.device(settings.device)
        self.model = Model(settings.cap, settings.sh_degree, device)
        start(
            reconstruction, self.frame, sizes[-1], depths, self.trained, self.model, settings.start_share, settings.seed
        )
        for scale, (seen, known) in self.levels.items():
            self.levels[scale] = replace(seen, pixels=seen.pixels.to(device)), known.to(device)
        count = len(reconstruction.paths)
        self.exposure = Learned(torch.tensor([[[1.0, 0.0]] * 3] * count), EXPOSURE_RATE)
        self.moves = Learned(torch.zeros(count, 6), settings.poses)
        self._core = _core.Fitter() if device.type == "cpu" else CudaFitter(device)
        self._gradients = torch.zeros(self.views, *self.model.values.shape, device=device)
        self._order: list[int] = []

    def state(self, step: int) -> dict[str, Tensor]:
        """Return everything that the steps from ``step`` on depend on besides photos and settings, on the CPU."""
        values = {name: value.cpu() for name, value in self._tensors().items()}
        scalars = {"step": torch.tensor(step), "count": torch.tensor(self.model.count)}
        order = torch.tensor(self._order, dtype=torch.int64)
        return {**values, **scalars, "order": order, "generator": self.generator.get_state()}

    def restore(self, state: dict[str, Tensor]) -> int:
        """Resume from a state of the same fit; return the next step.

        Raises:
            ValueError: for the state of another fit; this one is then left as it was.
        """
        tensors, generator = self._tensors(), torch.Generator()
        step, count, order = int(state["step"]), int(state["count"]), state["order"]
        generator.set_state(state["generator"])
        for name, value in tensors.items():
            if (state[name].shape, state[name].dtype) != (value.shape, value.dtype):
                raise ValueError(f"{name}: expected {value.dtype} {list(value.shape)}, got {list(state[name].shape)}")
        if step < 1 or not 1 <= count <= self.model.cap or not torch.isin(order, self.trained).all():
            raise ValueError(
                f"expected the step, Gaussian count and photos of this fit, got {step}, {count} and {order}"
            )
        for name, value in tensors.items():
            value.copy_(state[name])
        self.model.count, self._order, self.generator = count, order.tolist(), generator
        return step

    def _tensors(self) -> dict[str, Tensor]:
        """Return everything that is learned, and the optimisers' moments."""
        parts: dict[str, Model | Learned] = {"model": self.model, "exposure": self.exposure, "moves": self.moves}
        return {f"{part}.{name}": value for part, learned in parts.items() for name, value in learned.state().items()}

    def level(self, done: float) -> tuple[Pictures, Tensor]:
        """Return the pictures to compare at a fraction of the whole work, and the known depths of their pixels."""
        return self.levels[[scale for begins, scale in self.settings.levels if begins <= done][-1]]

    def step(self, step: int, total: int) -> float:
        """Draw the next views and improve the Gaussians; return the mean loss."""
        settings, done = self.settings, step / total
        losses, chosen = self.compare(*self.level(done))
        self.update(step, done)
        if done > STEADY:
            self.learn_cameras(chosen, losses)
        begins, ends = settings.refine
        if begins <= done < ends and (step + 1) % settings.refine_every == 0:
            self.model.refine(self.generator)
        return float(losses[:, 0].mean())

    def compare(self, seen: Pictures, known: Tensor) -> tuple[Tensor, Tensor]:
        """Compare the next views with their photos; return losses and gradients [V, 16], and the views' indices [V]."""
        settings, model = self.settings, self.model
        if len(self._order) < self.views:
            self._order = self.trained[torch.randperm(len(self.trained), generator=self.generator)].tolist()
        chosen = torch.tensor(self._order[: self.views])
        del self._order[: self.views]
        losses = torch.empty(len(chosen), 16)
        self._core.compare(
            values=model.values,
            count=model.count,
            near=NEAR,
            camera_to_world=turned(seen.camera_to_world[chosen], self.moves.values[chosen]),
            K=seen.K.expand(len(chosen), 3, 3).contiguous(),
            pixels=seen.pixels,
            known=known,
            chosen=chosen,
            exposure=self.exposure.values,
            ssim_weight=settings.ssim_weight,
            depth_weight=settings.depth_weight,
            gradients=self._gradients,
            losses=losses,
            threads=self.threads,
        )
        return losses, chosen

    def update(self, step: int, done: float) -> None:
        """Take a step of Adam, with rates and betas scaled to the number of views (as gsplat scales them)."""
        settings, model = self.settings, self.model
        views = self.views
        rates = self.rates(done)
        self._core.update(
            values=model.values,
            gradients=self._gradients,
            first=model.first,
            second=model.second,
            rates=rates * math.sqrt(views),
            step=step + 1,
            beta1=max(0.0, 1.0 - views * (1.0 - BETAS[0])),
            beta2=1.0 - views * (1.0 - BETAS[1]),
            epsilon=EPSILON / math.sqrt(views),
            opacity_slope=settings.opacity_weight / model.count,
            scale_slope=settings.scale_weight / (3 * model.count),
            noise=settings.noise * float(rates[0]) * views,
            seed=(settings.seed << 40) + step * 0x9E3779B1,
            threads=self.threads,
        )

    def rates(self, done: float) -> Tensor:
        """Return the learning rate of each row of the parameters, once this fraction of the fit is done."""
        rates = torch.full((self.model.values.shape[0],), 2.5e-3 / 20)
        rates[MEAN] = 1.6e-4 * 0.01**done
        rates[LOG_SCALE] = 5e-3
        rates[QUAT] = 1e-3
        rates[LOGIT] = 5e-2
        rates[SH : SH + 3] = 2.5e-3
        return rates

    def learn_cameras(self, chosen: Tensor, losses: Tensor) -> None:
        """Improve exposures and poses of photos [V], by ``losses`` [V, 16]; means are kept, so that nothing drifts."""
        if self.settings.exposure:
            self.exposure.improve(chosen, losses[:, 4:10].view(-1, 3, 2))
            values = self.exposure.values
            values -= values[self.trained].mean(0) - torch.tensor([1.0, 0.0])
        if self.settings.poses > 0:
            steps = self.moves.improve(chosen, losses[:, 10:16])
            self.moves.values[self.trained] -= steps.sum(0) / len(self.trained)
