"""People who walk through a place during a film and keep out of the camera's way, made of coloured Gaussians."""

import math

import torch
from torch import Tensor

from splatrl.cameras import Cameras
from splatrl.geometry import rigid
from splatrl.renderers import NativeRenderer, Parts
from splatrl.scenes import Gaussians, Scene
from splatrl.spherical_harmonics import C0

LIMBS = {
    "head": (900, (0.0, 0.0, 1.62), (0.1, 0.1, 0.13)),
    "chest": (2_500, (0.0, 0.0, 1.15), (0.16, 0.24, 0.36)),
    "left arm": (700, (0.0, 0.3, 1.1), (0.06, 0.06, 0.32)),
    "right arm": (700, (0.0, -0.3, 1.1), (0.06, 0.06, 0.32)),
    "left leg": (1_400, (0.08, 0.1, 0.42), (0.09, 0.09, 0.44)),
    "right leg": (1_400, (-0.08, -0.1, 0.42), (0.09, 0.09, 0.44)),
}
"""Number of Gaussians, centre and half axes of each body part, metres."""
PATCH, DISC = 0.1, 0.018
"""Side of a patch of one colour, and standard deviation of a Gaussian, metres."""
INSIDE, AWAY, ASIDE = 0.6, 1.6, 0.8
"""Distances to the scene's bounds, to the camera, and between people who walk along the same axis, metres."""
LAP = 20.0
"""Seconds to walk through the place and back."""


def person(seed: int) -> Gaussians:
    """Make a person who stands at the origin, looks along x, and wears colours drawn by the seed."""
    generator = torch.Generator().manual_seed(seed)
    means, colours = [], []
    for discs, middle, half_axes in LIMBS.values():
        outward = torch.nn.functional.normalize(torch.randn(discs, 3, generator=generator), dim=1)
        places = torch.tensor(middle) + outward * torch.tensor(half_axes)
        wear = 0.15 + 0.6 * torch.rand(2, 1, generator=generator) + 0.12 * torch.randn(2, 3, generator=generator)
        patches = (places / PATCH).floor().long().sum(1) % 2
        means.append(places)
        colours.append(wear.clamp(0, 1)[patches])
    count = sum(map(len, means))
    return Gaussians(
        means=torch.cat(means),
        quats=torch.tensor([1.0, 0.0, 0.0, 0.0]).repeat(count, 1),
        scales=torch.full((count, 3), DISC),
        opacities=torch.full((count,), 0.95),
        sh=((torch.cat(colours) - 0.5) / C0)[:, None].contiguous(),
        batch_size=[count],
    )


class PassersBy:
    """A renderer of a place with people, who walk on with each frame.

    Args:
        scene: the place.
        count: number of people.
        fps: frames per second of film.
        tolerance: tolerance of the level of detail, pixels.
    """

    def __init__(self, scene: Scene, count: int, fps: float, tolerance: float) -> None:
        self._renderer = NativeRenderer([scene, *map(person, range(count))], tolerance=tolerance)
        (x, y, _), (right, back, _) = scene.bounds
        self._lower, self._upper = torch.tensor([x + INSIDE, y + INSIDE]), torch.tensor([right - INSIDE, back - INSIDE])
        self._count, self._fps, self._asked = count, fps, 0

    def pixels(self, cameras: Cameras) -> Tensor:
        """Draw the next frame by each of B cameras: [B, H, W, 3] uint8."""
        seconds, eye = self._asked / self._fps, cameras.camera_to_world[0, :2, 3]
        self._asked += 1
        poses = torch.stack([torch.eye(4), *(self.pose(number, seconds, eye) for number in range(self._count))])
        parts = Parts(torch.arange(self._count + 1).expand(len(cameras), -1), poses.expand(len(cameras), -1, 4, 4))
        return self._renderer.pixels(cameras, Parts(*(each.contiguous() for each in parts)))

    def pose(self, number: int, seconds: float, eye: Tensor) -> Tensor:
        """Return the pose of a person: [4, 4]. Every other person crosses the place along x, the rest along y."""
        lap = seconds / LAP * (1 + 0.2 * number) + 0.37 * number
        along, axis = 2 * abs(lap % 1 - 0.5), 1 - number % 2
        place = (self._lower + self._upper) / 2 + ASIDE * (number % 3 - 1)
        place[axis] = self._lower[axis] + along * (self._upper[axis] - self._lower[axis])
        apart = (place - eye).norm()
        if apart < AWAY:
            place = eye + (place - eye) * (AWAY / apart)
        yaw = torch.tensor(axis * math.pi / 2 + 0.2 * math.sin(3 * seconds))
        turn = torch.stack([yaw.cos(), -yaw.sin(), yaw.sin(), yaw.cos()]).view(2, 2)
        rotation = torch.block_diag(turn, torch.eye(1))
        return rigid(rotation, torch.cat([place, torch.zeros(1)]))
