"""The generator behind ``splatrl.scenes.backyard``: a sunny yard, generated in seconds, with a red egg to find."""

from splatrl.scenes.yard.generator import backyard_gaussians
from splatrl.scenes.yard.layout import EGG, backyard_obstacles

__all__ = ["EGG", "backyard_gaussians", "backyard_obstacles"]
