"""Drawing what robots see: the scene and whatever is composited into it."""

from splatrl.envs.drawing.base import Drawing, SceneDrawing, Shot, View
from splatrl.envs.drawing.billboard import overlay
from splatrl.envs.drawing.depth_drawing import DepthDrawing
from splatrl.envs.drawing.sprite import Sprite, load_sprite
from splatrl.envs.drawing.sprite_drawing import SpriteDrawing

__all__ = [
    "DepthDrawing",
    "Drawing",
    "SceneDrawing",
    "Shot",
    "Sprite",
    "SpriteDrawing",
    "View",
    "load_sprite",
    "overlay",
]
