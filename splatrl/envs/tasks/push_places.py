"""Where the balls and marks of the push task can be on a terrain, and where robots can go between them."""

import numpy as np
import torch
from scipy import ndimage
from torch import Tensor, nn

from splatrl.motions.size import require_few, values_within
from splatrl.physics import Terrain

CELL = 0.05
"""Spacing of the grid of possible places for a ball or a mark, metres."""
TRIES = 128
"""Candidate places drawn for each ball and mark; the first that fits is used."""
FAR = 9.0
"""Upper limit of the clearance map, metres; larger clearances need not be distinguished."""
WIDTH = 0.25
"""Minimum distance from obstacles at which robots can pass, metres."""
SIGHT = 12
"""Number of sample points on a line when testing whether it is clear of obstacles."""


class PushPlaces(nn.Module):
    """Maps of a terrain, on a grid with ``CELL`` between its places; empty until ``find`` is called.

    Args:
        lower: [2] smallest x and y of robots, metres.
        upper: [2] largest x and y, metres.
        nearest: distance between two places that there must be, metres.
        clearance: minimum distance between a ball or mark and obstacles, metres.
        leeway: distance beyond the bounds at which robot or ball count as lost, metres.
    """

    lower: Tensor  # [2] float64
    upper: Tensor  # [2] float64
    possible: Tensor  # [P, 2] float64, possible places of a ball or mark
    way: Tensor  # [X, Y] bool, cells that robots can occupy
    clear: Tensor  # [X', Y'] float64, metres to obstacles or to where a robot is lost, over bounds and leeway

    def __init__(self, lower: Tensor, upper: Tensor, nearest: float, clearance: float, leeway: float):
        super().__init__()
        self.nearest, self.clearance, self.leeway = nearest, clearance, leeway
        self.register_buffer("lower", lower.double(), persistent=False)
        self.register_buffer("upper", upper.double(), persistent=False)
        self.register_buffer("possible", torch.zeros(0, 2, dtype=torch.float64), persistent=False)
        self.register_buffer("way", torch.zeros(0, 0, dtype=torch.bool), persistent=False)
        self.register_buffer("clear", torch.zeros(0, 0, dtype=torch.float64), persistent=False)

    def find(self, terrain: Terrain) -> None:
        """Find the possible places on a terrain.

        Raises:
            ValueError: if the places extend over less than ``nearest``, or for a grid of more than ``MOST_STATES``.
        """
        lower, upper = self.lower, self.upper
        grid = _grid(lower, upper, 1e-9)
        away = _away(terrain, grid.reshape(-1, 2)).reshape(grid.shape[:2])
        ways, _ = ndimage.label((away >= WIDTH).numpy())
        sizes = np.bincount(ways.ravel())[1:]
        way = ways == 1 + sizes.argmax() if len(sizes) else np.zeros(away.shape, bool)
        self.way = torch.from_numpy(way).to(self.possible.device)
        inner = (grid >= lower + self.clearance).all(-1) & (grid <= upper - self.clearance).all(-1)
        possible = grid[torch.from_numpy(way) & inner & (away >= self.clearance)]
        spread = (possible.amax(0) - possible.amin(0)).norm() if len(possible) else 0.0
        if not spread >= self.nearest:
            raise ValueError(
                f"places for ball and mark: expected two at least {self.nearest:g} m apart and {self.clearance:g} m "
                f"from obstacles, found none among {len(possible)}; widen task.motion.lower and task.motion.upper"
            )
        self.possible = possible.to(self.possible.device)
        lower, upper = lower - self.leeway, upper + self.leeway
        grid = _grid(lower, upper, CELL)
        inside = torch.minimum(grid - lower, upper - grid).amin(-1)
        clear = torch.minimum(_away(terrain, grid.reshape(-1, 2)).reshape(inside.shape), inside).clamp_max(FAR)
        self.clear = clear.to(self.possible.device)

    def some(self) -> Tensor:
        """Return about ``TRIES`` of the possible places, spread evenly: [K, 2] float64."""
        return self.possible[:: 1 + len(self.possible) // TRIES]

    def drawn(self, count: int, generator: torch.Generator) -> Tensor:
        """Draw candidate places for each robot: [B, TRIES, 2] float64."""
        rows = torch.randint(len(self.possible), (count, TRIES), generator=generator, device=self.possible.device)
        return self.possible[rows]

    def free(self, places: Tensor) -> Tensor:
        """Return whether robots can be at places: [..., 2] float64 -> [...] bool."""
        last = torch.tensor(self.way.shape, device=places.device) - 1
        cell = ((places - self.lower) / CELL).round().long().clamp_min(0).minimum(last)
        return self.way[cell[..., 0], cell[..., 1]]

    def open(self, start: Tensor, end: Tensor) -> Tensor:
        """Return whether the line between places is clear: [B, K, 2], [B, K, 2], broadcast -> [B, K] bool."""
        share = torch.linspace(0.0, 1.0, SIGHT, dtype=torch.float64, device=end.device)[:, None]
        return self.free(start.unsqueeze(2) + share * (end - start).unsqueeze(2)).all(2)

    def room(self, places: Tensor) -> Tensor:
        """Interpolate the distance from places to obstacles and to where a robot is lost: [N, 2] -> [N] metres."""
        last = torch.tensor(self.clear.shape, device=places.device) - 1
        at = (places - (self.lower - self.leeway)) / CELL
        at = at.clamp_min(0.0).minimum(last.to(at) - 1e-6)
        low, share = at.long(), at - at.floor()
        x, y = low.unbind(-1)
        rows = [(1.0 - share[..., 1]) * self.clear[i, y] + share[..., 1] * self.clear[i, y + 1] for i in (x, x + 1)]
        return (1.0 - share[..., 0]) * rows[0] + share[..., 0] * rows[1]


def first_of(drawn: Tensor, fits: Tensor, worth: Tensor) -> Tensor:
    """Select each row's first place that fits, or the one of highest worth if none does.

    Maps [B, K, 2] places, [B, K] bool and [B, K] worths to [B, 2].
    """
    order = torch.arange(fits.shape[1], 0, -1, device=fits.device)
    best = torch.where(fits, 1e6 + order, worth).argmax(1)
    return drawn[torch.arange(len(drawn), device=drawn.device), best]


def _away(terrain: Terrain, places: Tensor) -> Tensor:
    """Return the distance from places on the ground to the nearest of the terrain's boxes: [N, 2] -> [N] metres."""
    nearest = torch.full_like(places[:, 0], torch.inf)
    for row in terrain.boxes.to(places):
        outside = ((places - row[:2]).abs() - row[3:5]).clamp_min(0.0)
        torch.minimum(nearest, outside.norm(dim=1), out=nearest)
    return nearest


def _grid(lower: Tensor, upper: Tensor, beyond: float) -> Tensor:
    """Return a grid of places ``CELL`` apart, ending less than ``beyond`` metres past the upper bounds.

    Maps [2] and [2] to [X, Y, 2] float64.
    """
    corners = list(zip(lower.tolist(), upper.tolist(), strict=True))
    counts = [values_within(low, high, CELL) for low, high in corners]
    require_few(counts, f" in steps of {CELL} m", "places for ball and mark", "choose a smaller area")
    axes = [torch.arange(low, high + beyond, CELL, dtype=torch.float64) for low, high in corners]
    return torch.stack(torch.meshgrid(*axes, indexing="ij"), -1)
