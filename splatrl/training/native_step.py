"""A whole gradient step in C++, which saves small networks the overhead between PyTorch's operations."""

from collections.abc import Mapping

import torch
from tensordict.nn import ProbabilisticTensorDictSequential
from torch import Tensor, nn

from splatrl.native import _core
from splatrl.training.distributions import Choice
from splatrl.training.loss import STATISTICS
from splatrl.training.native_trunk import addresses, backward, forward, suits
from splatrl.training.settings import LossSettings
from splatrl.training.trunk import Trunk


class NativeStep:
    """The gradient step of ``Learner`` for a policy that reads images and chooses among discrete actions.

    Loss, gradients, clipping and Adam equal PyTorch's up to rounding, as tests verify. Adam's state is PyTorch's own,
    so checkpoints are the same.

    Args:
        trunk: trunk that reads images.
        policy: policy head with one linear layer.
        value: value head, a linear layer.
        max_grad_norm: norm to which gradients are clipped.
    """

    def __init__(
        self,
        trunk: Trunk,
        policy: ProbabilisticTensorDictSequential,
        value: nn.Linear,
        max_grad_norm: float,
    ):
        self.trunk, self.max_grad_norm = trunk, max_grad_norm
        head = policy.module[0].module
        self.heads = [head.weight, head.bias, value.weight, value.bias]

    def suits(self, frames: Mapping[str, Tensor], optimizer: torch.optim.Optimizer) -> bool:
        """Whether these frames are supported, and a step on them is faster than PyTorch's.

        Args:
            frames: a minibatch, see ``step``.
            optimizer: optimizer of the network's parameters.
        """
        images = frames["image"]
        plain = images.ndim == 4 and all(each.dtype == torch.float32 and each.is_contiguous() for each in self.heads)
        return (
            plain and type(optimizer) is torch.optim.Adam and suits(images, self.trunk.convolutions, self.trunk.dense)
        )

    def step(
        self,
        frames: Mapping[str, Tensor],
        optimizer: torch.optim.Optimizer,
        loss: LossSettings,
        entropy_coeff: float,
    ) -> Tensor:
        """Take a step on a minibatch, as ``Learner.step`` does.

        Args:
            frames: N frames: ``image`` [M, H, W, C] float32 on the CPU; ``action`` [N] int64; ``action_log_prob``,
                ``advantage`` and ``value_target``, [N] float32 each. With ``shown`` [N] int64, the index of each
                frame's image, images may serve several frames; without it, M = N.
            optimizer: Adam, with one group of parameters.
            loss: clip range and weight of the value loss.
            entropy_coeff: weight of the entropy bonus.

        Returns:
            ``STATISTICS``, [5] float32.
        """
        images, shown = frames["image"].contiguous(), frames.get("shown")
        weights = [*self.trunk.convolutions.parameters(), *self.trunk.dense.parameters()]
        layers = forward(images, weights)
        hidden = layers[-1] if shown is None else layers[-1].index_select(0, shown)
        keys = ("action", "action_log_prob", "advantage", "value_target")
        given = [hidden, *(frames[key].contiguous() for key in keys)]
        head_gradients, slope = [torch.empty_like(each) for each in self.heads], torch.empty_like(hidden)
        statistics = torch.empty(len(STATISTICS))
        _core.policy_loss(
            addresses(given),
            (*hidden.shape, len(self.heads[0])),
            addresses(self.heads),
            loss.clip_epsilon,
            loss.critic_coeff,
            entropy_coeff,
            addresses([*head_gradients, slope]),
            statistics.data_ptr(),
        )
        if shown is not None:
            slope = torch.zeros_like(layers[-1]).index_add_(0, shown, slope)
        self._descend([*weights, *self.heads], [*backward(images, weights, layers, slope), *head_gradients], optimizer)
        return statistics

    def _descend(self, values: list[Tensor], gradients: list[Tensor], optimizer: torch.optim.Optimizer) -> None:
        """Clip the gradients and take a step of Adam."""
        (group,) = optimizer.param_groups
        tensors, step = [], 0.0
        for value, gradient in zip(values, gradients, strict=True):
            state = optimizer.state[value]
            if not state:
                state["step"] = torch.zeros(())
                state["exp_avg"], state["exp_avg_sq"] = torch.zeros_like(value), torch.zeros_like(value)
            state["step"] += 1
            step = step or state["step"].item()
            tensors.append(addresses([value, gradient, state["exp_avg"], state["exp_avg_sq"]]))
        counts = [value.numel() for value in values]
        beta1, beta2 = group["betas"]
        _core.adam(tensors, counts, step, group["lr"], beta1, beta2, group["eps"], self.max_grad_norm)


def native_step(
    trunk: nn.Module, policy: ProbabilisticTensorDictSequential, value: nn.Module, max_grad_norm: float
) -> NativeStep | None:
    """Return the compiled gradient step of a network, or None if it has parts that are not supported."""
    layer, sampler = policy.module
    if not isinstance(trunk, Trunk) or not isinstance(value, nn.Linear) or not isinstance(layer.module, nn.Linear):
        return None
    if sampler.distribution_class is not Choice:
        return None
    return NativeStep(trunk, policy, value, max_grad_norm)
