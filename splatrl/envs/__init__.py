"""Environments: the robot, its observations, and its tasks."""

from splatrl.envs.gymnasium_env import GymnasiumEnv
from splatrl.envs.gymnasium_vector_env import GymnasiumVectorEnv
from splatrl.envs.mjcf_robot import mjcf_robot
from splatrl.envs.robot import Robot
from splatrl.envs.splat_env import SplatEnv
from splatrl.envs.world import World

__all__ = ["GymnasiumEnv", "GymnasiumVectorEnv", "Robot", "SplatEnv", "World", "mjcf_robot"]
