"""Nested envs: a base env and the transformed envs around it."""

from collections.abc import Callable
from typing import TypeAlias

from tensordict import TensorDictBase
from torchrl.envs import Compose, EnvBase, FrameSkipTransform, Transform, TransformedEnv

AnyTransform: TypeAlias = Transform | Callable[[TensorDictBase], TensorDictBase]


def layers(env: EnvBase) -> tuple[EnvBase, list[TransformedEnv]]:
    """Return the base env, and the transformed envs around it, outermost first."""
    around = []
    while isinstance(env, TransformedEnv):
        around.append(env)
        env = env.base_env
    return env, around


def check_layers(env: EnvBase) -> None:
    """Refuse an env under a transform that does not work with it; see ``check_transform``."""
    for around in layers(env)[1]:
        check_transform(around.base_env, around.transform)


def check_transform(env: EnvBase, transform: AnyTransform) -> None:
    """Refuse a transform that does not work around an env whose episodes travel in the TensorDict.

    Raises:
        ValueError: for TorchRL's frame skip, which repeats the step from the same state, or a transform that drops what
            the next step reads from the observations, so that TorchRL hands on the old values instead.
    """
    if isinstance(transform, Compose):
        for each in transform:
            check_transform(env, each)
            env = TransformedEnv(env, each.clone(), auto_unwrap=False)
    elif isinstance(transform, FrameSkipTransform):
        raise ValueError(
            "FrameSkipTransform: expected splatrl.envs.transforms.FrameSkip instead; TorchRL's transform would repeat "
            "each step from the same state, because this env keeps its state in the TensorDict"
        )
    elif isinstance(transform, Transform):
        around = TransformedEnv(env, transform.clone(), auto_unwrap=False)
        if dropped := _observed(env) & {*around.state_spec.keys(True, True)} - _observed(around):
            raise ValueError(
                f"{type(transform).__name__}: expected a transform that keeps what the next step reads, got one that "
                f"drops {', '.join(sorted(map(str, dropped)))} from the observations; select keys of collected batches "
                "instead"
            )


def _observed(env: EnvBase) -> set[str | tuple[str, ...]]:
    return {*env.observation_spec.keys(True, True)}
