"""Validation of the scenes, states and memory given to a reset, of actions, and of PyTorch's default dtype."""

from collections.abc import Mapping, Sequence

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Bounded, Categorical, TensorSpec


def given_scene(given: TensorDictBase, scenes: int, only: Tensor | None) -> Tensor:
    """Return the given scene of each row after checking that it exists.

    Args:
        given: [B], with ``scene`` [B, 1] int64.
        scenes: number of scenes.
        only: [B] bool, the rows to check, since others may hold anything; None checks all.

    Returns:
        [B] int64, clamped to valid scenes in rows that are not checked.

    Raises:
        ValueError: for a scene that does not exist, or if no scene is given.
    """
    scene = given.get("scene", None)
    if scene is None or scene.dtype != torch.int64 or scene.shape[1:] != (1,):
        got = None if scene is None else f"{scene.dtype} {list(scene.shape)}"
        raise ValueError(f"scene: expected torch.int64 [B, 1] along with the state, got {got}")
    asked = scene if only is None else scene[only]
    if len(wrong := asked[(asked < 0) | (asked >= scenes)]):
        raise ValueError(f"scene: expected an index from 0 to {scenes - 1}, got {int(wrong[0])}")
    return scene.squeeze(1).clamp(0, scenes - 1)


def given_state(given: TensorDictBase, spec: TensorSpec, only: Tensor | None) -> Tensor:
    """Return a copy of the given states after checking them: an invalid one would wrap around or end up far away.

    Args:
        given: [B], with ``state`` [B, ...].
        spec: spec of one robot's state.
        only: see ``given_scene``.

    Raises:
        ValueError: for a state outside the spec.
    """
    state = given.get("state", None)
    if state is None:
        raise ValueError(f"state: expected {spec.dtype} {_size(spec)} with set_state=True, got none")
    spec, asked = spec.to(state.device), state if only is None else state[only]
    if not spec.expand(len(asked), *spec.shape).is_in(asked):
        wrong = [row for row, one in enumerate(asked) if not spec.is_in(one)]
        row = wrong[0] if only is None else int(only.nonzero()[wrong[0]])
        limits = f" from {spec.low.tolist()} to {spec.high.tolist()}" if isinstance(spec, Bounded) else ""
        raise ValueError(f"state: expected {spec.dtype}{limits}, got {state.dtype} {state[row].tolist()} in row {row}")
    return state.clone()


def check_memory(
    given: TensorDictBase, specs: Mapping[str, TensorSpec], together: Sequence[str], only: Tensor | None
) -> None:
    """Check the given memory of a task: values that contradict each other give wrong rewards.

    Args:
        given: [B], with any of the keys, [B, ...] each.
        specs: specs of one robot's memory, by key.
        together: keys of which all must be given if any is.
        only: see ``given_scene``.

    Raises:
        ValueError: for values outside their spec, or for missing keys.
    """
    found = {key: given[key] for key in specs if given.get(key, None) is not None}
    some, missing = ([key for key in together if (key in found) is there] for there in (True, False))
    if some and missing:
        raise ValueError(f"{', '.join(some)}: expected {', '.join(missing)} along with it, found none")
    for key, value in found.items():
        spec, asked = specs[key].to(value.device), value if only is None else value[only]
        alike = (value.dtype, value.shape[1:]) == (spec.dtype, spec.shape)
        if not alike or not spec.expand(len(asked), *spec.shape).is_in(asked):
            limits = f" from {spec.low.min().item()} to {spec.high.max().item()}" if isinstance(spec, Bounded) else ""
            wanted = f"{spec.dtype} {_size(spec)}{limits}"
            raise ValueError(f"{key}: expected {wanted}, got {value.dtype} {list(value.shape)}, {_shown(asked)}")


def check_batch_size(batch_size: Sequence[int]) -> None:
    """Refuse anything but a list with one whole number of at least 1, with a ValueError."""
    one = isinstance(batch_size, Sequence) and len(batch_size) == 1
    if not one or not isinstance(batch_size[0], int) or isinstance(batch_size[0], bool) or batch_size[0] < 1:
        raise ValueError(f"batch_size: expected a list with one whole number of at least 1, got {batch_size!r:.80}")


def check_seeds(seeds: Sequence[int | None], count: int) -> None:
    """Refuse seeds of robots that are not ``count`` whole numbers or None, with a ValueError."""
    if len(seeds) != count or not all(one is None or type(one) is int for one in seeds):
        raise ValueError(f"seeds: expected {count} whole numbers or None, got {list(seeds)!r:.80}")


def check_kind(action: Tensor, spec: TensorSpec) -> None:
    """Refuse actions of another dtype or shape than [B, ...], without looking at their values, with a ValueError."""
    if (action.dtype, action.shape[1:]) != (spec.dtype, spec.shape):
        got = f"{action.dtype} {list(action.shape)}"
        raise ValueError(f"action: expected {spec.dtype} {_size(spec)}, got {got}")


def check_actions(action: Tensor, spec: TensorSpec) -> None:
    """Refuse numbers of actions that do not exist, or actions that are not finite, [B, ...], with a ValueError."""
    if action.is_floating_point() and len(wrong := (~action.isfinite()).nonzero()):
        raise ValueError(f"action: expected finite numbers, got {action[int(wrong[0, 0])].tolist()}")
    if isinstance(spec, Categorical) and len(wrong := action[(action < 0) | (action >= spec.n)]):
        raise ValueError(f"action: expected whole numbers from 0 to {spec.n - 1}, got {int(wrong[0])}")


def check_default_dtype() -> None:
    """Refuse another default dtype than float32, with a ValueError: new tensors would not fit those that are kept."""
    if (found := torch.get_default_dtype()) != torch.float32:
        raise ValueError(f"torch.set_default_dtype: expected torch.float32, got {found}")


def _size(spec: TensorSpec) -> str:
    """Write the shape of a batch of what a spec of one robot describes."""
    return f"[{', '.join(map(str, ('B', *spec.shape)))}]"


def _shown(values: Tensor) -> str:
    return f"between {values.min().item():g} and {values.max().item():g}" if values.numel() else "nothing"
