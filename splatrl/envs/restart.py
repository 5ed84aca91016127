"""Start new episodes where the last ones ended: by a mask, without synchronising with the host, or by row."""

from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs import Compose, EnvBase

from splatrl.envs.nesting import layers
from splatrl.renderers.base import with_rows


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

    def chosen(fresh: Tensor, old: Tensor) -> Tensor:
        return torch.where(done.view(-1, *[1] * (fresh.ndim - 1)), fresh, old)

    values: dict[str, Tensor | TensorDictBase] = {}
    for key, fresh in _reset_where(env, done).items():
        old = after.get(key, None)
        if old is None:
            values[key] = fresh
        else:
            values[key] = fresh.apply(chosen, old) if isinstance(fresh, TensorDictBase) else chosen(fresh, old)
    return TensorDict(values, env.batch_size, device=env.device)


def maybe_reset(env: EnvBase, after: TensorDictBase) -> TensorDictBase:
    """Do what ``EnvBase.maybe_reset`` does, which merges old and new rows by a mask over every entry; here by row.

    Without transforms, what the robots see is drawn for the rows that are reset and goes straight to its place.

    Args:
        env: a ``SplatEnv``, bare or under transforms.
        after: [B], from ``step_mdp``; as in TorchRL it is given ``_reset``, and nothing else.

    Returns:
        [B], what the next step starts from.
    """
    if not env.any_done(after):
        return after
    values, done = dict(after.items()), after["done"]
    del values["_reset"]
    rows = done.flatten().nonzero().squeeze(1)
    base, around = layers(env)
    if not len(rows) or any(not isinstance(one.transform, Compose) or len(one.transform) for one in around):
        for key, fresh in _reset_where(env, done).items():
            values[key] = _with_rows_of(values.get(key), rows, fresh)
    else:
        for key, fresh in base.begun(rows).items():
            values[key] = with_rows(values[key], rows, fresh)
    return TensorDict._new_unsafe(values, batch_size=after.batch_size, device=after.device)


def _reset_where(env: EnvBase, mask: Tensor) -> TensorDictBase:
    """What a reset of some rows of an env returns, [B]; in the others it may hold anything: [B, 1] bool."""
    return env._reset(TensorDict({"_reset": mask}, env.batch_size, device=env.device), set_state=False)


def _with_rows_of(old: Tensor | TensorDictBase | None, rows: Tensor, fresh: Tensor | TensorDictBase) -> Any:
    """An entry of which some rows are those of another one, or that one where there is none: [B, ...] each."""
    if old is None:
        return fresh
    if isinstance(fresh, TensorDictBase):
        return fresh.apply(lambda new, one: _with_rows_of(one, rows, new), old)
    return with_rows(old, rows, fresh.index_select(0, rows))
