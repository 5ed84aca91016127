"""One of the models of a renderer as the scene of every row."""

import torch
from torch import Tensor

from splatrl.cameras import Cameras
from splatrl.faults import Faulty
from splatrl.renderers.base import Renderer, RenderOutput
from splatrl.renderers.parts import Parts, in_scenes


class OneScene:
    """A renderer of several scenes, of which every row sees one; so several worlds share their Gaussians in memory.

    Args:
        renderer: holds the scenes.
        model: which of its models is seen where it stands; a task's parts come after it.
    """

    def __init__(self, renderer: Renderer, model: int):
        self.renderer, self.model = renderer, model
        if isinstance(renderer, Faulty):
            self.raise_faults = renderer.raise_faults

    def render(self, cameras: Cameras, parts: Parts | None = None, only: Tensor | None = None) -> RenderOutput:
        """Colour, depth and alpha of each camera; see ``Renderer``."""
        return self.renderer.render(cameras, self._placed(cameras, parts), only)

    def pixels(self, cameras: Cameras, parts: Parts | None = None, only: Tensor | None = None) -> Tensor:
        """The pixels of an observation; see ``Renderer``."""
        return self.renderer.pixels(cameras, self._placed(cameras, parts), only)

    def _placed(self, cameras: Cameras, parts: Parts | None) -> Parts:
        poses = cameras.camera_to_world
        scene = torch.full((len(poses),), self.model, dtype=torch.int64, device=poses.device)
        return in_scenes(scene, parts, poses)
