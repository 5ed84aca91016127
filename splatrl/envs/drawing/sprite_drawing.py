"""Drawing an object that is not part of the scene, as a sprite at a position in it."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import torch
from torch import Tensor
from torchrl.data import Bounded, TensorSpec

from splatrl.envs.drawing.base import Shot, View, solid_depth
from splatrl.envs.drawing.billboard import overlay
from splatrl.envs.drawing.sprite import Sprite, load_sprite
from splatrl.renderers.base import Renderer, to_pixels
from splatrl.values import are_numbers, require_number


class SpriteDrawing:
    """Draws the scene and a sprite at a position in the world, occluded by nearer parts of the scene (``overlay``).

    Besides the pixels it returns ``sprite_share`` [B, 1] float32, the fraction of the image that the sprite covers: 0
    where none of it is seen.

    Args:
        renderer: renders the scene.
        sprite: ``"apple"``, the path of a PNG with alpha, or a ``Sprite``.
        size: width of the sprite, metres.
        position: x, y and z of its centre, world, metres; None uses ``target`` from the task's memory.
        near: near plane, metres: a sprite closer than this along the optical axis is not drawn.

    Raises:
        ValueError: for a ``size`` or ``near`` that is not positive and finite, a ``position`` that is not three finite
            numbers, or a picture that cannot be read.
    """

    def __init__(
        self,
        renderer: Renderer,
        sprite: str | Path | Sprite = "apple",
        size: float = 0.16,
        position: Sequence[float] | None = None,
        near: float = 0.05,
    ):
        for name, value in {"size": size, "near": near}.items():
            require_number(f"drawing.{name}", value, above=0.0, unit="metres")
        if position is not None and not are_numbers(position, 3):
            raise ValueError(f"drawing.position: expected finite x, y and z in metres, got {position}")
        self.renderer = renderer
        self.sprite = sprite if isinstance(sprite, Sprite) else load_sprite(sprite)
        self.size, self.near = size, near
        self.position = None if position is None else torch.tensor([float(value) for value in position])
        self._copies = {self.sprite.texels.device: (self.sprite, self.position)}

    @property
    def specs(self) -> Mapping[str, TensorSpec]:
        """Spec of ``sprite_share``."""
        return {"sprite_share": Bounded(0.0, 1.0, shape=(1,), dtype=torch.float32)}

    def draw(self, shot: Shot) -> View:
        """Draw the views of cameras; see ``Drawing``.

        Raises:
            ValueError: if neither ``position`` nor the task gives the sprite's position.
        """
        rgb, metres, alpha = self.renderer.render(shot.cameras, shot.parts, shot.only)
        sprite, position = self._on(rgb.device)
        target = shot.memory.get("target") if position is None else position
        if target is None:
            raise ValueError("drawing.position: expected x, y and z in metres for a task without a target, got None")
        view = (to_pixels(rgb), solid_depth(metres, alpha), shot.cameras.camera_to_world, shot.cameras.K[0])
        pixels, share, depth = overlay(*view, target, sprite, self.size, self.near, shot.only)
        return View(pixels, {"sprite_share": share}, depth if shot.depth else None)

    def _on(self, device: torch.device) -> tuple[Sprite, Tensor | None]:
        """Return sprite and position on a device; the copies are cached, since a captured graph keeps reading them."""
        if device not in self._copies:
            position = None if self.position is None else self.position.to(device)
            self._copies[device] = self.sprite.to(device), position
        return self._copies[device]
