"""Nested envs: a base env and the transformed envs around it."""

from collections.abc import Mapping
from typing import Any

from torchrl.envs import EnvBase, FrameSkipTransform, Transform, TransformedEnv


def layers(env: EnvBase) -> tuple[EnvBase, list[TransformedEnv]]:
    """Return the base env, and the transformed envs around it, outermost first."""
    around = []
    while isinstance(env, TransformedEnv):
        around.append(env)
        env = env.base_env
    return env, around


def state_of(env: EnvBase) -> dict[str, Any]:
    """Return the state of a base env and of the transforms around it, as tensors and plain values."""
    base, transformed = layers(env)
    return {"env": base.state_dict(), "transforms": [around.transform.state_dict() for around in transformed]}


def set_state(env: EnvBase, state: Mapping[str, Any]) -> None:
    """Let an env continue from the ``state_of`` another of the same kind.

    Raises:
        RuntimeError: for another number of transforms.
    """
    base, transformed = layers(env)
    base.load_state_dict(state["env"])
    if len(transformed) != len(state["transforms"]):
        raise RuntimeError(f"expected {len(state['transforms'])} layers of transforms, got {len(transformed)}")
    for around, saved in zip(transformed, state["transforms"], strict=True):
        around.transform.load_state_dict(saved)


def check_layers(env: EnvBase) -> None:
    """Refuse an env under a transform that does not work with it; see ``refuse_frame_skip``."""
    for around in layers(env)[1]:
        refuse_frame_skip(around.transform)


def refuse_frame_skip(transform: Transform) -> None:
    """Refuse TorchRL's frame skip, which repeats the step from the same state.

    Raises:
        ValueError: for such a transform; names the one to use instead.
    """
    if any(isinstance(part, FrameSkipTransform) for part in transform.modules()):
        raise ValueError(
            "FrameSkipTransform: expected splatrl.envs.transforms.FrameSkip instead; TorchRL's transform would repeat "
            "each step from the same state, because this env keeps its state in the TensorDict"
        )
