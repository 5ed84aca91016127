"""Where the balls and marks of the push task can be on a terrain, and where robots can go between them."""

from dataclasses import dataclass

import numpy as np
import torch
from scipy import ndimage
from torch import Tensor, nn

from splatrl.geometry import azimuths, wrapped
from splatrl.motions.size import require_few, values_within
from splatrl.physics import Terrain

CELL = 0.05
"""Spacing of the grid of possible places for a ball or a mark, metres."""
TRIES = 128
"""Candidate places drawn for each ball and mark; the first that fits is used."""
ROBOTS = 1024
"""Most robots for which candidate balls are tested at once; bounds memory."""
BALLS = 8192
"""Candidate balls tested at once, of all these robots: for most robots, one of the first few fits."""
FAR = 9.0
"""Upper limit of the clearance map, metres; larger clearances need not be distinguished."""
WIDTH = 0.25
"""Minimum distance from obstacles at which robots can pass, metres."""
SIGHT = 12
"""Number of sample points on a line when testing whether it is clear of obstacles."""


@dataclass(frozen=True)
class Ranges:
    """Where ball and mark may be when an episode begins.

    Attributes:
        nearest: minimum distance between ball and mark, metres.
        farthest: maximum distance between ball and mark, metres.
        apart: minimum distance between robot and ball, metres.
        ahead: maximum angle between the robot's heading and the ball, in either direction, radians.
        turn: minimum cosine of the angle at the ball between straight on from the robot and the mark.
    """

    nearest: float
    farthest: float
    apart: float
    ahead: float
    turn: float


class PushPlaces(nn.Module):
    """Maps of a terrain, on a grid with ``CELL`` between its places; empty until ``find`` is called.

    Args:
        lower: [2] smallest x and y of robots, metres.
        upper: [2] largest x and y, metres.
        ranges: where ball and mark may be when an episode begins.
        clearance: minimum distance between a ball or mark and obstacles, metres.
        leeway: distance beyond the bounds at which robot or ball count as lost, metres.
    """

    lower: Tensor  # [2] float64
    upper: Tensor  # [2] float64
    possible: Tensor  # [P, 2] float64, possible places of a ball or mark
    way: Tensor  # [X, Y] bool, cells that robots can occupy
    clear: Tensor  # [X', Y'] float64, metres to obstacles or to where a robot is lost, over bounds and leeway

    def __init__(self, lower: Tensor, upper: Tensor, ranges: Ranges, clearance: float, leeway: float):
        super().__init__()
        self.ranges, self.clearance, self.leeway = ranges, clearance, leeway
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
        if not spread >= self.ranges.nearest:
            raise ValueError(
                f"places for ball and mark: expected two at least {self.ranges.nearest:g} m apart and "
                f"{self.clearance:g} m from obstacles, found none among {len(possible)}; widen task.motion.lower and "
                "task.motion.upper"
            )
        self.possible = possible.to(self.possible.device)
        lower, upper = lower - self.leeway, upper + self.leeway
        grid = _grid(lower, upper, CELL)
        inside = torch.minimum(grid - lower, upper - grid).amin(-1)
        clear = torch.minimum(_away(terrain, grid.reshape(-1, 2)).reshape(inside.shape), inside).clamp_max(FAR)
        self.clear = clear.to(self.possible.device)

    def suit(self, planar: Tensor) -> Tensor:
        """Return whether robots are on free ground, with places in range for ball and mark: [N, 3] -> [N] bool."""
        found = self.free(planar[:, :2])
        found[found.clone()] = self._first(planar[found], self._some()) >= 0
        return found

    def balls(self, planar: Tensor, generator: torch.Generator) -> Tensor:
        """Draw the place of the ball for each robot: [B, 3] -> [B, 2].

        Where ``suit`` holds, the ball is in range, and so is a mark for it. Elsewhere, the ball is ahead if it can be.
        """
        drawn, some = self._drawn(len(planar), generator), self._some()
        chosen = self._first(planar, drawn)
        place = _select(drawn, chosen)
        rest = (chosen < 0).nonzero().squeeze(1)
        fixed = self._first(planar[rest], some)
        place[rest] = some[fixed]
        rest = rest[fixed < 0]
        robot = planar[rest, None, :2]
        apart = (drawn[rest] - robot).norm(dim=2) >= self.ranges.apart
        clear = self._open(robot, drawn[rest], apart)
        worth = apart + 2.0 * clear + 4.0 * (clear & self._ahead(planar[rest], drawn[rest]))
        place[rest] = _select(drawn[rest], worth.argmax(1))
        return place

    def marks(self, planar: Tensor, ball: Tensor, generator: torch.Generator) -> Tensor:
        """Draw the place of the mark for each robot and ball, in range if it can be: [B, 3], [B, 2] -> [B, 2]."""
        some = self._some().expand(len(planar), -1, -1)
        places, ball = torch.cat([self._drawn(len(planar), generator), some], 1), ball.unsqueeze(1)
        near, cosine = self._onward(planar[:, None, :2], ball, places)
        fits = self._open(ball, places, near & (cosine >= self.ranges.turn))
        none = ~fits.any(1, keepdim=True)
        worth = self._open(ball, places, near & none) * (2.0 + cosine)
        return _select(places, torch.where(none, worth, fits).argmax(1))

    def _some(self) -> Tensor:
        """Return about ``TRIES`` of the possible places, spread evenly: [K, 2] float64."""
        return self.possible[:: 1 + len(self.possible) // TRIES]

    def _drawn(self, count: int, generator: torch.Generator) -> Tensor:
        """Draw candidate places for each robot: [B, TRIES, 2] float64."""
        rows = torch.randint(len(self.possible), (count, TRIES), generator=generator, device=self.possible.device)
        return self.possible[rows]

    def _first(self, planar: Tensor, balls: Tensor) -> Tensor:
        """Return each robot's first candidate ball that fits, with one of ``_some`` as its mark.

        Args:
            planar: [N, 3] float64, robots.
            balls: candidates for each robot, [N, K, 2] float64, or for all, [K, 2].

        Returns:
            [N] int64, numbers of candidates; -1 where none fits.
        """
        balls = balls.expand(len(planar), -1, -1)
        found = torch.full_like(planar[:, 0], -1, dtype=torch.int64)
        for rows in torch.arange(len(planar), device=planar.device).split(ROBOTS):
            left, begin = rows, 0
            while begin < balls.shape[1] and len(left):
                end = begin + BALLS // len(left)
                fits = self._fits(planar[left], balls[left, begin:end])
                found[left] = torch.where(fits.any(1), begin + fits.int().argmax(1), -1)
                left, begin = left[~fits.any(1)], end
        return found

    def _fits(self, planar: Tensor, balls: Tensor) -> Tensor:
        """Return whether balls are ahead and one of ``_some`` fits as the mark: [N, 3], [N, K, 2] -> [N, K] bool."""
        fits = self._open(planar[:, None, :2], balls, self._ahead(planar, balls))
        robot, marks = planar[fits.nonzero()[:, 0], None, :2], self._some().unsqueeze(0)
        ball = balls[fits].unsqueeze(1)
        near, cosine = self._onward(robot, ball, marks)
        fits[fits.clone()] = self._open(ball, marks, near & (cosine >= self.ranges.turn)).any(1)
        return fits

    def _ahead(self, planar: Tensor, balls: Tensor) -> Tensor:
        """Return whether balls are far enough and ahead of robots: [N, 3], [N, K, 2] -> [N, K] bool."""
        away = balls - planar[:, None, :2]
        off = wrapped(azimuths(away) - planar[:, 2:]).abs()
        return (away.norm(dim=2) >= self.ranges.apart) & (off <= self.ranges.ahead)

    def _onward(self, robot: Tensor, ball: Tensor, mark: Tensor) -> tuple[Tensor, Tensor]:
        """Return whether a mark is in range of a ball, and the cosine of the turn at the ball: [N, K, 2], broadcast."""
        way, came = mark - ball, ball - robot
        far = way.norm(dim=2)
        cosine = (way * came).sum(2) / (far * came.norm(dim=2)).clamp_min(1e-9)
        return (far >= self.ranges.nearest) & (far <= self.ranges.farthest), cosine

    def free(self, places: Tensor) -> Tensor:
        """Return whether robots can be at places: [..., 2] float64 -> [...] bool."""
        last = torch.tensor(self.way.shape, device=places.device) - 1
        cell = ((places - self.lower) / CELL).round().long().clamp_min(0).minimum(last)
        return self.way[cell[..., 0], cell[..., 1]]

    def _open(self, start: Tensor, end: Tensor, among: Tensor) -> Tensor:
        """Return where lines between places are clear, among those of interest.

        Maps [N, K, 2] and [N, K, 2], broadcast, and [N, K] bool to [N, K] bool.
        """
        shape, found = (*among.shape, 2), among.clone()
        start, end = start.expand(shape)[among], end.expand(shape)[among]
        share = torch.linspace(0.0, 1.0, SIGHT, dtype=torch.float64, device=end.device)[:, None]
        found[among] = self.free(start.unsqueeze(1) + share * (end - start).unsqueeze(1)).all(1)
        return found

    def room(self, places: Tensor) -> Tensor:
        """Interpolate the distance from places to obstacles and to where a robot is lost: [N, 2] -> [N] metres."""
        last = torch.tensor(self.clear.shape, device=places.device) - 1
        at = (places - (self.lower - self.leeway)) / CELL
        at = at.clamp_min(0.0).minimum(last.to(at) - 1e-6)
        low, share = at.long(), at - at.floor()
        x, y = low.unbind(-1)
        rows = [(1.0 - share[..., 1]) * self.clear[i, y] + share[..., 1] * self.clear[i, y + 1] for i in (x, x + 1)]
        return (1.0 - share[..., 0]) * rows[0] + share[..., 0] * rows[1]


def _select(places: Tensor, chosen: Tensor) -> Tensor:
    """Return one of each row's places: [B, K, 2], [B] -> [B, 2]."""
    return places[torch.arange(len(places), device=places.device), chosen]


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
