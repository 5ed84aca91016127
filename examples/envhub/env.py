"""Turns a Hub repository into an env of LeRobot's EnvHub: lerobot.envs.make_env("you/garden", n_envs=8)

Put this file at the root of a repository, beside a folder ``scene`` (written by ``splatrl-scene`` or
``splatrl-capture``). Without this folder, the env uses the built-in backyard. Whoever loads it needs splatrl installed.
"""

from pathlib import Path

import gymnasium

import splatrl  # registers the tasks

SCENE = Path(__file__).parent / "scene"
TASK = "splatrl/Fps-v0"


def make_env(n_envs: int = 1, use_async_envs: bool = False) -> dict[str, dict[int, gymnasium.vector.VectorEnv]]:
    """Make the task in the scene beside this file.

    Args:
        n_envs: number of robots in the batch.
        use_async_envs: ignored, because a batch needs no subprocesses.

    Returns:
        A suite of one task, in the form that LeRobot expects.
    """
    assert splatrl
    scene = str(SCENE) if SCENE.is_dir() else "backyard"
    return {"splatrl": {0: gymnasium.make_vec(TASK, num_envs=n_envs, scene=scene)}}
