"""The clipped loss of proximal policy optimisation (Schulman et al. 2017, eq. 9), on plain tensors."""

from collections.abc import Mapping

import torch
from torch import Tensor
from torch.distributions import Distribution
from torch.nn.functional import smooth_l1_loss

from splatrl.training.heads import entropy
from splatrl.training.settings import LossSettings

STATISTICS = ("loss_objective", "loss_critic", "entropy", "kl_approx", "clip_fraction")
"""Names of the statistics that ``clipped_loss`` returns, as in TorchRL's ``ClipPPOLoss``."""


def clipped_loss(
    policy: Distribution,
    value: Tensor,
    frames: Mapping[str, Tensor],
    settings: LossSettings,
    entropy_coeff: float | Tensor,
) -> tuple[Tensor, Tensor]:
    """Return the loss of a minibatch: value and gradient of TorchRL's ``ClipPPOLoss``, in a fraction of the time.

    Args:
        policy: distribution of actions in each frame, [...].
        value: the critic's value of each frame, [...] float32.
        frames: ``action``, ``action_log_prob``, ``advantage`` and ``value_target``, [...] each.
        settings: clip range and weight of the value loss.
        entropy_coeff: current weight of the entropy bonus.

    Returns:
        The loss, [] float32, and ``STATISTICS``, [5] float32 without gradient.
    """
    advantage = frames["advantage"]
    if advantage.numel() > 1:
        advantage = (advantage - advantage.mean()) / advantage.std().clamp_min(1e-6)
    log_ratio = policy.log_prob(frames["action"]) - frames["action_log_prob"]
    ratio = log_ratio.exp()
    clipped = ratio.clamp(1 - settings.clip_epsilon, 1 + settings.clip_epsilon)
    objective = -torch.minimum(ratio * advantage, clipped * advantage).mean()
    critic = settings.critic_coeff * smooth_l1_loss(value, frames["value_target"])
    spread = entropy(policy).mean()
    with torch.no_grad():
        statistics = torch.stack([objective, critic, spread, -log_ratio.mean(), (clipped != ratio).float().mean()])
    return objective + critic - entropy_coeff * spread, statistics
