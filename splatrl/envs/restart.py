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
    return TensorDict(_merged(env, after, None), env.batch_size, device=env.device)


def maybe_reset(env: EnvBase, after: TensorDictBase) -> TensorDictBase:
    """Do what ``EnvBase.maybe_reset`` does, which merges old and new rows by a mask over every entry; here by row.

    Args:
        env: a ``SplatEnv``, bare or under transforms.
        after: [B], from ``step_mdp``.

    Returns:
        [B], what the next step starts from.
    """
    if not env.any_done(after):
        return after
    result, rows = after.exclude("_reset"), after["done"].flatten().nonzero().squeeze(1)
    for key, value in _merged(env, after, rows).items():
        result.set(key, value)
    return result


def _merged(env: EnvBase, after: TensorDictBase, rows: Tensor | None) -> dict[str, Tensor | TensorDictBase]:
    """The entries of a reset, in rows that are done new, in the others those of ``after``.

    Args:
        env: see ``restart``.
        after: see ``restart``.
        rows: [N] int64, those that are done; None merges by mask, which reads nothing on the host.
    """
    done = after["done"]
    begun = env._reset(TensorDict({"_reset": done}, env.batch_size, device=env.device), set_state=False)

    def chosen(fresh: Tensor, old: Tensor) -> Tensor:
        if rows is None:
            return torch.where(done.view(-1, *[1] * (fresh.ndim - 1)), fresh, old)
        return old.index_copy(0, rows, fresh.index_select(0, rows))

    values: dict[str, Tensor | TensorDictBase] = {}
    for key, fresh in begun.items():
        old = after.get(key, None)
        if old is None:
            values[key] = fresh
        elif isinstance(fresh, TensorDictBase):
            values[key] = fresh.apply(chosen, old)
        else:
            values[key] = chosen(fresh, old)
    return values
