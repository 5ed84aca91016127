"""A renderer in which one fixed model of another renderer is the scene of every row."""

import torch
from torch import Tensor

from splatrl.cameras import Cameras
from splatrl.device_faults import Faulty
from splatrl.renderers.base import Renderer, RenderOutput
from splatrl.renderers.parts import Parts, in_scenes


class OneScene:
    """Shows one of a renderer's several scenes in every row, so that several worlds can share one renderer's memory.

    Args:
        renderer: the renderer that holds the scenes.
        model: index of the model that is shown in its own frame; a task's parts come after it.
    """

    def __init__(self, renderer: Renderer, model: int):
        self.renderer, self.model = renderer, model
        if isinstance(renderer, Faulty):
            self.raise_faults = renderer.raise_faults

    def render(self, cameras: Cameras, parts: Parts | None = None, only: Tensor | None = None) -> RenderOutput:
        """Render colour, depth and alpha for each camera; see ``Renderer``."""
        return self.renderer.render(cameras, self._placed(cameras, parts), only)

    def pixels(self, cameras: Cameras, parts: Parts | None = None, only: Tensor | None = None) -> Tensor:
        """Render the pixels of an observation; see ``Renderer``."""
        return self.renderer.pixels(cameras, self._placed(cameras, parts), only)

    def _placed(self, cameras: Cameras, parts: Parts | None) -> Parts:
        poses = cameras.camera_to_world
        scene = torch.full((len(poses),), self.model, dtype=torch.int64, device=poses.device)
        return in_scenes(scene, parts, poses)
