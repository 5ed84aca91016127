"""The loss in plain tensors against TorchRL's."""

from dataclasses import replace

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import Bounded, Categorical, TensorSpec
from torchrl.modules import ValueOperator
from torchrl.objectives import ClipPPOLoss

from splatrl.training.heads import distribution, policy_head
from splatrl.training.loss import STATISTICS, clipped_loss
from tests.training.test_ppo import LOSS

HIDDEN = 6


def frames(count: int, head: torch.nn.Module) -> TensorDict:
    """Make frames whose actions were drawn by a somewhat different policy, so that many ratios are clipped."""
    td = TensorDict({"hidden": torch.randn(count, HIDDEN)}, [count])
    with torch.no_grad():
        head(td)
    td["action_log_prob"] += 0.3 * torch.randn(count)
    td["advantage"], td["value_target"] = torch.randn(2, count, 1)
    return td


@pytest.mark.parametrize("count", [1, 40])
@pytest.mark.parametrize("spec", [Categorical(5), Bounded(-1.0, 2.0, shape=(2,))])
@pytest.mark.filterwarnings("ignore:.*entropy")
def test_loss_gradient_and_statistics_match_torchrls(spec: TensorSpec, count: int) -> None:
    torch.manual_seed(0)
    settings = replace(LOSS, entropy_coeff=0.3)
    head, value = policy_head(spec, HIDDEN), torch.nn.Linear(HIDDEN, 1)
    for parameter in head.parameters():
        parameter.data += 0.3 * torch.randn_like(parameter)
    td = frames(count, head)
    weights = [*head.parameters(), *value.parameters()]
    objective = ClipPPOLoss(
        head,
        ValueOperator(value, in_keys=["hidden"]),
        clip_epsilon=settings.clip_epsilon,
        entropy_coeff=settings.entropy_coeff,
        critic_coeff=settings.critic_coeff,
        normalize_advantage=True,
    )
    torch.manual_seed(1)
    theirs = objective(td.clone())
    total = theirs["loss_objective"] + theirs["loss_critic"] + theirs["loss_entropy"]
    expected = torch.autograd.grad(total, weights)
    torch.manual_seed(1)  # for the sample that an entropy without a closed form takes
    known = {
        **td.select("action", "action_log_prob"),
        **{key: td[key].squeeze(-1) for key in ("advantage", "value_target")},
    }
    policy, found = distribution(head, td["hidden"]), value(td["hidden"]).squeeze(-1)
    loss, statistics = clipped_loss(policy, found, known, settings, settings.entropy_coeff)
    torch.testing.assert_close(loss, total)
    torch.testing.assert_close(torch.autograd.grad(loss, weights), expected, atol=1e-6, rtol=1e-4)
    assert max(gradient.abs().max() for gradient in expected) > 1e-2
    torch.testing.assert_close(statistics, torch.stack([theirs[key].detach().squeeze() for key in STATISTICS]))
    if count > 1:
        assert 0.2 < theirs["clip_fraction"] < 0.8  # else this shows too little
