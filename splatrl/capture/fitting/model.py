"""The Gaussians of a fit: their parameters in memory, and how they are added and relocated."""

import math

import torch
from torch import Tensor

from splatrl.capture.fitting.pictures import Frame
from splatrl.scenes.gaussians import Gaussians

MEAN, LOG_SCALE, QUAT, LOGIT, SH = slice(0, 3), slice(3, 6), slice(6, 10), 10, 11
"""Rows of the parameters."""
LANES = 16
DEAD = 0.005
"""Opacity at and below which a Gaussian is dead and gets relocated."""
GROWTH = 1.05
MOST_COPIES = 51


class Model:
    """Parameters of up to ``cap`` Gaussians on a device, each row contiguous, as the native fit reads them.

    Attributes:
        values: [11 + 3 (degree + 1)², C] float32: means, log-scales, quaternions, opacity logits, harmonics by
            coefficient and colour.
        first: Adam's first moments, of the same shape.
        second: Adam's second moments, of the same shape.
        count: number of Gaussians present.
        cap: maximum number of Gaussians.
    """

    def __init__(self, cap: int, degree: int, device: torch.device | None = None) -> None:
        stride = -(-cap // LANES) * LANES
        rows = SH + 3 * (degree + 1) ** 2
        self.values, self.first, self.second = (torch.zeros(rows, stride, device=device) for _ in range(3))
        self.values[QUAT.start] = 1.0  # unused columns hold valid quaternions, too
        self.count = 0
        self.cap = cap
        self.degree = degree

    def state(self) -> dict[str, Tensor]:
        """Return everything that the next steps depend on, except ``count``."""
        return {"values": self.values, "first": self.first, "second": self.second}

    def add(self, columns: Tensor) -> None:
        """Add Gaussians, given as columns: [rows, n]."""
        end = self.count + columns.shape[1]
        assert end <= self.cap, (end, self.cap)
        self.values[:, self.count : end] = columns
        self.first[:, self.count : end] = 0.0
        self.second[:, self.count : end] = 0.0
        self.count = end

    def gaussians(self, frame: Frame) -> Gaussians:
        """Return the Gaussians that are not dead, on the CPU, in the frame of the reconstruction."""
        values = self.values[:, : self.count].cpu()
        values = values[:, values[LOGIT].sigmoid() > DEAD].clone()
        return Gaussians(
            means=(values[MEAN].T.double() * frame.extent + frame.middle).float(),
            quats=torch.nn.functional.normalize(values[QUAT].T, dim=1),
            scales=(values[LOG_SCALE].T + math.log(frame.extent)).exp(),
            opacities=values[LOGIT].sigmoid(),
            sh=values[SH:].T.reshape(values.shape[1], -1, 3).contiguous(),
            batch_size=[values.shape[1]],
        )

    def refine(self, generator: torch.Generator) -> None:
        """Relocate dead Gaussians to live ones, and grow towards the cap (Kheradmand et al. 2024, MCMC).

        The generator must be on the CPU, whatever the device.
        """
        opacities = self.values[LOGIT, : self.count].sigmoid()
        dead = (opacities <= DEAD).nonzero().squeeze(1)
        if 0 < len(dead) < self.count:
            parents = self._parents(torch.where(opacities <= DEAD, 0.0, opacities), len(dead), generator)
            self.values[:, dead] = self.values[:, parents]
            self.first[:, dead] = 0.0
            self.second[:, dead] = 0.0
        born = min(self.cap, int(self.count * GROWTH)) - self.count
        if born > 0:
            opacities = self.values[LOGIT, : self.count].sigmoid()
            self.add(self.values[:, self._parents(opacities, born, generator)])

    def _parents(self, chances: Tensor, children: int, generator: torch.Generator) -> Tensor:
        """Choose parents by opacity, and divide each parent's opacity and size among itself and its children."""
        drawn = torch.multinomial(chances.cpu(), children, replacement=True, generator=generator)
        parents = drawn.to(chances.device)
        copies = torch.bincount(parents, minlength=self.count) + 1
        shared = (copies > 1).nonzero().squeeze(1)
        opacities, factors = share(self.values[LOGIT, shared].double().sigmoid(), copies[shared].clamp_max(MOST_COPIES))
        self.values[LOGIT, shared] = torch.logit(opacities.clamp(DEAD, 1 - 1e-6)).float()
        self.values[LOG_SCALE, shared] += factors.log().float()
        self.first[:, shared] = 0.0
        self.second[:, shared] = 0.0
        return parents


def share(opacities: Tensor, copies: Tensor) -> tuple[Tensor, Tensor]:
    """Return opacities and scale factors for coincident copies that look like the original (eq. 9 of the MCMC paper).

    Args:
        opacities: [n] float64, opacities of the originals.
        copies: [n] int64, number of copies of each, from 1 to ``MOST_COPIES``.
    """
    each = 1.0 - (1.0 - opacities) ** (1.0 / copies)
    total = torch.zeros_like(each)
    term = torch.ones_like(each)  # the binomial coefficient times the power
    for k in range(int(copies.max()) if len(copies) else 0):
        term = term * each * ((copies - k).clamp_min(0) / (k + 1))
        total += (-1) ** k / math.sqrt(k + 1) * term
    return each, opacities / total
