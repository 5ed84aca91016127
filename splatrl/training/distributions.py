"""Action distributions that never synchronise with the host, unlike PyTorch's and TorchRL's, which check their inputs.

From the same generator, they draw the same numbers as the originals.
"""

from typing import Any

import torch
from torch import Tensor
from torch.distributions import Categorical, Independent, Normal
from torchrl.modules import TanhNormal
from torchrl.modules.distributions.continuous import (
    FasterTransformedDistribution,
    SafeTanhTransform,
    _PatchedAffineTransform,
    _PatchedComposeTransform,
)


class Choice(Categorical):
    """A categorical distribution that avoids ``torch.multinomial``, which synchronises to check its probabilities.

    Args:
        logits: [..., N], unnormalised log probabilities of N actions.
    """

    def __init__(self, logits: Tensor):
        super().__init__(logits=logits, validate_args=False)

    @property
    def deterministic_sample(self) -> Tensor:
        """The most probable action, [...] int64."""
        return self.mode

    def sample(self, sample_shape: Any = torch.Size()) -> Tensor:  # noqa: B008, an empty size is a constant
        """Draw from each distribution, as the first arrival among exponential clocks: [...] int64."""
        if len(sample_shape):
            return super().sample(sample_shape)
        return (self.probs / torch.empty_like(self.probs).exponential_()).argmax(-1)


class Squashed(TanhNormal):
    """A normal distribution squashed to limits by a tanh; TorchRL's own synchronises five times.

    Args:
        loc: [..., D], mean before the tanh.
        scale: [..., D], standard deviation before the tanh, positive.
        low: [D], lowest action.
        high: [D], highest action.
    """

    def __init__(self, loc: Tensor, scale: Tensor, low: Tensor, high: Tensor):
        self.loc, self.scale, self.low, self.high, self.device = loc, scale, low, high, loc.device
        self.tanh_loc, self._event_dims = False, 1
        self.non_trivial_min = self.non_trivial_max = True
        affine = _PatchedAffineTransform(loc=(high + low) / 2, scale=(high - low) / 2)
        self._t = _PatchedComposeTransform([SafeTanhTransform(), affine])
        base = Independent(Normal(loc, scale, validate_args=False), 1, validate_args=False)
        FasterTransformedDistribution.__init__(self, base, self._t, validate_args=False)
