"""Scenes of the benchmarks, and random views inside them."""

import math
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from splatrl.cameras import Cameras, intrinsics, look_at
from splatrl.geometry import quats_to_rotations
from splatrl.scenes import Gaussians, Scene, backyard, read_scene, similarity

ROOT = Path(__file__).parents[1]
SCENES = Path(os.environ.get("SPLATRL_SCENES", ROOT.parent / "shared" / "scenes"))
FOV = math.pi / 2
DENSE_COUNT = 1_000_000
NAMES = ("kitchen", "backyard", "dense")


@dataclass(frozen=True)
class Room:
    """Possible viewpoints: a box of positions, and how far views look up and down.

    Attributes:
        lower: lower corner, world frame, metres.
        upper: upper corner, world frame, metres.
        pitch: maximum tilt of a view, radians.
    """

    lower: tuple[float, float, float]
    upper: tuple[float, float, float]
    pitch: float = 0.0

    def poses(self, count: int, generator: torch.Generator) -> Tensor:
        """Draw camera_to_world [count, 4, 4] anywhere in the room, with any heading."""
        low, high = torch.tensor(self.lower), torch.tensor(self.upper)
        positions = low + (high - low) * torch.rand(count, 3, generator=generator)
        yaw = math.tau * torch.rand(count, generator=generator)
        pitch = self.pitch * (2 * torch.rand(count, generator=generator) - 1)
        forward = torch.stack([yaw.cos() * pitch.cos(), yaw.sin() * pitch.cos(), pitch.sin()], 1)
        return look_at(positions, positions + forward)

    def views(self, count: int, width: int, height: int, seed: int = 1) -> Cameras:
        """Draw random views, 90 degrees wide; a larger count begins with the same views."""
        g = torch.Generator().manual_seed(seed)
        poses = torch.cat([self.poses(1, g) for _ in range(count)])
        return Cameras(poses, intrinsics(FOV, width, height), width, height)


KITCHEN = Room((-0.9, -0.6, 1.05), (0.9, 0.6, 1.05))
YARD = Room((-2.5, -2.5, 0.2), (2.5, 2.5, 0.8), pitch=0.2)


@dataclass(frozen=True)
class Subject:
    """A scene and the room in it from which it is viewed."""

    scene: Scene
    room: Room


def dense_backyard(count: int = DENSE_COUNT, degree: int = 3, seed: int = 0) -> Scene:
    """Build the backyard with every Gaussian replaced by many small ones with noisy colours.

    The small ones are sampled from the large one's distribution and shrunk so that they cover it about as densely.

    Args:
        count: number of Gaussians, more than twice that of the backyard.
        degree: degree of the spherical harmonics.
        seed: seed of the noise.
    """
    g = torch.Generator().manual_seed(seed)
    yard = backyard()
    base = yard.gaussians
    parents = torch.arange(count) * len(base.means) // count
    shrunk = math.sqrt(1.5 * len(base.means) / count)  # they are flat: their area goes with the square
    spread = math.sqrt(1 - shrunk**2) * torch.randn(count, 3, generator=g).clamp(-2, 2)
    offsets = quats_to_rotations(base.quats)[parents] @ (base.scales[parents] * spread).unsqueeze(-1)
    sh = 0.06 * torch.randn(count, (degree + 1) ** 2, 3, generator=g)
    sh[:, 0] = base.sh[parents, 0] + 0.15 * torch.randn(count, 3, generator=g)
    gaussians = Gaussians(
        means=base.means[parents] + offsets.squeeze(-1),
        quats=base.quats[parents],
        scales=base.scales[parents] * shrunk,
        opacities=base.opacities[parents],
        sh=sh,
        batch_size=[count],
    )
    return Scene("dense", gaussians, yard.bounds)


def truncated(scene: Scene, degree: int) -> Scene:
    """Return the scene with its spherical harmonics truncated to a lower degree."""
    g = scene.gaussians
    assert degree <= g.sh_degree, (degree, g.sh_degree)
    if degree == g.sh_degree:
        return scene
    sh = g.sh[:, : (degree + 1) ** 2].clone()
    fewer = Gaussians(g.means, g.quats, g.scales, g.opacities, sh, batch_size=g.batch_size)
    return Scene(scene.name, fewer, scene.bounds)


def kitchen() -> Subject | None:
    """Read the captured kitchen; print a line and return None if its file is not found."""
    path = SCENES / "kitchen" / "kitchen.spz"
    if not path.is_file():
        print(f"kitchen: skipped, no {path}; SPLATRL_SCENES names the folder of scenes")
        return None
    return Subject(read_scene(path, similarity(["x", "-z", "y"])), KITCHEN)


def from_file(path: str) -> Subject:
    """Read a splat file or a scene folder, to be viewed from the middle half of its bounds."""
    scene = read_scene(path)
    corners = torch.tensor(scene.bounds)
    middle, quarter = corners.mean(0), (corners[1] - corners[0]) / 4
    lower, upper = ((middle + sign * quarter).tolist() for sign in (-1, 1))
    return Subject(scene, Room(tuple(lower), tuple(upper), pitch=0.2))


BUILT: dict[str, Callable[[], Subject | None]] = {
    "kitchen": kitchen,
    "backyard": lambda: Subject(backyard(), YARD),
    "dense": lambda: Subject(dense_backyard(), YARD),
}


def chosen(names: list[str]) -> dict[str, Subject]:
    """Return scenes by name or path, without those that are not found.

    Raises:
        SystemExit: if none is left.
    """
    subjects = {}
    for name in names:
        subject = BUILT[name]() if name in BUILT else from_file(name)
        if subject is not None:
            subjects[subject.scene.name] = subject
    if not subjects:
        raise SystemExit("no scene to measure")
    return subjects
