"""An env under transforms is restored whole, also by TorchRL's own collector."""

from pathlib import Path

import pytest
import torch
from tensordict.nn import TensorDictModule
from torchrl.collectors import Collector

from splatrl.build import make_env
from splatrl.envs.stateful_env import StatefulEnv
from tests.tiny import tiny_overrides


class FirstAction(torch.nn.Module):
    """Takes action 0."""

    def forward(self, step_count: torch.Tensor) -> torch.Tensor:
        return torch.zeros_like(step_count[..., 0])


def shaky(folder: Path) -> StatefulEnv:
    env = make_env([*tiny_overrides(folder), "transforms/pose_noise=uniform", "memory=stack"], batch_size=[3])
    assert isinstance(env, StatefulEnv)
    return env


def test_a_restored_env_goes_on_as_the_other_one(tmp_path: Path) -> None:
    env, other = shaky(tmp_path), shaky(tmp_path)
    torch.manual_seed(0)
    env.rollout(7, break_when_any_done=False)
    other.load_state_dict(env.state_dict())
    assert {"base_env.curriculum.progress", "base_env._extra_state"} <= env.state_dict().keys()
    rollouts = []
    for one in (env, other):
        torch.manual_seed(1)
        rollouts.append(one.rollout(9, break_when_any_done=False)["next", "pixels"])
    assert torch.equal(*rollouts)
    assert not torch.equal(rollouts[0], shaky(tmp_path).rollout(9, break_when_any_done=False)["next", "pixels"])


def test_a_collector_restores_the_transforms(tmp_path: Path) -> None:
    envs = [shaky(tmp_path) for _ in range(2)]
    policy = TensorDictModule(FirstAction(), in_keys=["step_count"], out_keys=["action"])
    collectors = [Collector(env, policy, frames_per_batch=12, total_frames=48) for env in envs]
    next(iter(collectors[0]))
    collectors[1].load_state_dict(collectors[0].state_dict())
    states = [collector.env.transform.state_dict() for collector in collectors]  # TorchRL keeps no other
    assert states[0] and states[0].keys() == states[1].keys()
    assert all(torch.equal(value, states[1][key]) for key, value in states[0].items())


@pytest.mark.parametrize("size", [[2, 4], [], [0], [-1]])
def test_a_shape_that_cannot_be_kept_is_refused(size: list[int], tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"batch_size: expected one number of at least 1, or None, got"):
        make_env(tiny_overrides(tmp_path), batch_size=size)
