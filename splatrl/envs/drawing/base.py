"""What is drawn for a robot: the one place between a camera and the pixels that it gives."""

from collections.abc import Mapping
from typing import NamedTuple, Protocol

from torch import Tensor
from torchrl.data import TensorSpec

from splatrl.cameras import Cameras
from splatrl.renderers.base import Renderer
from splatrl.renderers.parts import Parts

NO_MEMORY: Mapping[str, Tensor] = {}


class View(NamedTuple):
    """What B cameras see.

    Attributes:
        pixels: [B, H, W, 3] uint8.
        shown: what else the drawing tells of each image, by key, as its ``specs`` say; observations of the env.
    """

    pixels: Tensor
    shown: Mapping[str, Tensor]


class Drawing(Protocol):
    """Draws what robots see: the scene, what the task places in it, and whatever the drawing adds of its own.

    Attributes:
        renderer: of the scene.
    """

    renderer: Renderer

    @property
    def specs(self) -> Mapping[str, TensorSpec]:
        """Specs of what it tells beside the pixels, of one robot, by key."""
        ...

    def draw(
        self,
        cameras: Cameras,
        memory: Mapping[str, Tensor] = NO_MEMORY,
        parts: Parts | None = None,
        only: Tensor | None = None,
    ) -> View:
        """Draw the views of cameras.

        Args:
            cameras: B views.
            memory: what the task remembers of each robot, [B, ...] by key, such as where its ``target`` is.
            parts: placed models of each robot's world; None is the scene alone.
            only: [B] bool, which to draw; the others are zero. None draws all.
        """
        ...


class SceneDrawing:
    """Draws the scene and the task's parts, and nothing else.

    Args:
        renderer: of the scene.
    """

    def __init__(self, renderer: Renderer):
        self.renderer = renderer

    @property
    def specs(self) -> Mapping[str, TensorSpec]:
        """It tells nothing beside the pixels."""
        return {}

    def draw(
        self,
        cameras: Cameras,
        memory: Mapping[str, Tensor] = NO_MEMORY,
        parts: Parts | None = None,
        only: Tensor | None = None,
    ) -> View:
        """Draw the views of cameras; see ``Drawing``."""
        return View(self.renderer.pixels(cameras, parts, only), {})
