"""Transforms around an env: how its camera wavers, what it sees, and how that looks."""

from splatrl.envs.transforms.appearance import Appearance
from splatrl.envs.transforms.billboard import overlay
from splatrl.envs.transforms.frame_stack import FrameStack
from splatrl.envs.transforms.image_goal import ImageGoal
from splatrl.envs.transforms.pose_noise import PoseNoise
from splatrl.envs.transforms.sprite import Sprite, load_sprite
from splatrl.envs.transforms.sprite_overlay import SpriteOverlay, sprite_among

__all__ = [
    "Appearance",
    "FrameStack",
    "ImageGoal",
    "PoseNoise",
    "Sprite",
    "SpriteOverlay",
    "load_sprite",
    "overlay",
    "sprite_among",
]
