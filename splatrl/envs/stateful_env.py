"""A transformed env whose state includes that of the base env."""

from collections import OrderedDict
from collections.abc import Mapping
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs import Compose, EnvBase, Transform, TransformedEnv

from splatrl.envs.nesting import AnyTransform, check_transform
from splatrl.envs.restart import StateWhenAsked, maybe_reset

BASE = "base_env."


class StatefulEnv(StateWhenAsked, TransformedEnv):
    """TorchRL's transformed env, whose ``state_dict()`` also holds the base env's generator and curriculum.

    ``TransformedEnv`` saves only the state of its transforms, so an env restored from it would continue differently.
    Here the state of the transforms includes everything, since TorchRL's collectors save only that.

    It is pickled as its base env and its transforms, with all their state.

    Args:
        base_env: a ``SplatEnv``.
        transforms: transforms around it, innermost first.

    Raises:
        ValueError: for a transform that does not work with the env, given here or added later; see ``check_transform``.
    """

    rand_action = EnvBase.rand_action  # around an env that overrides it, TorchRL refuses action transforms

    def __init__(self, base_env: EnvBase, *transforms: Transform):
        super().__init__(base_env, BaseAndTransforms())
        for transform in transforms:
            self.append_transform(transform)

    def append_transform(self, transform: AnyTransform) -> "StatefulEnv":
        """Add a transform outside the others; see ``TransformedEnv.append_transform``."""
        check_transform(self, transform)
        super().append_transform(transform)
        return self

    def insert_transform(self, index: int, transform: Transform) -> "StatefulEnv":
        """Add a transform between the others; see ``TransformedEnv.insert_transform``."""
        inner = [each.clone() for each in self.transform][:index]
        check_transform(StatefulEnv(self.base_env, *inner), transform)
        super().insert_transform(index, transform)
        return self

    def step(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Take a step; without transforms it is the base env's own, which avoids the copies that transforms need."""
        return super().step(tensordict) if len(self.transform) else self.base_env.step(tensordict)

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        after, stepping = super()._step(tensordict), tensordict.get("_step", None)
        if stepping is None:
            return after
        for key, new in after.items():  # transforms have changed robots that wait, too
            old = tensordict.get(key, None)
            if isinstance(old, Tensor) and (old.shape, old.dtype) == (new.shape, new.dtype):
                after[key] = torch.where(stepping.view(-1, *[1] * (new.ndim - 1)), new, old)
        return after

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: Any) -> TensorDictBase:
        if tensordict is not None and not kwargs.get("set_state"):
            tensordict = tensordict.select("_reset", strict=False)  # the rest is what the last episodes left
        return super()._reset(tensordict, **kwargs)

    def maybe_reset(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Reset robots whose episode has ended; see ``EnvBase.maybe_reset``."""
        return maybe_reset(self, tensordict)

    def load_state_dict(self, state_dict: Mapping[str, Any], **kwargs: Any) -> None:
        """Restore a ``state_dict()``."""
        self.reset()  # gives the buffers of frame-stacking transforms their sizes
        super().load_state_dict(OrderedDict(state_dict), **kwargs)

    def __reduce__(self) -> tuple[Any, ...]:
        return StatefulEnv, (self.base_env, *(transform.clone() for transform in self.transform))


class BaseAndTransforms(Compose):
    """Transforms whose state includes that of the env they wrap.

    Members of a plain ``Compose`` take its place, as they do when TorchRL appends one to another: TorchRL cannot find
    the env under a transform in a ``Compose`` within a ``Compose``.
    """

    def append(self, transform: AnyTransform) -> None:
        """Add a transform outside the others; see ``Compose.append``."""
        for each in _members(transform):
            super().append(each)

    def insert(self, index: int, transform: AnyTransform) -> None:
        """Add a transform between the others; see ``Compose.insert``."""
        place = index + len(self) if -len(self) <= index < 0 else index
        for number, each in enumerate(_members(transform)):
            super().insert(place + number, each)

    def _save_to_state_dict(self, destination: dict[str, Any], prefix: str, keep_vars: bool) -> None:
        super()._save_to_state_dict(destination, prefix, keep_vars)
        env = self.container
        if env is not None:
            env.base_env.state_dict(destination=destination, prefix=prefix + BASE, keep_vars=keep_vars)

    def _load_from_state_dict(
        self,
        state_dict: dict[str, Tensor],
        prefix: str,
        local_metadata: dict[str, Any],
        strict: bool,
        missing_keys: list[str],
        unexpected_keys: list[str],
        error_msgs: list[str],
    ) -> None:
        mine = prefix + BASE
        rest = {key: value for key, value in state_dict.items() if not key.startswith(mine)}
        super()._load_from_state_dict(rest, prefix, local_metadata, strict, missing_keys, unexpected_keys, error_msgs)
        env = self.container
        if env is not None:
            base = {key.removeprefix(mine): value for key, value in state_dict.items() if key.startswith(mine)}
            missing, unexpected = env.base_env.load_state_dict(base, strict=False)
            missing_keys += [mine + key for key in missing]  # PyTorch reports these only if its caller is strict
            unexpected_keys += [mine + key for key in unexpected]


def _members(transform: AnyTransform) -> list[AnyTransform]:
    """Return the transforms of a plain ``Compose``, and of those within it; any other transform as it is."""
    if isinstance(transform, Compose) and type(transform) is Compose:
        return [each for member in transform for each in _members(member)]
    return [transform]
