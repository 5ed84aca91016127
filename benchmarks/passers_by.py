"""People in a film, made of coloured Gaussians: some walk through the place, others along with the camera."""

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
AHEAD, SLOWLY = 2.4, 0.5
"""How far ahead of the camera people walk along with it, metres; seconds within which they follow its turns."""


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

    Those who walk through keep out of the camera's way; those who walk along are ahead of it for the whole film.

    Args:
        scene: the place.
        count: number of people who walk through it.
        along: number of people who walk along.
        fps: frames per second of film.
        tolerance: tolerance of the level of detail, pixels.
    """

    def __init__(self, scene: Scene, count: int, along: int, fps: float, tolerance: float) -> None:
        self._renderer = NativeRenderer([scene, *map(person, range(count + along))], tolerance=tolerance)
        (x, y, _), (right, back, _) = scene.bounds
        self._lower, self._upper = torch.tensor([x + INSIDE, y + INSIDE]), torch.tensor([right - INSIDE, back - INSIDE])
        self._count, self._along, self._fps, self._asked = count, along, fps, 0
        self._ahead: Tensor | None = None

    def pixels(self, cameras: Cameras) -> Tensor:
        """Draw the next frame by each of B cameras: [B, H, W, 3] uint8."""
        seconds, eye, looks = self._asked / self._fps, *cameras.camera_to_world[0, :2, 2:].flip(1).unbind(1)
        self._asked += 1
        self._ahead = looks if self._ahead is None else self._ahead.lerp(looks, 1 / (SLOWLY * self._fps))
        through = [self.pose(number, seconds, eye) for number in range(self._count)]
        along = [self.pose_along(number, seconds, eye, self._ahead) for number in range(self._along)]
        poses = torch.stack([torch.eye(4), *through, *along])
        parts = Parts(torch.arange(len(poses)).expand(len(cameras), -1), poses.expand(len(cameras), -1, 4, 4))
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
        return _standing(place, axis * math.pi / 2 + 0.2 * math.sin(3 * seconds))

    def pose_along(self, number: int, seconds: float, eye: Tensor, ahead: Tensor) -> Tensor:
        """Return the pose of a person who walks along, ahead of the camera: [4, 4]."""
        ahead = ahead / ahead.norm()
        left = torch.stack([-ahead[1], ahead[0]])
        away = AHEAD + 0.6 * number + 0.25 * math.sin(0.7 * seconds + number)
        aside = 0.4 * math.sin(0.45 * seconds + 2 * number)
        heading = math.atan2(float(ahead[1]), float(ahead[0]))
        return _standing(eye + away * ahead + aside * left, heading + 0.2 * math.sin(3 * seconds))


def _standing(place: Tensor, yaw: float) -> Tensor:
    """Return the pose of a person who stands at a place [2] and looks along a yaw: [4, 4]."""
    sine, cosine = math.sin(yaw), math.cos(yaw)
    rotation = torch.tensor([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    return rigid(rotation, torch.cat([place, torch.zeros(1)]))
