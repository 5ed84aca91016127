"""Transforms around an env: camera noise, repeated actions, image appearance and stacked frames."""

from splatrl.envs.transforms.appearance import Appearance
from splatrl.envs.transforms.frame_skip import FrameSkip
from splatrl.envs.transforms.frame_stack import FrameStack
from splatrl.envs.transforms.pose_noise import PoseNoise
from splatrl.envs.transforms.randomness import RandomTransform

__all__ = ["Appearance", "FrameSkip", "FrameStack", "PoseNoise", "RandomTransform"]
