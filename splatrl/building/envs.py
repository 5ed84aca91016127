"""Builds envs for other programs and for workers."""

from collections.abc import Callable, Sequence
from functools import partial
from multiprocessing import current_process

import numpy as np
from hydra.utils import instantiate
from torchrl.envs import EnvBase

from splatrl.building.worlds import build_world
from splatrl.configuration import load_config
from splatrl.envs.stateful_env import StatefulEnv
from splatrl.values import require_number


def make_env(
    overrides: Sequence[str] = (), batch_size: Sequence[int] | None = None, seed: int | None = None
) -> EnvBase:
    """Make an env from names and paths alone, so that a worker process can do so too.

    Args:
        overrides: overrides in Hydra's grammar, such as ``["scene=kitchen", "scene.path=kitchen.spz"]``.
        batch_size: [B]; None takes ``env.num_envs``.
        seed: seed of the env's generator; None is 0, and in a worker process one that belongs to its number, so that
            workers do not begin alike. ``env_makers`` gives workers seeds that do not depend on processes.

    Raises:
        ValueError: for another shape of the batch, or a config that is refused.
    """
    if batch_size is not None and (isinstance(batch_size, int) or len(batch_size) != 1 or batch_size[0] < 1):
        raise ValueError(f"batch_size: expected a list of one number of at least 1, or None, got {batch_size}")
    cfg = load_config(overrides)
    world = build_world(cfg)
    curriculum = instantiate(cfg.curriculum)([one.plan for one in world.worlds])
    place = current_process()._identity  # (2,) in the second process that the main one started
    seed = (worker_seed(0, *place) if place else 0) if seed is None else seed
    env = world.env(cfg.env.num_envs if batch_size is None else batch_size[0], curriculum, seed)
    return env if isinstance(env, StatefulEnv) else StatefulEnv(env)  # whose state TorchRL's collectors keep


def env_makers(
    workers: int, overrides: Sequence[str] = (), batch_size: Sequence[int] | None = None, seed: int = 0
) -> list[Callable[[], EnvBase]]:
    """Constructors of one env for each worker, as TorchRL's collectors and ``ParallelEnv`` take them.

    Example:
        >>> import splatrl
        >>> from torchrl.envs import SerialEnv
        >>> env = SerialEnv(2, splatrl.env_makers(2, ["task=grid"], batch_size=[4]))

    Args:
        workers: number of workers.
        overrides: see ``make_env``.
        batch_size: [B], robots of each worker; None takes ``env.num_envs``.
        seed: each worker's env has a seed that is derived from this one and from its number.

    Raises:
        ValueError: for fewer workers than one, or a seed that is no whole number from 0.
    """
    require_number("workers", workers, 1, whole=True)
    require_number("seed", seed, 0, whole=True)
    return [partial(make_env, overrides, batch_size, worker_seed(seed, worker)) for worker in range(workers)]


def worker_seed(seed: int, *worker: int) -> int:
    """The seed of a worker with a number, or with one for each generation of processes: 63 bits."""
    return int(np.random.SeedSequence(seed, spawn_key=worker).generate_state(1, np.uint64)[0] >> 1)
