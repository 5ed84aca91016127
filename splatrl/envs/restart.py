"""New episodes where the last ones ended, without the host looking where that is."""

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs import EnvBase


def restart(env: EnvBase, after: TensorDictBase) -> TensorDictBase:
    """Reset the robots whose episode ended, whether there are any or not.

    It gives what ``env.maybe_reset`` gives, which asks the host whether any is done, and whether all are. The env
    draws start states for all rows here, and those that go on drop theirs.

    Args:
        env: a ``SplatEnv``, bare or under transforms.
        after: [B], what a step gave under ``"next"``; it is left as it is.

    Returns:
        [B], what the next step starts from: the keys that a reset gives.
    """
    done = after["done"]
    begun = env._reset(TensorDict({"_reset": done}, env.batch_size, device=env.device), set_state=False)

    def chosen(fresh: Tensor, old: Tensor) -> Tensor:
        return torch.where(done.view(-1, *[1] * (fresh.ndim - 1)), fresh, old)

    values = {key: chosen(fresh, after[key]) for key, fresh in begun.items()}
    return TensorDict(values, env.batch_size, device=env.device)
