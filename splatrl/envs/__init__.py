"""Environments: the robot, how it moves, what it is rewarded for."""

from splatrl.envs.dynamics import LatticeMotion
from splatrl.envs.gymnasium_env import GymnasiumEnv, GymnasiumVectorEnv
from splatrl.envs.robot import Robot
from splatrl.envs.splat_env import SplatEnv

__all__ = ["GymnasiumEnv", "GymnasiumVectorEnv", "LatticeMotion", "Robot", "SplatEnv"]
