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


class View(NamedTuple):
    """What B cameras see.

    Attributes:
        pixels: [B, H, W, 3] uint8.
        shown: further observations about each image, by key, as ``Drawing.specs`` describes them.
        depth: [B, H, W] float32, metres along the optical axis, infinite where nothing is seen; None unless asked for.
    """

    pixels: Tensor
    shown: Mapping[str, Tensor]
    depth: Tensor | None = None


class Drawing(Protocol):
    """Draws what robots see: the scene, what the task places in it, and whatever the drawing itself adds.

    Attributes:
        renderer: renders the scene.
    """

    renderer: Renderer

    @property
    def specs(self) -> Mapping[str, TensorSpec]:
        """Specs of one robot's observations besides the pixels, by key."""
        ...

    def draw(
        self,
        cameras: Cameras,
        memory: Mapping[str, Tensor] = NO_MEMORY,
        parts: Parts | None = None,
        only: Tensor | None = None,
        depth: bool = False,
    ) -> View:
        """Draw the views of cameras.

        Args:
            cameras: B views.
            memory: what the task remembers about each robot, [B, ...] by key, such as the position of its ``target``.
            parts: placed models of each robot's world; None is the scene alone.
            only: [B] bool, which views to draw; the others are zero. None draws all.
            depth: whether to give the depth as well.
        """
        ...


class SceneDrawing:
    """Draws the scene and the task's parts, and nothing else.

    Args:
        renderer: renders the scene.
    """

    def __init__(self, renderer: Renderer):
        self.renderer = renderer

    @property
    def specs(self) -> Mapping[str, TensorSpec]:
        """There are no observations besides the pixels."""
        return {}

    def draw(
        self,
        cameras: Cameras,
        memory: Mapping[str, Tensor] = NO_MEMORY,
        parts: Parts | None = None,
        only: Tensor | None = None,
        depth: bool = False,
    ) -> View:
        """Draw the views of cameras; see ``Drawing``."""
        if not depth:
            return View(self.renderer.pixels(cameras, parts, only), {})
        rgb, metres, alpha = self.renderer.render(cameras, parts, only)
        return View(to_pixels(rgb), {}, solid_depth(metres, alpha))


HAZE = 0.5
"""A pixel with less alpha than this counts as empty."""


def solid_depth(depth: Tensor, alpha: Tensor) -> Tensor:
    """The depth of what is seen, infinite where a pixel is nearly empty: [B, H, W] each."""
    return torch.where(alpha < HAZE, torch.inf, depth)
