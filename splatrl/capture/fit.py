"""Gaussians from photos with known poses, on a CPU or a GPU.

Every step draws a few views with ``splatrl.native``, on a CPU one thread each, compares them with their photos by L1
and structural similarity, pulls the slopes back to all parameters and takes a step of Adam. Gaussians that became
transparent are moved to where opaque ones are (MCMC, Kheradmand et al. 2024). Results do not depend on the number of
threads.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from splatrl.capture.base import CaptureError, Reconstruction
from splatrl.capture.fit_cameras import Learned, turned
from splatrl.capture.fit_checkpoint import Checkpoint
from splatrl.capture.fit_cuda import CudaFitter
from splatrl.capture.fit_model import Model
from splatrl.capture.fit_pictures import Frame, Pictures, frame_of, pictures
from splatrl.capture.fit_start import start
from splatrl.capture.stereo import Depths, find_depths
from splatrl.native import _core
from splatrl.native.threads import usable_cores
from splatrl.scenes.gaussians import Gaussians

HELD_OUT = 8
"""Every how many views one is never trained on."""
NEAR = 0.02
"""Nearer than this no Gaussian is drawn; in the extent of the cameras."""
BETAS = (0.9, 0.999)
EPSILON = 1e-15
STEADY = 0.1
"""Share of the views after which exposures and poses are learned."""
EXPOSURE_RATE = 2e-3

Told = Callable[[int, int, float], None]
"""Is told how many views were drawn, of how many, and the loss of the last."""


@dataclass(frozen=True)
class FitSettings:
    """How Gaussians are fitted.

    Attributes:
        width: of the images that are compared, pixels; at most that of the photos.
        cap: the most Gaussians.
        views: how many are drawn in all; the time that a fit takes is proportional to it.
        views_a_step: drawn between two steps of the optimiser, each by a thread of its own.
        sh_degree: of the harmonics, 0 to 3.
        levels: at which share of the views the images change to which share of the width.
        start_share: share of the cap that is there from the start.
        refine: the shares of the views at which Gaussians begin and cease to be moved and added.
        refine_every: steps between that.
        ssim_weight: of the structural similarity in the loss, against L1.
        depth_weight: of what does not lie where photos are known to be: before it, behind it, or see-through.
        opacity_weight: of the regulariser of the opacities.
        scale_weight: of the regulariser of the sizes.
        noise: of MCMC.
        exposure: whether each photo has a brightness and a tint of its own.
        poses: learning rate of the poses, in radians and the extent of the cameras; 0 takes them as they are.
        seed: of everything that is random.
        threads: None takes all cores that this process may use.
        device: where the Gaussians are while they are fitted: a CPU, or a GPU whose kernels the extra ``cuda`` brings.
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
            if getattr(self, name) < 1:
                raise ValueError(f"{name}: expected at least 1, got {getattr(self, name)}")
        if self.sh_degree not in range(4):
            raise ValueError(f"sh_degree: expected 0 to 3, got {self.sh_degree}")
        if self.threads is not None and self.threads < 1:
            raise ValueError(f"threads: expected at least 1, or None for all cores, got {self.threads}")


def held_out(count: int) -> Tensor:
    """Which of so many views are never trained on: [n] int64."""
    return torch.arange(0, count, HELD_OUT)


def trained(count: int) -> Tensor:
    """The other ones: [n] int64."""
    every = torch.arange(count)
    return every[~torch.isin(every, held_out(count))]


def fit(
    reconstruction: Reconstruction,
    settings: FitSettings,
    progress: Told | None = None,
    depths: Depths | None = None,
    checkpoint: Checkpoint | None = None,
) -> Gaussians:
    """Fit Gaussians to the photos of a reconstruction, all but those that ``held_out`` names.

    Args:
        reconstruction: the photos, in order, with their poses.
        settings: how.
        progress: is told after every step.
        depths: what ``find_depths`` found in ``frame_of`` the cameras; None finds them.
        checkpoint: where the state is kept now and then; a fit that was killed goes on from there, with the bytes that
            it would have had. None keeps nothing.

    Returns:
        Gaussians on the CPU, in the frame and unit of the reconstruction, to be drawn antialiased on black.

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
        frame: in which they are.
        trained: [n] int64, the views that are trained on.
        views: how many a step draws.
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
        """All that the steps from ``step`` on depend on, on the CPU, beside photos and settings."""
        values = {name: value.cpu() for name, value in self._tensors().items()}
        scalars = {"step": torch.tensor(step), "count": torch.tensor(self.model.count)}
        order = torch.tensor(self._order, dtype=torch.int64)
        return {**values, **scalars, "order": order, "generator": self.generator.get_state()}

    def restore(self, state: dict[str, Tensor]) -> int:
        """Go on from a state of the same fit; returns the step that comes next.

        Raises:
            ValueError: for a state of another fit; this one is then as it was.
        """
        tensors, generator = self._tensors(), torch.Generator()
        step, count, order = int(state["step"]), int(state["count"]), state["order"]
        generator.set_state(state["generator"])
        for name, value in tensors.items():
            if (state[name].shape, state[name].dtype) != (value.shape, value.dtype):
                raise ValueError(f"{name}: expected {value.dtype} {list(value.shape)}, got {list(state[name].shape)}")
        if step < 1 or not 1 <= count <= self.model.cap or not torch.isin(order, self.trained).all():
            raise ValueError(f"expected a step, Gaussians and photos of this fit, got {step}, {count} and {order}")
        for name, value in tensors.items():
            value.copy_(state[name])
        self.model.count, self._order, self.generator = count, order.tolist(), generator
        return step

    def _tensors(self) -> dict[str, Tensor]:
        """What is learned, and the memory of the optimisers."""
        parts: dict[str, Model | Learned] = {"model": self.model, "exposure": self.exposure, "moves": self.moves}
        return {f"{part}.{name}": value for part, learned in parts.items() for name, value in learned.state().items()}

    def level(self, done: float) -> tuple[Pictures, Tensor]:
        """The pictures at a share of the whole work, and what is known of their depth."""
        return self.levels[[scale for begins, scale in self.settings.levels if begins <= done][-1]]

    def step(self, step: int, total: int) -> float:
        """Draw the next views and improve the Gaussians; returns the mean loss."""
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
        """Compare the next views with their photos: the losses and slopes [V, 16], and which views they were [V]."""
        settings, model = self.settings, self.model
        if len(self._order) < self.views:
            self._order = self.trained[torch.randperm(len(self.trained), generator=self.generator)].tolist()
        chosen = torch.tensor(self._order[: self.views])
        del self._order[: self.views]
        losses = torch.empty(len(chosen), 16)
        self._core.compare(
            model.values,
            model.count,
            NEAR,
            turned(seen.camera_to_world[chosen], self.moves.values[chosen]),
            seen.K.expand(len(chosen), 3, 3).contiguous(),
            seen.pixels,
            known,
            chosen,
            self.exposure.values,
            settings.ssim_weight,
            settings.depth_weight,
            self._gradients,
            losses,
            self.threads,
        )
        return losses, chosen

    def update(self, step: int, done: float) -> None:
        """One step of Adam, whose rates and memory are scaled to the number of views (as gsplat scales them)."""
        settings, model = self.settings, self.model
        views = self.views
        rates = self.rates(done)
        self._core.update(
            model.values,
            self._gradients,
            model.first,
            model.second,
            rates * math.sqrt(views),
            step + 1,
            max(0.0, 1.0 - views * (1.0 - BETAS[0])),
            1.0 - views * (1.0 - BETAS[1]),
            EPSILON / math.sqrt(views),
            settings.opacity_weight / model.count,
            settings.scale_weight / (3 * model.count),
            settings.noise * float(rates[0]) * views,
            (settings.seed << 40) + step * 0x9E3779B1,
            self.threads,
        )

    def rates(self, done: float) -> Tensor:
        """The learning rate of each row of the parameters."""
        rates = torch.full((self.model.values.shape[0],), 2.5e-3 / 20)
        rates[0:3] = 1.6e-4 * 0.01**done
        rates[3:6] = 5e-3
        rates[6:10] = 1e-3
        rates[10] = 5e-2
        rates[11:14] = 2.5e-3
        return rates

    def learn_cameras(self, chosen: Tensor, losses: Tensor) -> None:
        """Improve exposures and poses; on average over the photos, nothing becomes brighter and nothing moves."""
        if self.settings.exposure:
            self.exposure.improve(chosen, losses[:, 4:10].view(-1, 3, 2))
            values = self.exposure.values
            values -= values[self.trained].mean(0) - torch.tensor([1.0, 0.0])
        if self.settings.poses > 0:
            steps = self.moves.improve(chosen, losses[:, 10:16])
            self.moves.values[self.trained] -= steps.sum(0) / len(self.trained)
