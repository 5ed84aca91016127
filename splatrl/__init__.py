"""splatrl: reinforcement learning for robots that see a captured Gaussian splatting scene."""

from splatrl.bodies import Box, Capsule, Sphere
from splatrl.cameras import Cameras
from splatrl.envs.robot import Robot
from splatrl.envs.splat_env import SplatEnv
from splatrl.scenes import Gaussians, Scene, backyard, read_scene
from splatrl.world import make_env

__all__ = [
    "Box",
    "Cameras",
    "Capsule",
    "Gaussians",
    "Robot",
    "Scene",
    "Sphere",
    "SplatEnv",
    "backyard",
    "make_env",
    "read_scene",
]
