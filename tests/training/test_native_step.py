"""The compiled gradient step against PyTorch's."""

import copy
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from splatrl.native import _core
from splatrl.training import actor_critic
from splatrl.training.learner import Learner
from splatrl.training.native_trunk import FAST
from tests.tiny import tiny_env
from tests.training.test_ppo import LOSS, OPTIM

ACTIONS = 6
SHOWN = torch.arange(48) % 31
"""Which of 31 images each of 48 frames shows."""


def pair(norm: float = 0.5, clip: float = 0.2) -> list[Learner]:
    """Make two learners with the same weights; the first uses the compiled step and the second PyTorch's."""
    torch.manual_seed(0)
    env = tiny_env([2])
    model = actor_critic((16, 16, 3), env.action_spec, 1, (16, 32), 40)
    for parameter in model.parameters():
        parameter.data += 0.05 * torch.randn_like(parameter)
    loss, optim = replace(LOSS, clip_epsilon=clip), replace(OPTIM, lr=1e-2, max_grad_norm=norm)
    learners = [Learner(copy.deepcopy(model), loss, optim) for _ in range(2)]
    assert learners[0]._native is not None
    learners[1]._native = None
    return learners


def minibatch(seed: int, repeats: bool) -> dict[str, Tensor]:
    """Make frames, some of which have a ratio beyond the clip range."""
    generator = torch.Generator().manual_seed(seed)
    count = len(SHOWN)
    frames = {
        "image": torch.rand(31 if repeats else count, 16, 16, 3, generator=generator) - 0.5,
        "action": torch.randint(ACTIONS, (count,), generator=generator),
        "action_log_prob": -1.8 + 0.5 * torch.randn(count, generator=generator),
        "advantage": 3 * torch.randn(count, generator=generator) + 1,
        "value_target": 2 * torch.randn(count, generator=generator),
    }
    return frames | ({"shown": SHOWN} if repeats else {})


def weights(learner: Learner) -> Tensor:
    return torch.cat([each.detach().flatten() for each in learner.parameters])


@pytest.mark.parametrize("repeats", [False, True])
@pytest.mark.parametrize(("norm", "clip"), [(0.5, 0.2), (1e9, 0.2), (1e9, 1e-3)])
def test_steps_and_statistics_match_pytorchs(norm: float, clip: float, repeats: bool) -> None:
    mine, theirs = pair(norm, clip)
    begun = weights(mine)
    for step in range(5):
        frames = minibatch(step, repeats)
        found, expected = mine.step(frames), theirs.step(frames)
        torch.testing.assert_close(found, expected, atol=2e-5, rtol=2e-5)
        assert expected[4] > 0  # else nothing is clipped
    moved = weights(theirs) - begun
    assert moved.abs().max() > 1e-2
    assert (weights(mine) - weights(theirs)).abs().quantile(0.999) < 1e-5  # Adam divides by gradients that may be tiny
    states = [[*learner.optimizer.state_dict()["state"].values()] for learner in (mine, theirs)]
    for own, other in zip(*states, strict=True):
        assert own["step"] == other["step"] == 5
        torch.testing.assert_close(own["exp_avg"], other["exp_avg"], atol=1e-6, rtol=1e-3)
        torch.testing.assert_close(own["exp_avg_sq"], other["exp_avg_sq"], atol=1e-9, rtol=1e-3)


@pytest.mark.parametrize("isa", [isa for isa in _core.supported_isas() if isa in FAST])
def test_every_instruction_set_agrees(isa: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SPLATRL_ISA", isa)
    test_steps_and_statistics_match_pytorchs(0.5, 0.2, True)


def test_the_compiled_step_continues_an_optimiser_state_from_pytorch() -> None:
    mine, theirs = pair()
    for step in range(2):
        theirs.step(minibatch(step, False))
    mine.model.load_state_dict(theirs.model.state_dict())
    mine.optimizer.load_state_dict(copy.deepcopy(theirs.optimizer.state_dict()))
    frames = minibatch(2, False)
    mine.step(frames)
    theirs.step(frames)
    assert (weights(mine) - weights(theirs)).abs().quantile(0.999) < 1e-5


@pytest.mark.parametrize("isa", [isa for isa in _core.supported_isas() if isa in FAST])
def test_an_action_out_of_range_is_refused(isa: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SPLATRL_ISA", isa)
    mine, _ = pair()
    frames = minibatch(0, False)
    frames["action"][3] = ACTIONS
    with pytest.raises(ValueError, match="action"):
        mine.step(frames)


def test_an_empty_minibatch_is_refused() -> None:
    with pytest.raises(ValueError, match="sizes"):
        _core.policy_loss((0,) * 5, (0, 1, 1), (0,) * 4, 0.2, 0.5, 0.0, (0,) * 5, 0)
