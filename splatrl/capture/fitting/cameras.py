"""Camera parameters that a fit learns: the exposure of each photo, and small corrections of the poses."""

import torch
from torch import Tensor

BETAS = (0.9, 0.99)


class Learned:
    """One value per photo, updated by Adam only in steps that draw that photo.

    Args:
        start: [N, ...] float32, initial values.
        rate: learning rate.
    """

    def __init__(self, start: Tensor, rate: float) -> None:
        self.values = start.clone()
        self.rate = rate
        self._first, self._second = torch.zeros_like(start), torch.zeros_like(start)
        self._steps = torch.zeros(len(start), dtype=torch.int64)

    def state(self) -> dict[str, Tensor]:
        """Return everything that the next steps depend on."""
        return {"values": self.values, "first": self._first, "second": self._second, "steps": self._steps}

    def improve(self, rows: Tensor, slopes: Tensor) -> Tensor:
        """Take a step for some photos.

        Args:
            rows: [V] int64, the photos, each listed once.
            slopes: [V, ...] gradients of their values.

        Returns:
            [V, ...], the changes of their values.
        """
        self._steps[rows] += 1
        self._first[rows] = torch.lerp(slopes, self._first[rows], BETAS[0])
        self._second[rows] = torch.lerp(slopes**2, self._second[rows], BETAS[1])
        counts = self._steps[rows].view(-1, *[1] * (slopes.ndim - 1))
        first = self._first[rows] / (1 - BETAS[0] ** counts)
        second = self._second[rows] / (1 - BETAS[1] ** counts)
        steps = -self.rate * first / (second.sqrt() + 1e-12)
        self.values[rows] += steps
        return steps


def turned(camera_to_world: Tensor, moves: Tensor) -> Tensor:
    """Rotate cameras in place about the world's axes, then shift them.

    Args:
        camera_to_world: [V, 4, 4].
        moves: [V, 6], small: a rotation vector in radians, and a shift.
    """
    zero = torch.zeros(len(moves), dtype=torch.float64)
    x, y, z = moves[:, :3].double().unbind(1)
    turns = torch.linalg.matrix_exp(torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], 1).view(-1, 3, 3))
    out = camera_to_world.double().clone()
    out[:, :3, :3] = turns @ out[:, :3, :3]
    out[:, :3, 3] += moves[:, 3:]
    return out.to(camera_to_world)
