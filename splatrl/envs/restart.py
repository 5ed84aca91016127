"""Starting new episodes for robots whose last one ended: by mask, without synchronising with the host, or by row."""

from collections.abc import Mapping, Sequence
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs import Compose, EnvBase

from splatrl.envs.nesting import layers
from splatrl.native import _core


def restart(env: EnvBase, after: TensorDictBase) -> TensorDictBase:
    """Reset the robots whose episode ended, if any, without synchronising with the host.

    The result equals that of ``env.maybe_reset``, which synchronises to learn whether any robot, or every robot, is
    done. Here the env draws start states for all rows, and rows whose episode continues discard theirs.

    Args:
        env: a ``SplatEnv``, bare or under transforms.
        after: [B], the result of a step under ``"next"``; it is not modified.

    Returns:
        [B], the input of the next step, with the keys of a reset.
    """
    done = after["done"]

    def chosen(fresh: Tensor, old: Tensor) -> Tensor:
        return where_marked(done.flatten(), fresh, old)

    values: dict[str, Tensor | TensorDictBase] = {}
    for key, fresh in _reset_where(env, done).items():
        old = after.get(key, None)
        if old is None:
            values[key] = fresh
        else:
            values[key] = fresh.apply(chosen, old) if isinstance(fresh, TensorDictBase) else chosen(fresh, old)
    return TensorDict(values, env.batch_size, device=env.device)


def restart_from(env: EnvBase, after: TensorDictBase, rows: Tensor, given: Mapping[str, Tensor]) -> TensorDictBase:
    """Begin episodes from given states in some rows; nothing else of a row's last episode reaches its new one.

    Args:
        env: a ``SplatEnv``, bare or under transforms.
        after: [B], from ``step_mdp``; it is not modified.
        rows: [N] int64, the rows in which episodes begin, on the env's device.
        given: ``state`` and any memory at the start of these episodes, [N, ...] by key; the rest is drawn.

    Returns:
        [B], the input of the next step.
    """
    mask = torch.zeros(env.batch_size, dtype=torch.bool, device=env.device).index_fill_(0, rows, True).unsqueeze(1)
    asked = {key: after[key].index_copy(0, rows, value) for key, value in given.items()}
    values = dict(after.items())
    for key, value in _reset_where(env, mask, asked).items():
        values[key] = _with_rows_of(values.get(key), rows, value)
    return TensorDict._new_unsafe(values, batch_size=after.batch_size, device=after.device)


def maybe_reset(env: EnvBase, after: TensorDictBase) -> TensorDictBase:
    """Do what ``EnvBase.maybe_reset`` does, but by row: TorchRL's merges old and new rows with a mask over every entry.

    Without transforms, only the rows that are reset are drawn, and their views are written straight into place.

    Args:
        env: a ``SplatEnv``, bare or under transforms.
        after: [B], from ``step_mdp``; as in TorchRL, it gains the key ``_reset`` and is otherwise unchanged.

    Returns:
        [B], the input of the next step.
    """
    if not env.any_done(after):
        return after
    values, done = dict(after.items()), after["done"]
    values.pop("_reset", None)
    rows = done.flatten().nonzero().squeeze(1)
    base, around = layers(env)
    if not len(rows) or any(not isinstance(one.transform, Compose) or len(one.transform) for one in around):
        for key, fresh in _reset_where(env, done).items():
            values[key] = _with_rows_of(values.get(key), rows, fresh)
    else:
        values |= base.restarted(values, rows)
    return TensorDict._new_unsafe(values, batch_size=after.batch_size, device=after.device)


class StateWhenAsked(EnvBase):
    """An env that begins at a given state only with ``reset(td, set_state=True)``, as all do from TorchRL 0.15 on.

    TorchRL 0.14 also honours a state without it, with a warning: in a loop that passes the last step with ``_reset`` to
    ``reset``, new episodes would begin where the last ones ended.
    """

    def _resolve_set_state(
        self, set_state: bool | None, tensordict: TensorDictBase | None, select_reset_only: bool
    ) -> bool | None:
        return super()._resolve_set_state(bool(set_state), tensordict, select_reset_only)

    def _reset_proc_data(self, tensordict: TensorDictBase | None, tensordict_reset: TensorDictBase) -> TensorDictBase:
        """Merge new episodes into the given rows; images with ``where_marked``, since TorchRL takes byte after byte."""
        if tensordict is None or "_reset" not in tensordict:
            return super()._reset_proc_data(tensordict, tensordict_reset)
        only, images = tensordict["_reset"].flatten(), dict[str, Tensor]()
        for key, fresh in tensordict_reset.items():
            old = tensordict.get(key, None)
            if isinstance(old, Tensor) and fresh.dtype is torch.uint8 is old.dtype and fresh.shape == old.shape:
                images[key] = where_marked(only, fresh, old)
        rest = super()._reset_proc_data(tensordict.exclude(*images, inplace=True), tensordict_reset.exclude(*images))
        return rest.update(images)


def _reset_where(env: EnvBase, mask: Tensor, given: Mapping[str, Tensor] | None = None) -> TensorDictBase:
    """Reset the rows of an env that a mask selects, [B, 1] bool; in other rows the result [B] may hold anything."""
    asked = TensorDict({**(given or {}), "_reset": mask}, env.batch_size, device=env.device)
    return env._reset(asked, set_state=given is not None)


def _with_rows_of(old: Tensor | TensorDictBase | None, rows: Tensor, fresh: Tensor | TensorDictBase) -> Any:
    """Return an entry with some rows taken from a fresh one, or the fresh one if there is no old: [B, ...] each."""
    if old is None:
        return fresh
    if isinstance(fresh, TensorDictBase):
        return fresh.apply(lambda new, one: _with_rows_of(one, rows, new), old)
    return with_rows([old], rows, [fresh.index_select(0, rows)])[0]


def where_marked(only: Tensor, fresh: Tensor, old: Tensor) -> Tensor:
    """Take the rows that ``only`` [B] bool marks from a fresh batch, and the others from an old one: [B, ...] each.

    Nothing synchronises with the host. Bytes, as of images, are taken eight at a time, since a CPU selects one number
    after another.
    """
    if fresh.dtype is torch.uint8 and fresh[0].numel() % 8 == 0:
        chosen = torch.where(only.unsqueeze(1), _words(fresh), _words(old))
        return chosen.view(torch.uint8).view(fresh.shape)
    return torch.where(only.view(-1, *[1] * (fresh.ndim - 1)), fresh, old)


def _words(values: Tensor) -> Tensor:
    return values.flatten(1).view(torch.int64)


def with_rows(old: Sequence[Tensor], rows: Tensor, fresh: Sequence[Tensor]) -> list[Tensor]:
    """Copy batches with some rows replaced: old [B, ...], rows [N] int64 and fresh [N, ...] give [B, ...], for each."""
    if any(one.requires_grad or not one.is_cpu for one in (*old, *fresh)):
        return [one.index_copy(0, rows, new) for one, new in zip(old, fresh, strict=True)]
    given = [(one.contiguous(), new.contiguous()) for one, new in zip(old, fresh, strict=True)]
    assert all(one.dtype == new.dtype and one.shape[1:] == new.shape[1:] for one, new in given)
    written = [torch.empty_like(one) for one, _ in given]
    tensors = [
        (one.data_ptr(), new.data_ptr(), out.data_ptr(), out.nbytes)
        for (one, new), out in zip(given, written, strict=True)
    ]
    _core.with_rows(tensors, rows.data_ptr(), len(rows), len(old[0]))
    return written
