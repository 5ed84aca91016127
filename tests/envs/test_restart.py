"""Automatic resets are those of TorchRL."""

import pytest
import torch
from torchrl.envs import EnvBase
from torchrl.envs.utils import step_mdp

from tests.envs.test_device import WORLDS, made, whole_overlay

__all__ = ["whole_overlay"]


@pytest.mark.usefixtures("whole_overlay")
@pytest.mark.parametrize("name", WORLDS)
def test_rows_that_are_done_begin_as_in_torchrl_and_the_others_go_on(name: str) -> None:
    ends = []
    for reset in (lambda env, td: env.maybe_reset(td), EnvBase.maybe_reset):
        env, seen = made(name, 7), []
        torch.manual_seed(2)
        td = env.reset()
        for _ in range(8):
            after = step_mdp(env.step(env.rand_action(td)))
            kept = after.clone()
            td = reset(env, after)
            seen.append((kept, td.clone()))
            assert reset is EnvBase.maybe_reset or torch.equal(after["pixels"], kept["pixels"])  # history stays
        ends.append(seen)
    ended = 0
    for (kept, mine), (_, theirs) in zip(*ends, strict=True):
        assert set(mine.keys(True)) == set(theirs.keys(True))
        for key in theirs.keys(True, True):
            assert torch.equal(mine[key], theirs[key]), key
        done = kept["done"].squeeze(1)
        ended += int(done.sum())
        assert torch.equal(mine["state"][~done], kept["state"][~done])
    assert ended > 0  # else this shows nothing
