"""The GRU of a policy's memory, forwards and backwards through time in compiled C++."""

from typing import Any

import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from splatrl.native import _core
from splatrl.native.threads import usable_cores
from splatrl.native.tracing import traced
from splatrl.training.native_trunk import FAST, addresses

LANES = 16
"""Sizes of features and memory must be multiples of this number."""
LARGE = 128
"""Number of frames from which on threads save more time than starting them costs."""


def suits(features: Tensor, cell: nn.GRU) -> bool:
    """Whether the compiled GRU supports these features and weights, and is faster than PyTorch's.

    Args:
        features: [N, F].
        cell: a GRU with one layer.
    """
    if traced(features):
        return False
    plain = all(each.dtype == torch.float32 and each.device.type == "cpu" for each in (features, *_weights(cell)))
    return plain and features.shape[1] % LANES == 0 and cell.hidden_size % LANES == 0 and _core.isa() in FAST


def remembered(features: Tensor, begins: Tensor, states: Tensor, cell: nn.GRU) -> Tensor:
    """Return the state after each of N frames of S episodes: [N, M] float32.

    It is differentiable with respect to features and weights. All cores share the work; their number changes no byte,
    nor do other episodes change a byte of an episode's states.

    Args:
        features: [N, F], of the frames of one episode after another; see ``suits``.
        begins: [S] int64, the first frame of each episode, ascending from 0.
        states: [S, M] float32, the state before each episode's first frame, through which no gradient flows.
        cell: a GRU with one layer.
    """
    given = (each.contiguous() for each in (features, *_weights(cell)))
    return _Remembering.apply(begins.contiguous(), states.detach().contiguous(), *given)


class _Remembering(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, begins: Tensor, states: Tensor, features: Tensor, *weights: Tensor) -> Tensor:
        frames, memory = len(features), states.shape[1]
        hidden, kept = features.new_empty(frames, memory), features.new_empty(frames, 5 * memory)
        sizes = frames, len(begins), features.shape[1], memory
        known, made = addresses([begins, states]), addresses([hidden, kept])
        _core.gru_forward(sizes, known, features.data_ptr(), addresses(weights), made, _threads(frames))
        ctx.save_for_backward(begins, states, features, kept, *weights)
        return hidden

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, slope: Tensor) -> tuple[Tensor | None, ...]:
        begins, states, features, kept, *weights = ctx.saved_tensors
        gradients, by_features = [torch.empty_like(each) for each in weights], torch.empty_like(features)
        sizes = len(features), len(begins), features.shape[1], states.shape[1]
        given = addresses([begins, states]), features.data_ptr(), addresses(weights)
        slope = slope.contiguous()
        made, results = addresses([kept, slope]), addresses([*gradients, by_features])
        _core.gru_backward(sizes, *given, made, results, _threads(len(features)))
        return (None, None, by_features, *gradients)


def _weights(cell: nn.GRU) -> list[Tensor]:
    return [*cell.parameters()]


def _threads(frames: int) -> int:
    return usable_cores() if frames >= LARGE else 1
