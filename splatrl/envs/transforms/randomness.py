"""Base class of transforms that draw reproducible random numbers."""

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor
from torchrl.envs import EnvBase, ParallelEnv, SerialEnv, Transform

from splatrl.envs.nesting import layers
from splatrl.values import checked_seed


class RandomTransform(Transform):
    """A transform with a seeded generator, whose state is part of ``state_dict()``.

    Around a ``SplatEnv`` it draws from the env's generator, so ``env.set_seed`` seeds both. Without an env it draws
    from its own. It does not work around a ``SerialEnv`` or ``ParallelEnv``, whose ``set_seed`` would not reach it: put
    it around each worker's env instead.

    Attributes:
        remembered: keys with which, given to a reset, an episode can be repeated; demonstrations store them.

    Args:
        seed: seed of the transform's own generator.
        out_keys: keys that the transform writes.
        in_keys: keys that the transform reads.
    """

    remembered: Sequence[str] = ()

    def __init__(self, seed: int = 0, out_keys: Sequence[str] = (), in_keys: Sequence[str] = ()):
        super().__init__(in_keys=list(in_keys), out_keys=list(out_keys))
        self._own = torch.Generator().manual_seed(checked_seed(seed))

    @property
    def env(self) -> EnvBase | None:
        """The base env beneath all transforms; None if there is none."""
        try:
            env = self.container
        except ValueError:
            return None  # not held by an env but, for example, by a replay buffer
        return None if env is None else layers(env)[0]

    @property
    def generator(self) -> torch.Generator:
        """The generator from which the transform draws; a ValueError around the envs of workers."""
        env = self.env
        if isinstance(env, (SerialEnv, ParallelEnv)):
            name, around = type(self).__name__, type(env).__name__
            raise ValueError(
                f"{name}: expected the env that renders, got a {around}, whose set_seed does not reach transforms "
                f"around it; put {name} around the env of each worker"
            )
        shared = None if env is None else env.__dict__.get("generator", None)
        return shared if isinstance(shared, torch.Generator) else self._own

    def to(self, *args: Any, **kwargs: Any) -> "RandomTransform":
        """Move to a device; on a new one, the transform's own generator restarts from its seed."""
        device = torch.empty(0).to(*args, **kwargs).device
        if device != self._own.device:
            self._own = torch.Generator(device).manual_seed(self._own.initial_seed())
        return super().to(*args, **kwargs)

    def get_extra_state(self) -> Tensor:
        """Return the state of the generator, for ``state_dict()``: [n] uint8."""
        return self.generator.get_state()

    def set_extra_state(self, state: Tensor) -> None:
        """Restore the generator, from ``load_state_dict()``."""
        self.generator.set_state(state.cpu())
