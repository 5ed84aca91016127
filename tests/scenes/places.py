"""Generated places that stand in for unseen captures: courtyards, rooms and things, laid out from a seed."""

import math

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from splatrl.geometry import rotations_to_quats
from splatrl.scenes.frame import similarity
from splatrl.scenes.gaussians import Gaussians
from splatrl.scenes.placement import STANDING
from splatrl.spherical_harmonics import C0

Floats = NDArray[np.float64]
LAYOUTS = {
    "courtyard": ((40.0, 30.0, 9.0), 1.0, 1.0, 3, 4),
    "street": ((50.0, 12.0, 10.0), 1.0, 1.0, 2, 2),
    "room": ((5.0, 4.0, 2.5), 0.25, 0.4, 3, 4),
    "garden": ((9.0, 7.0, 1.8), 0.25, 0.5, 1, 4),
    "thing": ((1.6, 1.2, 0.5), 0.05, 0.12, 0, 0),
}
"""Per kind: length, width and height in metres, factor of the spacing, size of things in metres, fewest and most
walls."""
KINDS = tuple(LAYOUTS)


class _Surfels:
    """Collects flat Gaussians over rectangles, boxes and balls; world frame, metres."""

    def __init__(self, seed: int, spacing: float) -> None:
        self.rng, self.spacing = np.random.default_rng(seed), spacing
        self.means: list[Floats] = []
        self.normals: list[Floats] = []
        self.colors: list[Floats] = []
        self.sizes: list[Floats] = []

    def rectangle(
        self, corner: Floats, u: Floats, v: Floats, color: Floats, rough: float = 0.02, dense: float = 1.0
    ) -> None:
        """Add a rectangle, by a corner and two sides, with ``rough`` metres of noise along its normal."""
        spacing = self.spacing / dense
        area = float(np.linalg.norm(np.cross(u, v)))
        count = max(4, round(area / spacing**2))
        places = corner + self.rng.random((count, 1)) * u + self.rng.random((count, 1)) * v
        normal = np.cross(u, v) / area
        self._add(places + self.rng.normal(0, rough, (count, 1)) * normal, normal, color, spacing)

    def column(
        self, foot: Floats, across: float, deep: float, tall: float, color: Floats, dense: float, yaw: float = 0.0
    ) -> None:
        """Add the sides and the top of a box, by the centre of its base."""
        a, b, c = np.diag([across, deep, tall]) @ _rotation(np.array([0.0, 0.0, 1.0]), yaw).T
        low = foot - 0.5 * a - 0.5 * b
        for corner, u, v in ((low, a, c), (low + b, a, c), (low, b, c), (low + a, b, c), (low + c, a, b)):
            self.rectangle(corner, u, v, color * self.rng.uniform(0.8, 1.2), 0.01, dense)

    def ball(self, center: Floats, radius: float, color: Floats, dense: float = 1.0) -> None:
        """Add the surface of a ball."""
        spacing = self.spacing / dense
        normals = self.rng.normal(size=(max(8, round(4 * math.pi * radius**2 / spacing**2)), 3))
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        self._add(center + radius * normals, normals, color, spacing)

    def _add(self, places: Floats, normals: Floats, color: Floats, spacing: float) -> None:
        count = len(places)
        self.means.append(places)
        self.normals.append(np.broadcast_to(normals, places.shape) + self.rng.normal(0, 0.12, places.shape))
        wave = 0.1 * np.sin(2.1 * places[:, :1] + 1.3 * places[:, 1:2] + 1.7 * places[:, 2:])
        self.colors.append(np.clip(color + wave + self.rng.normal(0, 0.05, (count, 3)), 0, 1))
        self.sizes.append(spacing * self.rng.uniform(0.5, 0.8, count))

    def gaussians(self) -> Gaussians:
        """Return all Gaussians that were added."""
        means, normals, colors, sizes = map(np.concatenate, (self.means, self.normals, self.colors, self.sizes))
        normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
        across = np.cross(normals, self.rng.normal(size=normals.shape))
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        axes = torch.from_numpy(np.stack([across, np.cross(normals, across), normals], 2))
        scales = np.stack([sizes, sizes * self.rng.uniform(0.6, 1.0, len(sizes)), 0.15 * sizes], 1)
        count = len(means)
        return Gaussians(
            means=torch.from_numpy(means).float(),
            quats=rotations_to_quats(axes).float(),
            scales=torch.from_numpy(scales).float(),
            opacities=torch.from_numpy(self.rng.uniform(0.5, 0.99, count)).float(),
            sh=torch.from_numpy((colors - 0.5) / C0).float().unsqueeze(1),
            batch_size=[count],
        )


def place(kind: str = "courtyard", seed: int = 0, spacing: float = 0.4) -> Gaussians:
    """Return a place of one of ``KINDS``: z up, metres, its floor at z = 0 and its middle near the origin.

    Args:
        kind: a courtyard of about 40 × 30 m, a room, a thing on a tabletop, a garden, or a street.
        seed: seed of sizes, positions and colours; 0 keeps the nominal size.
        spacing: mean distance between Gaussians, metres; rooms and gardens take a quarter of it, things a twentieth.
    """
    rng = np.random.default_rng([KINDS.index(kind), seed])
    size, fine, unit, least, most = LAYOUTS[kind]
    made = _Surfels(seed, spacing * fine)
    long, wide, high = np.array(size) * (rng.uniform([0.7, 0.7, 0.7], [1.2, 1.2, 1.6]) if seed else 1.0)
    low = np.array([-0.5 * long, -0.5 * wide, 0.0])
    x, y, z = np.diag([long, wide, high])

    def color() -> Floats:
        return rng.uniform(0.15, 0.85, 3)

    made.rectangle(low, x, y, color(), 0.0004 * long, dense=rng.uniform(0.4, 1.3) if seed else 1.0)
    walls = [(low, x), (low + y, x), (low, y), (low + x, y)]
    for corner, along in walls[: int(rng.integers(least, most + 1))]:
        made.rectangle(corner, along, z * rng.uniform(0.6, 1.0), color(), 0.002 * long, dense=rng.uniform(0.5, 1.5))
    if kind == "room" and rng.random() < 0.7:
        made.rectangle(low + z, x, y, color(), 0.005, dense=rng.uniform(0.4, 1.0))
    for _ in range(int(rng.integers(4, 13))):
        at = np.array([rng.uniform(-0.42, 0.42) * long, rng.uniform(-0.42, 0.42) * wide, 0.0])
        if np.linalg.norm(at[:2]) < 0.1 * wide:
            continue  # the camera walked there
        if rng.random() < 0.6:
            across, deep, tall = unit * rng.uniform([0.6, 0.6, 0.4], [3.0, 2.0, 2.0])
            made.column(at, across, deep, tall, color(), 2.0, rng.uniform(0.0, math.tau))
        else:  # a tree, or another ball on a stem
            radius, stem = unit * rng.uniform(0.5, 1.8), unit * rng.uniform(0.5, 2.5)
            made.column(at, 0.2 * unit, 0.2 * unit, stem, color(), 3.0)
            made.ball(at + np.array([0.0, 0.0, stem + 0.8 * radius]), radius, color(), 1.5)
    return made.gaussians()


def turned(
    gaussians: Gaussians, seed: int, tilt_deg: float | None = None, scale: float = 1.0
) -> tuple[Gaussians, Tensor]:
    """Return a place in the frame of a file, and the up direction in that frame.

    Args:
        gaussians: the place, world frame.
        seed: chooses the file's up axis, the turn about it, the tilt's direction and a shift.
        tilt_deg: angle between up and the file's nearest axis; None draws any orientation.
        scale: units of the file per metre.

    Returns:
        The Gaussians, and up [3] float64 in the file's frame.
    """
    rng = np.random.default_rng([seed, 7])
    if tilt_deg is None:
        matrix = torch.from_numpy(_rotation(rng.normal(size=3), rng.uniform(0, math.pi)))
    else:
        direction = rng.uniform(0, math.tau)
        across = np.array([math.cos(direction), math.sin(direction), 0.0])
        tilt = torch.from_numpy(_rotation(across, math.radians(tilt_deg)))
        stands = similarity(STANDING[list(STANDING)[int(rng.integers(6))]])[:3, :3]
        about = torch.from_numpy(_rotation(np.array([0.0, 0.0, 1.0]), rng.uniform(0, math.tau)))
        matrix = stands.T @ tilt @ about
    transform = torch.eye(4, dtype=torch.float64)
    transform[:3, :3] = scale * matrix
    # Structure from motion puts the origin near the cameras.
    eye = torch.tensor([*rng.normal(0, 0.5, 2), rng.uniform(0.8, 1.8)], dtype=torch.float64)
    transform[:3, 3] = -transform[:3, :3] @ eye
    return gaussians.transformed(transform), matrix[:, 2]


def _rotation(axis: Floats, angle: float) -> Floats:
    """Return the rotation about an axis, by Rodrigues' formula."""
    x, y, z = axis / np.linalg.norm(axis)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross
