"""Simulated walk of a person with a phone through a place: past every free spot, looking around on the way."""

import math
from dataclasses import dataclass, field, replace

import numpy as np
import torch
from numpy.typing import NDArray
from scipy import ndimage
from torch import Tensor

from splatrl.collision.occupancy import Occupancy
from splatrl.evaluation.tours import round_trip
from splatrl.evaluation.walks import Hand, sway
from splatrl.values import require_number

Floats = NDArray[np.float64]

GRID = 0.1
"""Spacing of the lattice of places that a walk may pass, metres."""
ROOM = GRID / math.sqrt(2)
"""Clearance, beyond the body's radius, that keeps the straight line between diagonal neighbours free, metres."""
FINE = 0.01
"""Spacing of the points of a smoothed path, metres."""
BEYOND = 2.0
"""Margin around the occupancy grid in which distances are computed, metres; farther out they stop increasing."""
SMOOTH = (0.2, 0.1, 0.05, 0.0)
"""Standard deviations of the path smoothing, metres; the first that leaves the path free is used."""
GLANCE, SWERVE, AWAY = 0.5, math.radians(7.5), 24
"""Seconds between view decisions, radians between possible deviations, and number of deviations to each side."""
NEARNESS = 4.0
"""Weight of the cost of seeing only near things, relative to that of deviating from the planned direction."""
STRIDES = 12
SLOWEST, FASTEST = 4.0, 0.4
"""Longest and shortest period of the hand's sway, seconds."""


@dataclass(frozen=True)
class Stroll:
    """How a person walks and looks around.

    Attributes:
        lower: lower corner [x, y] of the area to walk in, metres.
        upper: upper corner [x, y], metres.
        height: mean height of the camera, world frame, metres.
        rise: how far the camera is raised above and lowered below that, metres.
        radius: horizontal clearance kept at all these heights, apart from the sway of the hand, metres.
        speed: maximum walking speed, metres per second.
        turn: seconds per full turn of the view.
        far: the view prefers directions in which nothing is nearer than this, metres.
        pitch_deg: mean downward pitch of the camera, degrees; negative looks up.
        nod_deg: amplitude of the pitch around that, degrees.
        nod: period of the pitch, seconds; about half the period of raising and lowering.
        hand: how the hand sways; its periods and frames are not used.
    """

    lower: tuple[float, float]
    upper: tuple[float, float]
    height: float
    rise: float = 0.1
    radius: float = 0.25
    speed: float = 0.45
    turn: float = 24.0
    far: float = 3.0
    pitch_deg: float = 0.0
    nod_deg: float = 18.0
    nod: float = 8.3
    hand: Hand = field(default_factory=lambda: Hand(0.01, 0.01, 0.8, 0.8, 0.8))

    def __post_init__(self) -> None:
        for name in ("radius", "speed", "turn", "nod"):
            require_number(name, getattr(self, name), above=0.0)
        if not all(low < high for low, high in zip(self.lower, self.upper, strict=True)):
            raise ValueError(f"lower, upper: expected lower below upper, got {self.lower} and {self.upper}")


def phone_walk(occupancy: Occupancy, stroll: Stroll, frames: int, fps: float, seed: int = 0) -> Tensor:
    """Walk through the largest connected free part of an area, and return to the start.

    The path passes spots that are as dense as time and speed allow. Meanwhile the view turns slowly and nods, so that
    everything is seen from several places while the camera moves forwards, sideways or backwards.

    Args:
        occupancy: what is solid.
        stroll: how the person walks.
        frames: number of frames of the walk.
        fps: frames per second.
        seed: seed of the sway and of the initial direction.

    Returns:
        [frames, 6] float64: x, y and z in metres, then yaw about z, downward pitch and roll about the line of sight,
        radians. ``phone_video`` films it; the same arguments give the same bytes.

    Raises:
        ValueError: for fewer than two frames, or an area with too little free space.
    """
    if frames < 2 or not fps > 0:
        raise ValueError(f"frames, fps: expected at least 2 frames and a positive frame rate, got {frames} and {fps}")
    sides = Sides(occupancy, stroll.height - stroll.rise, stroll.height + stroll.rise)
    places = free_places(sides, stroll)
    if len(places) < 4:
        raise ValueError(
            f"lower, upper, height: expected at least 4 places to walk, {stroll.radius} m from anything solid, got "
            f"{len(places)} between {stroll.lower} and {stroll.upper} at {stroll.height} ± {stroll.rise} m"
        )
    seconds = np.arange(frames) / fps
    path = smoothed(sides, stroll.radius, round_trip(places, GRID, stroll.speed * frames / fps))
    along = np.linspace(0.0, len(path) - 1.0, frames)
    x, y = (np.interp(along, np.arange(len(path)), path[:, axis]) for axis in (0, 1))
    generator = torch.Generator().manual_seed(seed)
    first = float(torch.rand((), generator=generator))
    yaw = views(sides, stroll, np.stack([x, y], 1), seconds, math.tau * first)
    nods = math.tau * seconds / stroll.nod
    z = stroll.height + stroll.rise * np.sin(0.47 * nods)
    pitch = np.radians(stroll.pitch_deg + stroll.nod_deg * np.sin(nods))
    hand = replace(stroll.hand, slowest=SLOWEST * fps, fastest=FASTEST * fps)
    swayed = sway(hand, frames, generator).double().numpy()
    still = np.stack([x, y, z, yaw, pitch, np.zeros(frames)], 1)
    return torch.from_numpy(still + swayed[:, [0, 1, 2, 5, 3, 4]])


def camera_poses(walk: Tensor) -> Tensor:
    """Convert a walk, [N, 6] as returned by ``phone_walk``, to camera poses: camera_to_world [N, 4, 4]."""
    yaw, pitch, roll = walk[:, 3:].unbind(1)
    flat, zero = pitch.cos(), torch.zeros_like(yaw)
    forward = torch.stack([yaw.cos() * flat, yaw.sin() * flat, -pitch.sin()], 1)
    right = torch.stack([yaw.sin(), -yaw.cos(), zero], 1)
    down = torch.linalg.cross(forward, right)
    turn, lean = roll.cos().unsqueeze(1), roll.sin().unsqueeze(1)
    poses = torch.eye(4, dtype=walk.dtype).repeat(len(walk), 1, 1)
    poses[:, :3, :3] = torch.stack([turn * right + lean * down, turn * down - lean * right, forward], 2)
    poses[:, :3, 3] = walk[:, :3]
    return poses


class Sides:
    """Horizontal distances to the nearest solid thing within a range of heights.

    Args:
        occupancy: what is solid.
        low: bottom of the range, world frame, metres.
        high: top of the range, metres; at least ``low``.
    """

    def __init__(self, occupancy: Occupancy, low: float, high: float) -> None:
        edge, origin = occupancy.resolution, occupancy.origin_key
        bottom, top = (max(0, math.floor(height / edge) - origin[2]) for height in (low, high))
        solid = occupancy.occupied[:, :, bottom : top + 1].any(2)
        self._margin = math.ceil(BEYOND / edge)
        padded = np.pad(solid, self._margin)
        self._apart: Floats = (
            ndimage.distance_transform_edt(~padded) * edge if solid.any() else np.full_like(padded, BEYOND, float)
        )
        self._edge, self._corner = edge, np.array(origin[:2]) * edge

    def reach(self, places: Floats, yaw: Floats, far: float) -> Floats:
        """Cast rays from places to the nearest solid thing, ``far`` metres at most: [N, 2], [N, M] yaw -> [N, M]."""
        way = np.stack([np.cos(yaw), np.sin(yaw)], -1)
        gone = np.zeros(yaw.shape)
        for _ in range(STRIDES):  # sphere tracing: advance by the clearance
            here = (places[:, None] + gone[..., None] * way).reshape(-1, 2)
            gone = np.minimum(gone + np.maximum(self.clearance(here), 0.0).reshape(yaw.shape), far)
        return gone

    def clearance(self, places: Floats) -> Floats:
        """Return a lower bound on the distance from places [N, 2] to the nearest solid voxel: [N] metres."""
        cells = (places - self._corner) / self._edge - 0.5 + self._margin
        apart = ndimage.map_coordinates(self._apart, cells.T, order=1, mode="nearest")
        return np.asarray(apart - 0.5 * math.sqrt(2) * self._edge)


def free_places(sides: Sides, stroll: Stroll) -> Floats:
    """Return the largest connected set of lattice places with a clearance of the radius and ``ROOM``: [F, 2]."""
    counts = [int((high - low) / GRID + 1e-6) + 1 for low, high in zip(stroll.lower, stroll.upper, strict=True)]
    axes = [low + GRID * np.arange(count) for low, count in zip(stroll.lower, counts, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), -1)
    room = sides.clearance(grid.reshape(-1, 2)).reshape(grid.shape[:2])
    labels, count = ndimage.label(room >= stroll.radius + ROOM)
    if count == 0:
        return np.zeros((0, 2))
    largest = 1 + int(np.bincount(labels.reshape(-1))[1:].argmax())
    free: Floats = grid[labels == largest]
    return free


def smoothed(sides: Sides, radius: float, way: Floats) -> Floats:
    """Smooth a closed path, keeping ``radius`` metres clear, and sample it ``FINE`` apart: [P, 2] -> [Q, 2]."""
    reach = np.concatenate([[0.0], np.linalg.norm(np.diff(way, axis=0), axis=1).cumsum()])
    count = max(4, round(float(reach[-1]) / FINE))
    points = np.stack([np.interp(np.linspace(0, reach[-1], count), reach, way[:, axis]) for axis in (0, 1)], 1)
    for width in SMOOTH:
        path: Floats = ndimage.gaussian_filter1d(points, width / FINE, axis=0, mode="wrap") if width else points
        if (sides.clearance(path) >= radius).all():
            break
    return path


def views(sides: Sides, stroll: Stroll, places: Floats, seconds: Floats, first: float) -> Floats:
    """Choose the view direction along a path: a slow, steady turn that avoids things nearer than ``stroll.far``.

    Nobody films a wall from so close that it fills the picture, and such images are of no use for reconstruction. The
    cheapest sequence of deviations from a steady turn (Viterbi) balances the two goals.

    Args:
        sides: horizontal distances to solid things.
        stroll: how the person looks around.
        places: [N, 2] positions along the path, metres.
        seconds: [N] times at these positions.
        first: yaw of the view at the start, radians.

    Returns:
        [N] yaw, radians.
    """
    times = np.linspace(seconds[0], seconds[-1], max(2, round((seconds[-1] - seconds[0]) / GLANCE) + 1))
    at = np.stack([np.interp(times, seconds, places[:, axis]) for axis in (0, 1)], 1)
    even = first + math.tau * times / stroll.turn
    off = np.arange(-AWAY, AWAY + 1) * SWERVE
    yaw = even[:, None] + off
    far = np.mean([sides.reach(at, yaw + side, stroll.far) for side in np.radians([-24, -12, 0, 12, 24])], 0)
    cost = NEARNESS * (1 - far / stroll.far) ** 2 + (off / math.pi) ** 2
    total, came = cost[0], []
    for row in cost[1:]:
        padded = np.pad(total, 1, constant_values=np.inf)
        ways = np.stack([padded[1:-1], padded[:-2], padded[2:]])
        came.append(ways.argmin(0))
        total = row + ways.min(0)
    chosen = [int(total.argmin())]
    for step in reversed(came):
        chosen.append(chosen[-1] + (0, -1, 1)[step[chosen[-1]]])
    looked = even + ndimage.gaussian_filter1d(off[chosen[::-1]], 1.0, mode="nearest")
    return np.asarray(np.interp(seconds, times, looked))
