"""At a reset, transform only the rows that were reset."""

from collections.abc import Callable, Sequence

from tensordict import TensorDictBase


def transform_reset_rows(
    transform: Callable[[TensorDictBase], TensorDictBase],
    in_keys: Sequence[str],
    out_keys: Sequence[str],
    tensordict: TensorDictBase,
    tensordict_reset: TensorDictBase,
) -> TensorDictBase:
    """Transform the rows of a reset that ``_reset`` names; the others are zero, and TorchRL's to fill in.

    Args:
        transform: reads ``in_keys`` of a TensorDict and writes ``out_keys``.
        in_keys: what it reads.
        out_keys: what it writes.
        tensordict: what the reset was given; without ``_reset`` all rows are reset.
        tensordict_reset: what the env made of it.

    Returns:
        ``tensordict_reset`` with ``out_keys``.
    """
    mask = tensordict.get("_reset", None)
    if mask is None:
        return transform(tensordict_reset)
    rows = mask.reshape(tensordict_reset.batch_size)
    part = transform(tensordict_reset.select(*in_keys)[rows])
    for key in out_keys:
        whole = part[key].new_zeros(*rows.shape, *part[key].shape[1:])
        whole[rows] = part[key]
        tensordict_reset.set(key, whole)
    return tensordict_reset
