"""At a reset, transform only the rows that were reset."""

from collections.abc import Callable

from tensordict import TensorDictBase
from torchrl.envs import Transform

from splatrl.envs.layers import layers
from splatrl.envs.splat_env import SplatEnv


def resets_by_mask(transform: Transform) -> bool:
    """Whether the env under a transform resets by mask (``SplatEnv``): its transforms must not read the mask either."""
    env = transform.container
    base = None if env is None else layers(env)[0]
    return isinstance(base, SplatEnv) and base.resets_by_mask


def transform_reset_rows(
    transform: Transform,
    change: Callable[[TensorDictBase], TensorDictBase],
    tensordict: TensorDictBase,
    tensordict_reset: TensorDictBase,
) -> TensorDictBase:
    """Transform the rows of a reset that ``_reset`` names; what the others hold is TorchRL's to replace.

    Over an env that resets by mask all rows are transformed, and else the others are zero.

    Args:
        transform: reads its ``in_keys`` at a reset, and ``out_keys`` that are there before, and writes ``out_keys``.
        change: what it does.
        tensordict: what the reset was given; without ``_reset`` all rows are reset.
        tensordict_reset: what the env made of it.

    Returns:
        ``tensordict_reset`` with ``out_keys``.
    """
    mask = tensordict.get("_reset", None)
    if mask is None or resets_by_mask(transform):
        return change(tensordict_reset)
    rows = mask.reshape(tensordict_reset.batch_size)
    part = change(tensordict_reset.select(*transform.in_keys, *transform.out_keys, strict=False)[rows])
    for key in transform.out_keys:
        whole = part[key].new_zeros(*rows.shape, *part[key].shape[1:])
        whole[rows] = part[key]
        tensordict_reset.set(key, whole)
    return tensordict_reset
