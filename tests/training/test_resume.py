"""A training that was stopped continues as if nothing had happened, whatever transforms its env has."""

from pathlib import Path

import pytest
import torch
from torchrl.envs import CatFrames, Compose, EnvBase, TransformedEnv

from splatrl.training import PPO, load_checkpoint, memory_transforms, save_checkpoint
from tests.tiny import tiny_env
from tests.training.test_ppo import assert_resumes, learner, parameters


def fresh(seed: int, stack: int, memory: int, nested: bool = False, robots: int = 4) -> PPO:
    """Make a learner on the tiny env, with a frame stack and a memory of the given sizes; 0 means none."""
    env: EnvBase = tiny_env([robots], seed=seed, max_steps=10, first=1, threshold=0.01, window=5)
    transforms = [*([CatFrames(stack, -1, in_keys=["pixels"])] if stack else []), *memory_transforms(memory)]
    if nested:
        for transform in transforms:
            env = TransformedEnv(env, transform, auto_unwrap=False)
    elif transforms:
        env = TransformedEnv(env, Compose(*transforms))
    return learner(env, seed, total_frames=64 * 8, memory=memory, anneal_lr=True, anneal_entropy=True)


@pytest.mark.parametrize(
    ("stack", "memory", "nested"),
    [
        pytest.param(0, 0, False, marks=pytest.mark.slow),
        pytest.param(3, 6, False, marks=pytest.mark.slow),
        (3, 6, True),
    ],
)
def test_a_resumed_training_is_byte_for_byte_the_same(tmp_path: Path, stack: int, memory: int, nested: bool) -> None:
    whole, resumed = (fresh(seed, stack, memory, nested) for seed in (0, 1))
    assert_resumes(whole, resumed, tmp_path / "last.pt")
    assert resumed.env.curriculum.level > 0
    rng = torch.get_rng_state()
    resumed_next = resumed.collect()
    torch.set_rng_state(rng)
    whole_next = whole.collect()
    assert set(resumed_next.keys(True, True)) == set(whole_next.keys(True, True))
    for key in whole_next.keys(True, True):
        assert torch.equal(resumed_next[key], whole_next[key]), key


@pytest.mark.parametrize("stack", [0, 3])
def test_a_checkpoint_holds_the_curriculums_progress_under_any_transforms(stack: int) -> None:
    ppo = fresh(0, stack, memory=6)
    ppo.iterate()
    state = ppo.state_dict()
    assert torch.equal(state["env"]["curriculum.progress"], ppo.env.curriculum.progress)
    assert (state["env"]["curriculum.progress"] > 0).any()


def test_a_training_that_has_not_begun_can_be_saved_and_resumed(tmp_path: Path) -> None:
    first = fresh(0, stack=3, memory=6)
    save_checkpoint(tmp_path / "last.pt", first.state_dict())
    other = fresh(1, stack=3, memory=6)
    other.load_state_dict(load_checkpoint(tmp_path / "last.pt"))
    expected = first.iterate()
    first_weights = parameters(first)
    other.load_state_dict(load_checkpoint(tmp_path / "last.pt"))
    assert str(other.iterate()) == str(expected)
    assert torch.equal(parameters(other), first_weights)


def test_a_training_keeps_its_number_of_robots(tmp_path: Path) -> None:
    save_checkpoint(tmp_path / "last.pt", fresh(0, stack=0, memory=6).state_dict())
    other = fresh(1, stack=0, memory=6, robots=8)
    weights = parameters(other)
    with pytest.raises(
        ValueError, match=r"env\.num_envs: expected 4, .* got 8; a training keeps its number of robots$"
    ):
        other.load_state_dict(load_checkpoint(tmp_path / "last.pt"))
    assert torch.equal(parameters(other), weights)
