"""Transforms that draw random numbers, and draw the same ones again."""

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor
from torchrl.envs import EnvBase, Transform

from splatrl.envs.nesting import layers


class RandomTransform(Transform):
    """A transform with a seeded generator, whose state is part of ``state_dict()``.

    Over a ``SplatEnv`` it draws from that env's generator, so ``env.set_seed`` seeds both. Without an env, or over one
    that has no generator, such as a ``SerialEnv``, it draws from its own.

    Args:
        seed: of its own generator.
        out_keys: what it writes.
        in_keys: what it reads.
    """

    def __init__(self, seed: int = 0, out_keys: Sequence[str] = (), in_keys: Sequence[str] = ()):
        super().__init__(in_keys=list(in_keys), out_keys=list(out_keys))
        self._own = torch.Generator().manual_seed(seed)

    @property
    def env(self) -> EnvBase | None:
        """The env under all transforms, if there is one."""
        try:
            env = self.container
        except ValueError:
            return None  # it is held by something else, such as a replay buffer
        return None if env is None else layers(env)[0]

    @property
    def generator(self) -> torch.Generator:
        """What it draws from."""
        env = self.env
        shared = None if env is None else env.__dict__.get("generator", None)
        return shared if isinstance(shared, torch.Generator) else self._own

    def to(self, *args: Any, **kwargs: Any) -> "RandomTransform":
        """Move to a device, where its own generator begins anew."""
        device = torch.empty(0).to(*args, **kwargs).device
        if device != self._own.device:
            self._own = torch.Generator(device).manual_seed(self._own.initial_seed())
        return super().to(*args, **kwargs)

    def get_extra_state(self) -> Tensor:
        """State of the generator, for ``state_dict()``: [n] uint8."""
        return self.generator.get_state()

    def set_extra_state(self, state: Tensor) -> None:
        """Put the generator back, from ``load_state_dict()``."""
        self.generator.set_state(state.cpu())
