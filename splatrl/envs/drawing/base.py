"""The interface between a robot's camera and its pixels."""

from collections.abc import Mapping
from typing import NamedTuple, Protocol

import torch
from torch import Tensor
from torchrl.data import TensorSpec

from splatrl.cameras import Cameras
from splatrl.renderers.base import Renderer, to_pixels
from splatrl.renderers.parts import Parts

NO_MEMORY: Mapping[str, Tensor] = {}


class Shot(NamedTuple):
    """What is to be drawn: the views of B cameras.

    Attributes:
        cameras: the cameras, world frame.
        memory: the task's memory of each robot, [B, ...] by key, such as the position of its ``target``.
        parts: placed models in each robot's world; None draws the scene alone.
        only: [B] bool, which views to draw; the others are zero. None draws all.
        depth: whether ``View.depth`` is requested.
    """

    cameras: Cameras
    memory: Mapping[str, Tensor] = NO_MEMORY
    parts: Parts | None = None
    only: Tensor | None = None
    depth: bool = False


class View(NamedTuple):
    """Views of B cameras.

    Attributes:
        pixels: [B, H, W, 3] uint8.
        shown: further observations about each image, by key, as described by ``Drawing.specs``.
        depth: [B, H, W] float32, metres along the optical axis, infinite where nothing is seen; None unless requested.
    """

    pixels: Tensor
    shown: Mapping[str, Tensor]
    depth: Tensor | None = None


class Drawing(Protocol):
    """Draws what robots see: the scene, the task's objects in it, and anything that the drawing itself adds.

    Attributes:
        renderer: renders the scene.
    """

    renderer: Renderer

    @property
    def specs(self) -> Mapping[str, TensorSpec]:
        """Specs of one robot's observations other than the pixels, by key."""
        ...

    def draw(self, shot: Shot) -> View:
        """Draw the views of cameras."""
        ...


class SceneDrawing:
    """Draws the scene and the task's parts, nothing else.

    Args:
        renderer: renders the scene.
    """

    def __init__(self, renderer: Renderer):
        self.renderer = renderer

    @property
    def specs(self) -> Mapping[str, TensorSpec]:
        """Empty: there are no observations other than the pixels."""
        return {}

    def draw(self, shot: Shot) -> View:
        """Draw the views of cameras; see ``Drawing``."""
        if not shot.depth:
            return View(self.renderer.pixels(shot.cameras, shot.parts, shot.only), {})
        rgb, metres, alpha = self.renderer.render(shot.cameras, shot.parts, shot.only)
        return View(to_pixels(rgb), {}, solid_depth(metres, alpha))


HAZE = 0.5
"""Pixels whose alpha is below this count as empty."""


def solid_depth(depth: Tensor, alpha: Tensor) -> Tensor:
    """Return depth with nearly empty pixels (alpha below ``HAZE``) set to infinity: [B, H, W] each."""
    return torch.where(alpha < HAZE, torch.inf, depth)
