"""Validation of the scenes and states given to a reset."""

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Bounded, TensorSpec


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
    state = given["state"]
    spec, asked = spec.to(state.device), state if only is None else state[only]
    if not spec.expand(len(asked), *spec.shape).is_in(asked):
        wrong = [row for row, one in enumerate(asked) if not spec.is_in(one)]
        row = wrong[0] if only is None else int(only.nonzero()[wrong[0]])
        limits = f" from {spec.low.tolist()} to {spec.high.tolist()}" if isinstance(spec, Bounded) else ""
        raise ValueError(f"state: expected {spec.dtype}{limits}, got {state.dtype} {state[row].tolist()} in row {row}")
    return state.clone()
