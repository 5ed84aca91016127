"""A walk that somebody with a phone takes through a place: past every free spot, looking everywhere on the way."""

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

Floats = NDArray[np.float64]

GRID = 0.1
"""Metres between the places that a walk may pass."""
ROOM = GRID / math.sqrt(2)
"""Metres that must be free around places beyond the body, so that the straight way between neighbours is free."""
FINE = 0.01
"""Metres between the points of a smoothed path."""
BEYOND = 2.0
"""Metres around what is solid in which distances are known; they are no larger beyond."""
SMOOTH = (0.2, 0.1, 0.05, 0.0)
"""Metres: widths of the smoothing; the first that leaves the path free is taken."""
GLANCE, SWERVE, AWAY = 0.5, math.radians(7.5), 24
"""Seconds between decisions where to look, by how much another decision differs, and how often one way."""
NEARNESS = 4.0
"""How much it counts that only near things are seen, against looking the other way than planned."""
STRIDES = 12
SLOWEST, FASTEST = 4.0, 0.4
"""Seconds: periods of the sway of a hand."""


@dataclass(frozen=True)
class Stroll:
    """How somebody walks and looks.

    Attributes:
        lower: corner [x, y] of the area to walk in, metres.
        upper: its other corner.
        height: of the camera, metres.
        rise: how far it is raised above that and lowered below it, metres.
        radius: metres to the sides that stay free at all these heights, but for the sway of the hand.
        speed: at most, metres per second.
        turn: seconds in which the view goes once around.
        far: metres; it looks rather at things that are no nearer.
        pitch_deg: how far the camera looks down on average, degrees; below 0 it looks up.
        nod_deg: how far it looks up and down from there, degrees.
        nod: seconds in which it does so once, and about half of what raising and lowering takes.
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
            if not 0.0 < getattr(self, name) < math.inf:
                raise ValueError(f"{name}: expected a finite number above 0, got {getattr(self, name)}")
        if not all(low < high for low, high in zip(self.lower, self.upper, strict=True)):
            raise ValueError(f"lower, upper: expected lower below upper, got {self.lower} and {self.upper}")


def phone_walk(occupancy: Occupancy, stroll: Stroll, frames: int, fps: float, seed: int = 0) -> Tensor:
    """Walk through the largest connected free part of an area, and come back to where the walk began.

    The way passes spots as close to each other as time and speed allow. Meanwhile the view goes around slowly, up and
    down, so everything is seen from several places, while moving ahead, sideways or back.

    Args:
        occupancy: what is solid.
        stroll: how somebody walks.
        frames: of the walk.
        fps: frames per second.
        seed: of the sway and of the first direction.

    Returns:
        [frames, 6] float64: x, y and z in metres, then yaw of the view about z, pitch downwards and roll about the
        view, radians. ``phone_video`` films it; the same arguments give the same bytes.

    Raises:
        ValueError: for less than two frames, or where nothing is free.
    """
    if frames < 2 or not fps > 0:
        raise ValueError(f"frames, fps: expected at least 2 frames and a speed above 0, got {frames} and {fps}")
    sides = Sides(occupancy, stroll.height - stroll.rise, stroll.height + stroll.rise)
    places = free_places(sides, stroll)
    if len(places) < 4:
        raise ValueError(
            f"lower, upper, height: expected room to walk {stroll.radius} m from everything, got {len(places)} free "
            f"places between {stroll.lower} and {stroll.upper} at {stroll.height} ± {stroll.rise} m"
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
    """The poses of the cameras of a walk: [N, 6] as ``phone_walk`` returns it -> camera_to_world [N, 4, 4]."""
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
    """How far to the sides the nearest solid thing is, for whatever reaches from one height to another.

    Args:
        occupancy: what is solid.
        low: metres.
        high: metres, not below ``low``.
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
        """Metres to the nearest solid thing in some directions, ``far`` at most: [N, 2], [N, M] -> [N, M]."""
        way = np.stack([np.cos(yaw), np.sin(yaw)], -1)
        gone = np.zeros(yaw.shape)
        for _ in range(STRIDES):  # as far as is free all around, again and again
            here = (places[:, None] + gone[..., None] * way).reshape(-1, 2)
            gone = np.minimum(gone + np.maximum(self.clearance(here), 0.0).reshape(yaw.shape), far)
        return gone

    def clearance(self, places: Floats) -> Floats:
        """Metres from places [N, 2] to the nearest solid voxel, at least; [N]."""
        cells = (places - self._corner) / self._edge - 0.5 + self._margin
        apart = ndimage.map_coordinates(self._apart, cells.T, order=1, mode="nearest")
        return np.asarray(apart - 0.5 * math.sqrt(2) * self._edge)


def free_places(sides: Sides, stroll: Stroll) -> Floats:
    """Places [F, 2] of a lattice, connected, around which the radius and ``ROOM`` more are free."""
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
    """A closed way without corners, free to ``radius`` metres, at points ``FINE`` apart: [P, 2] -> [Q, 2]."""
    reach = np.concatenate([[0.0], np.linalg.norm(np.diff(way, axis=0), axis=1).cumsum()])
    count = max(4, round(float(reach[-1]) / FINE))
    points = np.stack([np.interp(np.linspace(0, reach[-1], count), reach, way[:, axis]) for axis in (0, 1)], 1)
    for width in SMOOTH:
        path: Floats = ndimage.gaussian_filter1d(points, width / FINE, axis=0, mode="wrap") if width else points
        if (sides.clearance(path) >= radius).all():
            break
    return path


def views(sides: Sides, stroll: Stroll, places: Floats, seconds: Floats, first: float) -> Floats:
    """Where somebody looks along a way: around slowly, but rather at what is farther than ``stroll.far``.

    Nobody films a wall from so near that nothing else is in the picture, and nothing could be made of it. The shortest
    way through all deviations from an even turn (Viterbi) weighs the two.

    Args:
        sides: how far things are.
        stroll: how somebody looks.
        places: [N, 2] of the way.
        seconds: [N] when it is there.
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
