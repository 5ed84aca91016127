"""Distributions of actions, for each kind of action spec."""

import math

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import Bounded, Categorical, OneHot, TensorSpec
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.modules import TanhNormal

from splatrl.training.heads import distribution, entropy, policy_head

LOW, HIGH = torch.tensor([-0.5, 0.0]), torch.tensor([1.5, 0.2])
DRIVE = Bounded(LOW, HIGH, shape=(2,))
HIDDEN = 7


def hidden(*batch: int) -> torch.Tensor:
    return torch.randn(*batch, HIDDEN, generator=torch.Generator().manual_seed(0))


@pytest.mark.parametrize("spec", [DRIVE, DRIVE.expand(3, 2), DRIVE.expand(4, 3, 2)])
def test_continuous_actions_fill_and_respect_the_limits_of_the_spec(spec: TensorSpec) -> None:
    torch.manual_seed(0)
    action = policy_head(spec, HIDDEN)(TensorDict({"hidden": hidden(5000)}, [5000]))["action"]
    assert action.shape == (5000, 2) and DRIVE.expand(5000, 2).is_in(action)
    part = (action - LOW) / (HIGH - LOW)
    assert (part.amin(0) < 0.1).all() and (part.amax(0) > 0.9).all()
    assert (part.mean(0) - 0.5).abs().max() < 0.05


def test_the_mode_of_continuous_actions_is_the_squashed_mean() -> None:
    torch.manual_seed(0)
    head = policy_head(DRIVE, HIDDEN)
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        td = head(TensorDict({"hidden": 100 * hidden(50)}, [50]))
    assert td["loc"].std() > 0.1
    torch.testing.assert_close(td["action"], LOW + (HIGH - LOW) * (1 + td["loc"].tanh()) / 2)


@pytest.mark.parametrize("spec", [DRIVE, Categorical(4)])
def test_the_distribution_of_the_learner_is_that_of_the_actor(spec: TensorSpec) -> None:
    torch.manual_seed(0)
    head = policy_head(spec, HIDDEN)
    td = head(TensorDict({"hidden": 100 * hidden(6, 5)}, [6, 5]))
    policy = distribution(head, td["hidden"])
    assert td["action_log_prob"].std() > 0.1
    torch.testing.assert_close(policy.log_prob(td["action"]), td["action_log_prob"])


def test_the_estimate_of_a_squashed_entropy_is_right_on_average() -> None:
    policy = TanhNormal(torch.full((100_000, 1), 0.3), torch.full((100_000, 1), 0.6), low=-1.0, high=3.0)
    action = torch.linspace(-1, 3, 20_001).view(-1, 1)[1:-1]
    log = TanhNormal(torch.full_like(action, 0.3), torch.full_like(action, 0.6), low=-1.0, high=3.0).log_prob(action)
    exact = -(log.exp() * log).sum().item() * 4 / 20_000
    torch.manual_seed(0)
    assert entropy(policy).mean().item() == pytest.approx(exact, abs=0.01)


def test_an_entropy_bonus_widens_a_narrow_policy() -> None:
    torch.manual_seed(0)
    head = policy_head(DRIVE, HIDDEN)
    linear = head.module[0].module[0]
    linear.bias.data[2:] = -3.0
    entropy(distribution(head, hidden(256))).mean().backward()
    assert (linear.bias.grad[2:] > 0.5).all()


def test_the_entropy_of_a_choice_is_exact() -> None:
    torch.manual_seed(0)
    found = entropy(distribution(policy_head(Categorical(4), HIDDEN), hidden(9)))
    torch.testing.assert_close(found, torch.full((9,), math.log(4)), atol=1e-3, rtol=0)


@pytest.mark.parametrize("spec", [OneHot(4), Bounded(0, 3, shape=(2,), dtype=torch.int64)])
def test_an_unsupported_action_spec_is_refused(spec: TensorSpec) -> None:
    with pytest.raises(ValueError, match="action_spec: expected a Categorical spec or a Bounded spec of floats, got "):
        policy_head(spec, HIDDEN)
