"""Envs of both Gymnasium adapters, as clients make them."""

from typing import Any

from torchrl.envs import EnvBase

from splatrl.envs.gymnasium_env import GymnasiumEnv
from splatrl.envs.gymnasium_vector_env import GymnasiumVectorEnv
from tests.tiny import tiny_env

FORWARD_X, BACK_X, LEFT_Y, RIGHT_Y, SPIN, SPIN_BACK = range(6)


def make_tiny(render_mode: str | None = None, **settings: Any) -> GymnasiumEnv:
    """Make the tiny env, as an entry point for ``gymnasium.make``."""
    return GymnasiumEnv(tiny_env([1], **settings), render_mode=render_mode)


def vector(env: EnvBase | None = None, **settings: Any) -> GymnasiumVectorEnv:
    """Make a batch of robots, by default of three in the tiny env."""
    return GymnasiumVectorEnv(env or tiny_env([3], **settings))
