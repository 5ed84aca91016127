"""Environments: the robot, how it moves, what it is rewarded for."""

from splatrl.envs.dynamics import LatticeMotion
from splatrl.envs.robot import Robot
from splatrl.envs.splat_env import SplatEnv

__all__ = ["LatticeMotion", "Robot", "SplatEnv"]
