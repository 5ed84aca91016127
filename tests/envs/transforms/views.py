"""Envs of robots in the tiny room, and transforms around them."""

from functools import cache

import torch
from torchrl.envs import Compose, Transform, TransformedEnv

from splatrl.curriculum import Curriculum
from splatrl.envs import SplatEnv
from splatrl.envs.drawing import Drawing, SceneDrawing, Sprite, SpriteDrawing
from splatrl.envs.transforms import Appearance, PoseNoise
from splatrl.renderers import NativeRenderer
from tests.tiny import BlockChecker, tiny_gaussians, tiny_plan, tiny_robot, tiny_task

PLACE = (0.9, 0.0, 0.5)
"""A place between the block in the middle and the east wall."""


@cache
def renderer() -> NativeRenderer:
    """Make a renderer that is fast enough for views that never repeat, such as those of an unsteady camera."""
    return NativeRenderer(tiny_gaussians(), threads=1)


def seeing_env(batch_size: tuple[int, ...] = (3,), seed: int = 0, sprite: bool = False) -> SplatEnv:
    """Make an env of robots in the tiny room, with or without a sprite in it."""
    curriculum = Curriculum(tiny_plan(), None)
    drawing: Drawing = plain_drawing() if sprite else SceneDrawing(renderer())
    return SplatEnv(drawing, BlockChecker(), tiny_robot(), tiny_task(max_steps=8), curriculum, batch_size, seed)


def plain_sprite() -> Sprite:
    """Make an opaque green square, whose texels can be checked by hand."""
    return Sprite.of(torch.tensor([0, 255, 0, 255], dtype=torch.uint8).expand(64, 64, 4).contiguous())


def plain_drawing() -> SpriteDrawing:
    """Make a drawing of the green square in front of the east wall."""
    return SpriteDrawing(renderer(), plain_sprite(), size=0.3, position=PLACE)


def make_transform(name: str) -> Transform:
    """Make one of the transforms with everything switched on."""
    if name == "PoseNoise":
        return PoseNoise(x=0.01, yaw_deg=2.0, smooth=3.0)
    assert name == "Appearance", name
    return Appearance()


NAMES = ("PoseNoise", "Appearance")


def transformed(
    batch_size: tuple[int, ...] = (3,), seed: int = 0, names: tuple[str, ...] = NAMES, sprite: bool = True
) -> TransformedEnv:
    """Make an env under some transforms: a top-level function of plain values, which worker processes can call."""
    return TransformedEnv(seeing_env(batch_size, seed, sprite), Compose(*(make_transform(name) for name in names)))
