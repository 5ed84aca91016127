"""Turns a Hub repository into an env of LeRobot's EnvHub: lerobot.envs.make_env("you/garden", n_envs=8)

Put this file at the root of a repository, beside a folder ``scene`` (written by ``splatrl-scene`` or
``splatrl-capture``). Without this folder, the env uses the built-in backyard. Whoever loads it needs splatrl installed.

Observations and actions are those of the datasets that ``splatrl-record task=drive lerobot=...`` writes, so a policy
that LeRobot trained on such a dataset acts here, also in its ``rollout`` and ``eval_policy``.
"""

from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box, Dict
from gymnasium.wrappers import ClipAction, RescaleAction

import splatrl  # registers the tasks

SCENE = Path(__file__).parent / "scene"
TASK = "splatrl/Drive-v0"  # with continuous actions, as LeRobot's policies have them
STEPS = 100
OVERRIDES = [f"task.max_steps={STEPS}", "curriculum=none"]  # without a curriculum, episodes begin anywhere


class LeRobotEnv(gymnasium.Wrapper):
    """A robot whose observations have LeRobot's names, and whose actions the units of the recorded ones."""

    task_description = "drive to the goal"
    _max_episode_steps = STEPS

    def __init__(self, scene: str):
        env = gymnasium.make(TASK, scene=scene, overrides=OVERRIDES, render_mode="rgb_array")
        units = env.unwrapped.env.action_spec_unbatched.space  # metres and radians per second
        super().__init__(ClipAction(RescaleAction(env, units.low.numpy(), units.high.numpy())))
        state = Box(-np.inf, np.inf, (3,), np.float32)  # x, y and yaw
        self.observation_space = Dict(pixels=Dict(front=env.observation_space), agent_pos=state)

    def reset(self, **options: Any) -> tuple[Any, dict[str, Any]]:
        """Begin an episode."""
        view, info = self.env.reset(**options)
        return {"pixels": {"front": view}, "agent_pos": info["state"]}, info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Take one action."""
        view, reward, terminated, truncated, info = self.env.step(action)
        return {"pixels": {"front": view}, "agent_pos": info["state"]}, reward, terminated, truncated, info


def make_env(n_envs: int = 1, use_async_envs: bool = False) -> dict[str, dict[int, gymnasium.vector.VectorEnv]]:
    """Make robots in the scene beside this file.

    Args:
        n_envs: number of robots.
        use_async_envs: whether each robot has a process of its own.

    Returns:
        A suite of one task, in the form that LeRobot expects.
    """
    assert splatrl
    scene = str(SCENE) if SCENE.is_dir() else "backyard"
    vector = gymnasium.vector.AsyncVectorEnv if use_async_envs else gymnasium.vector.SyncVectorEnv
    robots = [partial(LeRobotEnv, scene)] * n_envs
    return {"splatrl": {0: vector(robots, autoreset_mode=gymnasium.vector.AutoresetMode.SAME_STEP)}}
