"""Transforms around an env: camera noise, image appearance and stacked frames."""

from splatrl.envs.transforms.appearance import Appearance
from splatrl.envs.transforms.frame_stack import FrameStack
from splatrl.envs.transforms.pose_noise import PoseNoise
from splatrl.envs.transforms.randomness import RandomTransform

__all__ = ["Appearance", "FrameStack", "PoseNoise", "RandomTransform"]
