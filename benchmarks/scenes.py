"""The scenes that the benchmarks use, and random views inside them."""

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
    """Where eyes can be: a box, and how far they look up and down.

    Attributes:
        lower: corner, world, metres.
        upper: corner, world, metres.
        pitch: the most that a view is tilted, radians.
    """

    lower: tuple[float, float, float]
    upper: tuple[float, float, float]
    pitch: float = 0.0

    def poses(self, count: int, generator: torch.Generator) -> Tensor:
        """camera_to_world [count, 4, 4] of eyes anywhere in the room that look in any direction."""
        low, high = torch.tensor(self.lower), torch.tensor(self.upper)
        positions = low + (high - low) * torch.rand(count, 3, generator=generator)
        yaw = math.tau * torch.rand(count, generator=generator)
        pitch = self.pitch * (2 * torch.rand(count, generator=generator) - 1)
        forward = torch.stack([yaw.cos() * pitch.cos(), yaw.sin() * pitch.cos(), pitch.sin()], 1)
        return look_at(positions, positions + forward)

    def views(self, count: int, width: int, height: int, seed: int = 1) -> Cameras:
        """Random views, 90 degrees wide; the first ones are the same for every count."""
        g = torch.Generator().manual_seed(seed)
        poses = torch.cat([self.poses(1, g) for _ in range(count)])
        return Cameras(poses, intrinsics(FOV, width, height), width, height)


KITCHEN = Room((-0.9, -0.6, 1.05), (0.9, 0.6, 1.05))
YARD = Room((-2.5, -2.5, 0.2), (2.5, 2.5, 0.8), pitch=0.2)


@dataclass(frozen=True)
class Subject:
    """A scene and the room in it where the views are."""

    scene: Scene
    room: Room


def dense_backyard(count: int = DENSE_COUNT, degree: int = 3, seed: int = 0) -> Scene:
    """The backyard in which every Gaussian has become many small ones, with noise in their colours.

    The small ones are drawn from the shape of the large one, shrunk so that they cover it about as densely as before.

    Args:
        count: of Gaussians, more than twice those of the backyard.
        degree: of the spherical harmonics.
        seed: of the noise.
    """
    g = torch.Generator().manual_seed(seed)
    yard = backyard()
    base = yard.gaussians
    parents = torch.arange(count) * len(base.means) // count
    shrunk = math.sqrt(1.5 * len(base.means) / count)  # Gaussians are flat, so their area goes with the square
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
    """The scene with spherical harmonics of a lower degree: higher degrees are cut off."""
    g = scene.gaussians
    assert degree <= g.sh_degree, (degree, g.sh_degree)
    if degree == g.sh_degree:
        return scene
    sh = g.sh[:, : (degree + 1) ** 2].clone()
    fewer = Gaussians(g.means, g.quats, g.scales, g.opacities, sh, batch_size=g.batch_size)
    return Scene(scene.name, fewer, scene.bounds)


def kitchen() -> Subject | None:
    """The captured kitchen; None, and a line that says so, where its file is not found."""
    path = SCENES / "kitchen" / "kitchen.spz"
    if not path.is_file():
        print(f"kitchen: skipped, no {path}; SPLATRL_SCENES names the folder of scenes")
        return None
    return Subject(read_scene(path, similarity(["x", "-z", "y"])), KITCHEN)


def from_file(path: str) -> Subject:
    """A splat file or a scene folder, seen from the middle half of its bounds."""
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
    """Scenes by name or path, without those that are not found.

    Raises:
        SystemExit: where none is left.
    """
    subjects = {}
    for name in names:
        subject = BUILT[name]() if name in BUILT else from_file(name)
        if subject is not None:
            subjects[subject.scene.name] = subject
    if not subjects:
        raise SystemExit("no scene to measure")
    return subjects
