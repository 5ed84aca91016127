"""Finitely many states that are counted by indices: what the motions on a lattice share."""

from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torchrl.data import Bounded, Categorical


class Indices(nn.Module):
    """States are [..., D] int64 indices, from 0 to below ``shape``; an action adds one of ``moves``.

    Args:
        shape: how many values each index has.
        moves: [A][D], what each action adds.
    """

    moves: Tensor  # [A, D] int64

    def __init__(self, shape: Sequence[int], moves: Sequence[Sequence[int]]):
        super().__init__()
        self.shape = tuple(shape)
        self.register_buffer("moves", torch.tensor(moves, dtype=torch.int64), persistent=False)

    @property
    def action_spec(self) -> Categorical:
        """One of the moves; no batch."""
        return Categorical(len(self.moves), shape=(), dtype=torch.int64)

    @property
    def state_spec(self) -> Bounded:
        """Indices [D]; no batch."""
        high = torch.tensor(self.shape) - 1
        return Bounded(low=torch.zeros_like(high), high=high, shape=high.shape, dtype=torch.int64)

    def states(self) -> Tensor:
        """Every state, in the order of ``index``: [S, D] int64."""
        return torch.cartesian_prod(*(torch.arange(n, device=self.moves.device) for n in self.shape))

    def index(self, state: Tensor) -> Tensor:
        """The row of each state in ``states()``: [..., D] int64, inside the lattice -> [...] int64."""
        row = state[..., 0]
        for axis, count in enumerate(self.shape[1:], 1):
            row = row * count + state[..., axis]
        return row
