"""Environments: the robot, how it moves, what it is rewarded for."""

from splatrl.envs.gymnasium_env import GymnasiumEnv, GymnasiumVectorEnv
from splatrl.envs.motions import DriveMotion, ForwardMotion, LatticeMotion, OrbitMotion
from splatrl.envs.robot import Robot
from splatrl.envs.splat_env import SplatEnv

__all__ = [
    "DriveMotion",
    "ForwardMotion",
    "GymnasiumEnv",
    "GymnasiumVectorEnv",
    "LatticeMotion",
    "OrbitMotion",
    "Robot",
    "SplatEnv",
]
