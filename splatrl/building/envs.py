"""Builds envs for other programs and for worker processes."""

from collections.abc import Callable, Sequence
from functools import partial
from multiprocessing import current_process

import numpy as np
from torchrl.envs import EnvBase

from splatrl.building.instantiation import instantiate
from splatrl.building.worlds import build_world
from splatrl.configuration import check_texts, load_config
from splatrl.envs.stateful_env import StatefulEnv
from splatrl.envs.validation import check_batch_size, check_default_dtype
from splatrl.values import checked_seed, require_number


def make_env(
    overrides: Sequence[str] = (), batch_size: Sequence[int] | None = None, seed: int | None = None
) -> EnvBase:
    """Make an env from names and paths alone, so that a worker process can make one too.

    The curriculum begins at its easiest level in every new env, so make one for evaluation with ``curriculum=none``.

    Args:
        overrides: overrides in Hydra's grammar, such as ``["scene=kitchen", "scene.path=kitchen.spz"]``.
        batch_size: [B]; None takes ``env.num_envs``.
        seed: seed of the env's generator; None means 0 in the main process, and in a worker process a seed derived
            from its number, so that workers do not start identically. The seeds that ``env_makers`` gives to workers
            do not depend on how processes are numbered.

    Raises:
        ValueError: for a batch size or seed that is not whole numbers, overrides that the command line would refuse,
            or another default dtype of PyTorch than float32.
    """
    check_default_dtype()
    if batch_size is not None:
        check_batch_size(batch_size)
    place = current_process()._identity  # (2,) in the second child of the main process
    seed = (worker_seed(0, *place) if place else 0) if seed is None else checked_seed(seed)
    cfg = load_config(overrides)
    world = build_world(cfg)
    curriculum = instantiate(cfg.curriculum)([one.plan for one in world.worlds])
    env = world.env(cfg.env.num_envs if batch_size is None else batch_size[0], curriculum, seed)
    return env if isinstance(env, StatefulEnv) else StatefulEnv(env)  # TorchRL's collectors keep its state


def env_makers(
    workers: int, overrides: Sequence[str] = (), batch_size: Sequence[int] | None = None, seed: int = 0
) -> list[Callable[[], EnvBase]]:
    """Return one env constructor per worker, in the form that TorchRL's collectors and ``ParallelEnv`` take.

    Example:
        >>> import splatrl
        >>> from torchrl.envs import SerialEnv
        >>> env = SerialEnv(2, splatrl.env_makers(2, ["task=grid"], batch_size=[4]))

    Args:
        workers: number of workers.
        overrides: see ``make_env``.
        batch_size: [B], robots per worker; None takes ``env.num_envs``.
        seed: base seed; the seed of each worker's env is derived from it and from the worker's number.

    Raises:
        ValueError: for fewer than one worker, anything but a list of overrides, or a seed that is no whole number.
    """
    require_number("workers", workers, 1, whole=True)
    check_texts(overrides)
    base = checked_seed(seed)
    return [partial(make_env, overrides, batch_size, worker_seed(base, worker)) for worker in range(workers)]


def worker_seed(seed: int, *worker: int) -> int:
    """Derive a worker's 63-bit seed from its number, or, for nested processes, from its number at each level."""
    return int(np.random.SeedSequence(seed, spawn_key=worker).generate_state(1, np.uint64)[0] >> 1)
