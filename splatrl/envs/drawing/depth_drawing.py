"""A drawing that also returns the depth of each image, for transforms that need it, such as weather."""

from collections.abc import Mapping

from torchrl.data import TensorSpec, Unbounded

from splatrl.envs.drawing.base import Drawing, Shot, View
from splatrl.renderers.base import Renderer
from splatrl.values import require_number

VIEW_DEPTH = "view_depth"
"""Observation key of each image's depth."""


class DepthDrawing:
    """Wraps another drawing and adds the depth of each image to its observations.

    The added observation is ``view_depth`` [B, H, W] float32: metres along the optical axis, infinite where nothing is
    seen.

    Args:
        drawing: the wrapped drawing.
        height: height of the images, pixels.
        width: width of the images, pixels.

    Raises:
        ValueError: for a height or width that is not a whole number of at least 1.
    """

    def __init__(self, drawing: Drawing, height: int, width: int):
        for name, value in (("height", height), ("width", width)):
            require_number(f"around_drawing.{name}", value, 1, whole=True)
        self.drawing, self.size = drawing, (height, width)

    @property
    def renderer(self) -> Renderer:
        """The wrapped drawing's renderer."""
        return self.drawing.renderer

    @renderer.setter
    def renderer(self, renderer: Renderer) -> None:
        self.drawing.renderer = renderer

    @property
    def specs(self) -> Mapping[str, TensorSpec]:
        """Specs of the wrapped drawing, and ``view_depth``."""
        return {**self.drawing.specs, VIEW_DEPTH: Unbounded(shape=self.size)}

    def draw(self, shot: Shot) -> View:
        """Draw the views of cameras; see ``Drawing``."""
        view = self.drawing.draw(shot._replace(depth=True))
        assert view.depth is not None
        return View(view.pixels, {**view.shown, VIEW_DEPTH: view.depth}, view.depth)
