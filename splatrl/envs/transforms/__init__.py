"""Env transforms: camera noise, frame skip, latency, image appearance, weather and frame stacking."""

from splatrl.envs.transforms.appearance import Appearance
from splatrl.envs.transforms.frame_skip import FrameSkip
from splatrl.envs.transforms.frame_stack import FrameStack
from splatrl.envs.transforms.latency import Latency
from splatrl.envs.transforms.pose_noise import PoseNoise
from splatrl.envs.transforms.randomness import RandomTransform
from splatrl.envs.transforms.simulated import SIMULATED, simulated
from splatrl.envs.transforms.weather import Weather

__all__ = [
    "SIMULATED",
    "Appearance",
    "FrameSkip",
    "FrameStack",
    "Latency",
    "PoseNoise",
    "RandomTransform",
    "Weather",
    "simulated",
]
