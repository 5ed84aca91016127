"""Start new episodes where the last ones ended, without synchronising with the host."""

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs import EnvBase


def restart(env: EnvBase, after: TensorDictBase) -> TensorDictBase:
    """Reset the robots whose episode ended, if any.

    The result is that of ``env.maybe_reset``, which synchronises with the host to learn whether any robot, or every
    robot, is done. Here the env draws start states for all rows, and rows whose episode goes on discard theirs.

    Args:
        env: a ``SplatEnv``, bare or under transforms.
        after: [B], what a step returned under ``"next"``; it is not modified.

    Returns:
        [B], what the next step starts from, with the keys of a reset.
    """
    done = after["done"]
    begun = env._reset(TensorDict({"_reset": done}, env.batch_size, device=env.device), set_state=False)

    def chosen(fresh: Tensor, old: Tensor) -> Tensor:
        return torch.where(done.view(-1, *[1] * (fresh.ndim - 1)), fresh, old)

    values = {key: chosen(fresh, after[key]) for key, fresh in begun.items()}
    return TensorDict(values, env.batch_size, device=env.device)
