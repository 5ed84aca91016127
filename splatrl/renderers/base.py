"""What every renderer promises."""

from typing import NamedTuple, Protocol

from torch import Tensor

from splatrl.cameras import Cameras


class RenderOutput(NamedTuple):
    """A batch of rendered views.

    Attributes:
        rgb: [B, H, W, 3] float32 in [0, 1], sRGB, over the background.
        depth: [B, H, W] float32, metres along the optical axis: the mean over what the pixel shows, weighted by its
            share of the pixel (expected depth); 0 where alpha is 0.
        alpha: [B, H, W] float32 in [0, 1], the share of the pixel that Gaussians cover.
    """

    rgb: Tensor
    depth: Tensor
    alpha: Tensor


class Renderer(Protocol):
    """Turns cameras into images of one scene. Frame i has the same bytes whatever else is in the batch."""

    def render(self, cameras: Cameras) -> RenderOutput:
        """Colour, depth and alpha of each camera."""
        ...

    def pixels(self, cameras: Cameras) -> Tensor:
        """What an observation is: [B, H, W, 3] uint8, ``round(255 · rgb)``."""
        ...
