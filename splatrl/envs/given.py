"""Scenes and states that are given to a reset, refused where an episode could not begin there."""

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Bounded, TensorSpec


def given_scene(given: TensorDictBase, scenes: int, only: Tensor | None) -> Tensor:
    """The given scene of each row: a wrong one would ask for what is not there.

    Args:
        given: [B], with ``scene`` [B, 1] int64.
        scenes: how many there are.
        only: [B] bool, the rows that are asked for, since others may hold anything; None asks for all.

    Returns:
        [B] int64.

    Raises:
        ValueError: for a scene that does not exist, or none.
    """
    scene = given.get("scene", None)
    if scene is None or scene.dtype != torch.int64:
        raise ValueError(
            f"scene: expected torch.int64 [B, 1] beside the state, got {None if scene is None else scene.dtype}"
        )
    asked = scene if only is None else scene[only]
    if len(wrong := asked[(asked < 0) | (asked >= scenes)]):
        raise ValueError(f"scene: expected from 0 to {scenes - 1}, got {int(wrong[0])}")
    return scene.squeeze(1).clamp(0, scenes - 1)


def given_state(given: TensorDictBase, spec: TensorSpec, only: Tensor | None) -> Tensor:
    """The given states: a wrong one would wrap around or end up far away.

    Args:
        given: [B], with ``state`` [B, ...].
        spec: of one robot's state.
        only: as for ``given_scene``.

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
