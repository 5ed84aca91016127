"""Nested envs: a base env and the transformed envs around it."""

from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

from tensordict import TensorDictBase
from torchrl.envs import Compose, EnvBase, FrameSkipTransform, ObservationNorm, Transform, TransformedEnv

from splatrl.device_faults import Faulty

AnyTransform: TypeAlias = Transform | Callable[[TensorDictBase], TensorDictBase]


def layers(env: EnvBase) -> tuple[EnvBase, list[TransformedEnv]]:
    """Return the base env, and the transformed envs around it, outermost first."""
    around = []
    while isinstance(env, TransformedEnv):
        around.append(env)
        env = env.base_env
    return env, around


def raise_faults(env: EnvBase) -> None:
    """Wait for the device, and raise the errors that renderer and checker recorded on it; see ``Faulty``."""
    base = layers(env)[0]
    if isinstance(base, Faulty):
        base.raise_faults()


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
    """Refuse an env under a transform that does not work with it; see ``check_transform``."""
    for around in layers(env)[1]:
        check_transform(around.base_env, around.transform)


def check_transform(env: EnvBase, transform: AnyTransform) -> None:
    """Refuse a transform that does not work around an env whose episodes travel in the TensorDict.

    Raises:
        ValueError: for TorchRL's frame skip, which repeats the step from the same state, or a transform that drops what
            the next step reads from the observations, so that TorchRL hands on the old values instead. What is dropped
            is not known while an ``ObservationNorm`` waits for statistics, which come from the env it is added to.
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
    elif isinstance(transform, Transform) and not _awaits_statistics(env, transform):
        around = TransformedEnv(env, transform.clone(), auto_unwrap=False)
        if dropped := _observed(env) & {*around.state_spec.keys(True, True)} - _observed(around):
            raise ValueError(
                f"{type(transform).__name__}: expected a transform that keeps what the next step reads, got one that "
                f"drops {', '.join(sorted(map(str, dropped)))} from the observations; select keys of collected batches "
                "instead"
            )


def _awaits_statistics(env: EnvBase, transform: Transform) -> bool:
    """Return whether a transform, or one within it, is an ``ObservationNorm`` before ``init_stats``, without specs."""
    transforms = [transform, *(around.transform for around in layers(env)[1])]
    modules = [one for each in transforms for one in each.modules()]
    return any(isinstance(one, ObservationNorm) and not one.initialized for one in modules)


def _observed(env: EnvBase) -> set[str | tuple[str, ...]]:
    return {*env.observation_spec.keys(True, True)}
