"""Policies with memory: when it is reset, how it is trained, and that policies learn to use it."""

import pytest
import torch
from tensordict import TensorDictBase
from torchrl.envs import CatFrames, Compose, EnvBase, Transform, TransformedEnv
from torchrl.objectives.value.functional import generalized_advantage_estimate

from splatrl.envs.transforms import FrameSkip, FrameStack, Latency
from splatrl.evaluation.rollouts import run_episodes
from splatrl.training import PPO, memory_transforms
from splatrl.training.memory import STATE, gru
from tests.tiny import tiny_env, tiny_plan
from tests.training.test_ppo import LOSS, learner
from tests.training.toys import Recall

MEMORY = 6


def remembering(env: EnvBase, memory: int = MEMORY) -> TransformedEnv:
    return TransformedEnv(env, Compose(*memory_transforms(memory)))


@pytest.fixture
def ppo() -> PPO:
    """PPO with several short episodes in a batch, and with a memory whose values are not small."""
    ppo = learner(remembering(tiny_env([6], max_steps=4)), frames_per_batch=6 * 13, memory=MEMORY)
    for parameter in ppo.model.parameters():
        parameter.data += 0.2 * torch.randn_like(parameter)
    ppo.collect()
    return ppo


def test_memory_is_zero_where_an_episode_begins_and_carried_over_elsewhere(ppo: PPO) -> None:
    batch = ppo.collect()
    begins = batch["step_count"].squeeze(-1) == 0
    assert torch.equal(batch["is_init"].squeeze(-1), begins)
    assert (batch[STATE][begins] == 0).all()
    goes_on = ~begins[:, 1:]
    assert torch.equal(batch[STATE][:, 1:][goes_on], batch["next", STATE][:, :-1][goes_on])
    assert (batch["next", STATE].abs() > 0.01).any(-1).all()
    assert not begins[:, 0].all()  # some go on from the batch before


def test_learning_recomputes_the_hidden_states_of_collection(ppo: PPO) -> None:
    batch = ppo.collect()
    assert batch["is_init"][:, 1:].any(1).all()
    seen = {key: batch[key] for key in ("image", STATE, "is_init")}
    torch.testing.assert_close(ppo.learner._hidden(seen), batch["next", STATE].squeeze(-2), atol=1e-5, rtol=1e-5)
    forgot = {**seen, STATE: torch.zeros_like(seen[STATE])}
    assert not torch.allclose(ppo.learner._hidden(forgot), batch["next", STATE].squeeze(-2), atol=1e-2)


@pytest.mark.parametrize("transform", [FrameSkip(2), Latency((1, 3)), FrameStack(2)], ids=str)
def test_memory_is_carried_through_the_transforms_of_an_env(transform: Transform) -> None:
    env = TransformedEnv(tiny_env([6], max_steps=9), Compose(transform, *memory_transforms(MEMORY)))
    ppo = learner(env, frames_per_batch=6 * 13, memory=MEMORY)
    for parameter in ppo.model.parameters():
        parameter.data += 0.2 * torch.randn_like(parameter)
    ppo.collect()
    batch = ppo.collect()
    goes_on = ~batch["is_init"][:, 1:].squeeze(-1)
    assert 0 < goes_on.sum() < goes_on.numel()
    assert (batch["next", STATE].abs() > 0.01).any(-1).all()
    assert torch.equal(batch[STATE][:, 1:][goes_on], batch["next", STATE][:, :-1][goes_on])
    seen = {key: batch[key] for key in ("image", STATE, "is_init")}
    torch.testing.assert_close(ppo.learner._hidden(seen), batch["next", STATE].squeeze(-2), atol=1e-5, rtol=1e-5)


def test_gradients_reach_earlier_images_through_the_memory(ppo: PPO) -> None:
    batch = ppo.collect()
    image = batch["image"].clone().requires_grad_()
    hidden = ppo.learner._hidden({"image": image, STATE: batch[STATE], "is_init": batch["is_init"]})
    row, column = next((r, c) for r in range(6) for c in range(2, 13) if batch["step_count"][r, c] == 2)
    hidden[row, column].sum().backward()
    reached = image.grad[row].flatten(1).abs().amax(1) > 0
    assert reached.tolist() == [column - 2 <= c <= column for c in range(13)]


def test_minibatches_are_whole_rows_and_hold_every_frame_once(ppo: PPO) -> None:
    batch = ppo.collect()
    batch["advantage"], batch["value_target"] = ppo.learner.advantages(batch)
    parts = list(ppo.learner.minibatches(batch))
    assert [part["action"].shape for part in parts] == [(2, 13)] * 3  # 32 frames hold two rows of 13
    assert sorted(torch.cat([p["advantage"] for p in parts]).tolist()) == sorted(
        batch["advantage"].squeeze(-1).tolist()
    )


def successor_values(ppo: PPO, batch: TensorDictBase) -> torch.Tensor:
    """Return the critic's value of every next observation, each with the memory after the step."""
    with torch.no_grad():
        return ppo.model.get_value_operator()(batch["next"].select("pixels", STATE, "is_init"))["state_value"]


def test_advantages_value_the_next_observation_with_the_memory_after_the_step(ppo: PPO) -> None:
    batch = ppo.collect()
    after = batch["next"]
    assert after["truncated"][:, :-1].any() and after["terminated"].any() and not after["done"][:, -1].all()
    advantage, target = ppo.learner.advantages(batch)
    expected = generalized_advantage_estimate(
        LOSS.gamma,
        LOSS.gae_lambda,
        batch["state_value"],
        successor_values(ppo, batch),
        after["reward"] * LOSS.reward_scale,
        after["done"],
        after["terminated"],
    )
    torch.testing.assert_close(advantage, expected[0], atol=1e-5, rtol=1e-5)
    torch.testing.assert_close(target, expected[1], atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize("stack", [0, 3])
def test_evaluated_episodes_remember_nothing_of_earlier_ones(stack: int) -> None:
    def env(robots: int) -> EnvBase:
        frames = [CatFrames(stack, -1, in_keys=["pixels"])] if stack else []
        return TransformedEnv(tiny_env([robots], max_steps=6), Compose(*frames, *memory_transforms(MEMORY)))

    ppo = learner(env(2), memory=MEMORY)
    for parameter in ppo.model.parameters():
        parameter.data += 0.3 * torch.randn_like(parameter)
    starts = tiny_plan().states[tiny_plan().start_rows][::9]
    policy = ppo.model.get_policy_operator()
    few, many = (run_episodes(env(robots), policy, starts, sampled=False) for robots in (3, len(starts)))
    assert few.length.unique().numel() > 1  # else this shows too little
    assert torch.equal(few.length, many.length) and torch.equal(few.outcome, many.outcome)


def test_the_memory_transforms_match_those_that_the_module_asks_for() -> None:
    tracker, primer = memory_transforms(MEMORY)
    theirs = gru(5, MEMORY).make_tensordict_primer()
    assert primer.primers == theirs.primers and primer.default_value.keys() == theirs.default_value.keys()
    assert tracker.init_key == "is_init"
    assert memory_transforms(0) == []


@pytest.mark.slow
def test_a_policy_learns_to_recall_with_memory_and_cannot_without() -> None:
    change = {"mini_batch_size": 128, "ppo_epochs": 6, "reward_scale": 1.0, "entropy_coeff": 0.0, "lr": 3e-3}
    success = {}
    for memory in (0, 16):
        env = remembering(Recall(32), memory) if memory else Recall(32)
        ppo = learner(env, frames_per_batch=512, memory=memory, **change)
        success[memory] = [ppo.iterate()["success"] for _ in range(10)][-2:]
    assert max(success[0]) < 0.62  # chance; other seeds: up to 0.59
    assert min(success[16]) > 0.8  # other seeds: 0.88 to 0.99
