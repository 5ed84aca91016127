"""The file that makes a Hub repository an env of LeRobot's EnvHub: lerobot.envs.make_env("you/garden", n_envs=8)

Put it at the top of a repository, beside the folder of a scene (``splatrl-scene`` or ``splatrl-capture`` write one).
Without such a folder it is the built-in backyard. Whoever loads it needs splatrl installed.
"""

from pathlib import Path

import gymnasium

import splatrl  # registers the tasks

SCENE = Path(__file__).parent / "scene"
TASK = "splatrl/Fps-v0"


def make_env(n_envs: int = 1, use_async_envs: bool = False) -> dict[str, dict[int, gymnasium.vector.VectorEnv]]:
    """The task in the scene beside this file.

    Args:
        n_envs: robots of the batch.
        use_async_envs: has no effect: a batch needs no processes.

    Returns:
        A suite of one task, as LeRobot takes it.
    """
    assert splatrl
    scene = str(SCENE) if SCENE.is_dir() else "backyard"
    return {"splatrl": {0: gymnasium.make_vec(TASK, num_envs=n_envs, scene=scene)}}
