"""Distributions that never synchronise give the same samples and values as PyTorch's and TorchRL's."""

import pytest
import torch
from torch.distributions import Categorical
from torchrl.modules import TanhNormal

from splatrl.training.distributions import Choice, Squashed
from tests.envs.devices import HostReadError, NoHostReads

LOW, HIGH = torch.tensor([-0.25, -1.5]), torch.tensor([0.5, 1.5])


@pytest.mark.parametrize("shape", [(7, 6), (1, 4), (3, 5, 2)])
@pytest.mark.parametrize("sample_shape", [(), (4,)])
def test_a_choice_equals_pytorchs_and_leaves_the_generator_in_the_same_state(
    shape: tuple[int, ...], sample_shape: tuple[int, ...]
) -> None:
    logits = 3 * torch.randn(shape, generator=torch.Generator().manual_seed(0))
    drawn = []
    for kind in (Choice(logits), Categorical(logits=logits, validate_args=False)):
        torch.manual_seed(5)
        drawn.append((kind.sample(sample_shape), torch.rand(2)))
    assert torch.equal(drawn[0][0], drawn[1][0]) and torch.equal(drawn[0][1], drawn[1][1])


def test_choices_are_drawn_with_their_probabilities() -> None:
    torch.manual_seed(0)
    counts = Choice(torch.tensor([0.1, 0.2, 0.7]).log().expand(20000, 3)).sample().bincount(minlength=3)
    torch.testing.assert_close(counts / 20000, torch.tensor([0.1, 0.2, 0.7]), atol=0.01, rtol=0)


def test_squashed_actions_equal_torchrls_byte_for_byte() -> None:
    g = torch.Generator().manual_seed(1)
    loc, scale = torch.randn(9, 2, generator=g), torch.rand(9, 2, generator=g) + 0.1
    ours, theirs = Squashed(loc, scale, LOW, HIGH), TanhNormal(loc, scale, low=LOW, high=HIGH)
    said = []
    for kind in (ours, theirs):
        torch.manual_seed(2)
        action = kind.rsample()
        said.append([action, kind.log_prob(action), *kind.rsample_and_log_prob(), kind.deterministic_sample])
    assert all(torch.equal(own, other) for own, other in zip(*said, strict=True))
    assert ((said[0][0] > LOW) & (said[0][0] < HIGH)).all()


def test_these_distributions_never_read_on_the_host_and_the_originals_do() -> None:
    logits, loc, scale = torch.randn(5, 4), torch.randn(5, 2), torch.rand(5, 2) + 0.1
    with NoHostReads():
        choice, squashed = Choice(logits), Squashed(loc, scale, LOW, HIGH)
        for kind in (choice, squashed):
            action = kind.rsample() if kind.has_rsample else kind.sample()
            kind.log_prob(action)
        choice.entropy(), squashed.rsample_and_log_prob()
    with pytest.raises(HostReadError), NoHostReads():
        Categorical(logits=logits, validate_args=False).sample()
    with pytest.raises(HostReadError), NoHostReads():
        TanhNormal(loc, scale, low=LOW, high=HIGH)
