"""PPO: its gradient, its advantages, and that it learns."""

import copy
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from tensordict import TensorDictBase
from tensordict.nn import ProbabilisticTensorDictSequential
from torchrl.envs import EnvBase
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

import splatrl
from splatrl.training import PPO, LossSettings, OptimSettings, actor_critic, load_checkpoint, save_checkpoint
from tests.tiny import tiny_env, tiny_overrides
from tests.training.toys import Match

LOSS = LossSettings(
    gamma=0.9,
    gae_lambda=0.95,
    clip_epsilon=0.2,
    ppo_epochs=2,
    mini_batch_size=32,
    critic_coeff=0.5,
    entropy_coeff=0.01,
    anneal_entropy=False,
    reward_scale=0.1,
)
OPTIM = OptimSettings(lr=1e-3, eps=1e-5, max_grad_norm=0.5, anneal_lr=False)


def learner(
    env: EnvBase,
    seed: int = 0,
    frames_per_batch: int = 64,
    total_frames: int = 10**6,
    memory: int = 0,
    on_device: bool | None = None,
    **change: Any,
) -> PPO:
    """Make PPO with a small network that depends on ``seed``; ``change`` overrides settings of loss and optimiser."""
    torch.manual_seed(seed)
    loss = replace(LOSS, **{key: value for key, value in change.items() if hasattr(LOSS, key)})
    optim = replace(OPTIM, **{key: value for key, value in change.items() if hasattr(OPTIM, key)})
    model = actor_critic(env.observation_spec["pixels"].shape[1:], env.action_spec, 1, (8, 16), 32, memory)
    return PPO(env, model, loss, optim, frames_per_batch, total_frames, on_device=on_device)


def parameters(ppo: PPO) -> torch.Tensor:
    return torch.cat([p.detach().flatten() for p in ppo.model.parameters()])


def assert_resumes(whole: PPO, resumed: PPO, path: Path) -> None:
    """Check that a training resumed from a checkpoint, after another beginning, goes on with the same bytes."""
    for _ in range(2):
        whole.iterate()
    save_checkpoint(path, whole.state_dict())
    reports = [whole.iterate() for _ in range(2)]
    resumed.iterate()
    resumed.load_state_dict(load_checkpoint(path))
    assert str([resumed.iterate() for _ in range(2)]) == str(reports)  # as text, NaN equals NaN
    assert torch.equal(parameters(resumed), parameters(whole))


def minibatch(ppo: PPO) -> tuple[TensorDictBase, dict[str, torch.Tensor]]:
    """Collect a batch with its advantages, and return it together with the whole batch as one minibatch."""
    ppo.learner.loss = replace(ppo.learner.loss, mini_batch_size=10**6)
    batch = ppo.collect()
    batch["advantage"], batch["value_target"] = ppo.learner.advantages(batch)
    (frames,) = ppo.learner.minibatches(batch)
    return batch, frames


def test_one_pass_through_the_trunk_gives_the_gradient_of_two() -> None:
    ppo = learner(tiny_env([4], max_steps=5), max_grad_norm=1e9)
    batch, frames = minibatch(ppo)
    twice = copy.deepcopy(ppo.model)
    loss = ClipPPOLoss(
        ProbabilisticTensorDictSequential(twice.module[0], *twice.get_policy_head().module),
        twice.get_value_operator(),
        clip_epsilon=LOSS.clip_epsilon,
        entropy_coeff=LOSS.entropy_coeff,
        critic_coeff=LOSS.critic_coeff,
        normalize_advantage=True,
    )(batch.reshape(-1))
    (loss["loss_objective"] + loss["loss_critic"] + loss["loss_entropy"]).backward()
    expected = torch.cat([p.grad.flatten() for p in twice.parameters()])
    ppo.learner.optimizer = torch.optim.SGD(ppo.model.parameters(), lr=1.0)
    before = parameters(ppo)
    ppo.learner.step(frames)
    assert expected.abs().max() > 1e-3
    torch.testing.assert_close(before - parameters(ppo), expected, atol=2e-6, rtol=1e-3)


def test_gradients_are_clipped_to_the_maximum_norm() -> None:
    ppo = learner(tiny_env([4], max_steps=5), max_grad_norm=1e-3)
    _, frames = minibatch(ppo)
    ppo.learner.optimizer = torch.optim.SGD(ppo.model.parameters(), lr=1.0)
    before = parameters(ppo)
    ppo.learner.step(frames)
    assert (parameters(ppo) - before).norm().item() == pytest.approx(1e-3, rel=1e-2)


def test_identical_frames_are_evaluated_once_with_the_same_gradient() -> None:
    ppo = learner(tiny_env([8], max_steps=5), max_grad_norm=1e9)
    batch = ppo.collect()
    batch["advantage"], batch["value_target"] = ppo.learner.advantages(batch)
    alike = ppo.learner.alike(batch)
    assert alike is not None
    ppo.learner.optimizer = torch.optim.SGD(ppo.model.parameters(), lr=1.0)
    state, moves, sizes = copy.deepcopy(ppo.model.state_dict()), [], []
    for given in (alike, None):
        ppo.model.load_state_dict(state)
        torch.manual_seed(1)
        frames = next(ppo.learner.minibatches(batch, given))
        sizes.append((len(frames["image"]), len(frames["action"])))
        before = parameters(ppo)
        ppo.learner.step(frames)
        moves.append(before - parameters(ppo))
    assert sizes[0][0] < sizes[1][0] == sizes[0][1] == sizes[1][1] == 32
    assert moves[1].abs().max() > 1e-3
    torch.testing.assert_close(*moves, atol=2e-6, rtol=1e-3)


def test_advantages_match_those_of_torchrls_estimator() -> None:
    ppo = learner(tiny_env([6], max_steps=4), frames_per_batch=6 * 13)
    batch = ppo.collect()
    middle = batch["next"][:, :-1]
    assert middle["truncated"].any() and middle["terminated"].any()  # else this shows too little
    assert not batch["next", "done"][:, -1].all()
    advantage, target = ppo.learner.advantages(batch)
    scaled = batch.exclude("state_value").clone()
    scaled["next", "reward"] *= LOSS.reward_scale
    estimator = GAE(
        gamma=LOSS.gamma, lmbda=LOSS.gae_lambda, value_network=ppo.model.get_value_operator(), average_gae=False
    )
    with torch.no_grad():
        expected = estimator(scaled)
    torch.testing.assert_close(advantage, expected["advantage"], atol=1e-5, rtol=1e-5)
    torch.testing.assert_close(target, expected["value_target"], atol=1e-5, rtol=1e-5)


def test_a_batch_begins_where_the_last_one_stopped() -> None:
    ppo = learner(tiny_env([16], max_steps=4))
    first, second = ppo.collect(), ppo.collect()
    assert first.shape == second.shape == (16, 4)
    ended = first["next", "done"][:, -1]
    assert ended.any() and not ended.all()
    assert torch.equal(second["step_count"][:, 0], torch.where(ended, 0, first["next", "step_count"][:, -1]))
    goes_on = ~ended.squeeze(1)
    assert torch.equal(second["pixels"][goes_on, 0], first["next", "pixels"][goes_on, -1])


def test_collecting_samples_the_actions() -> None:
    batch = learner(tiny_env([8]), frames_per_batch=512).collect()
    counts = batch["action"].flatten().bincount(minlength=6)
    assert counts.min() > 512 / 6 / 2  # the first policy is nearly uniform


def test_the_report_counts_the_episodes_of_the_batch() -> None:
    report = learner(tiny_env([4], max_steps=1)).iterate()
    assert (report["frames"], report["episodes"], report["length"]) == (64, 64, 1.0)
    batch = learner(tiny_env([4], max_steps=5, first=1), frames_per_batch=256).collect()
    report = learner(tiny_env([4], max_steps=5, first=1), frames_per_batch=256).iterate()  # the same batch
    ended = batch["next"][batch["next", "done"].squeeze(-1)]
    assert report["episodes"] == len(ended)
    assert report["success"] == pytest.approx((ended["reward"] > 40).float().mean().item())
    assert report["collision"] == pytest.approx((ended["free_fraction"] < 1).float().mean().item())
    assert report["return"] == pytest.approx(ended["episode_return"].mean().item())
    assert report["success"] > 0 and report["collision"] > 0  # else this shows too little


@pytest.mark.parametrize("on_device", [False, True])
def test_the_report_counts_episodes_with_collisions_where_these_do_not_end_them(
    on_device: bool, tmp_path: Path
) -> None:
    few = ["task.goals=5", "task.test_goals=4", "task.nearest=0.3", "task.cell=0.1", "robot.body.radius=0.1"]
    envs = [splatrl.make_env([*tiny_overrides(tmp_path, "pointnav"), *few], [16], seed=0) for _ in range(2)]
    batch = learner(envs[0], frames_per_batch=512, on_device=on_device).collect()
    report = learner(envs[1], frames_per_batch=512, on_device=on_device).iterate()  # the same batch
    ended = batch["next"][batch["next", "done"].squeeze(-1)]
    assert report["episodes"] == len(ended)
    assert 0 < report["collision"] == pytest.approx((ended["collisions"] > 0).float().mean().item())


@pytest.mark.parametrize("anneal", [True, False])
def test_learning_rate_and_entropy_bonus_fall_linearly_to_the_end_if_asked(anneal: bool) -> None:
    ppo = learner(tiny_env([4]), total_frames=64 * 4, anneal_lr=anneal, anneal_entropy=anneal)
    rates, bonuses = [], []
    for _ in range(4):
        ppo.iterate()
        rates.append(ppo.learner.optimizer.param_groups[0]["lr"] / OPTIM.lr)
        bonuses.append(ppo.learner.entropy_coeff / LOSS.entropy_coeff)
    assert rates == pytest.approx([1, 0.75, 0.5, 0.25] if anneal else [1] * 4)
    assert bonuses == pytest.approx(rates)


def test_ppo_learns_to_reach_the_goal() -> None:
    ppo = learner(
        tiny_env([16], max_steps=20, first=2, threshold=1.0, window=10**6),  # always at level 0
        frames_per_batch=512,
        total_frames=512 * 12,
        ppo_epochs=6,
        mini_batch_size=128,
        lr=2e-3,
        anneal_lr=True,
    )
    success = [ppo.iterate()["success"] for _ in range(12)]
    assert sum(success[:2]) / 2 < 0.45  # other seeds: 0.24 to 0.34
    assert sum(success[-3:]) / 3 > 0.7  # other seeds: 0.86 to 0.93


def test_a_batch_that_is_not_a_multiple_of_the_number_of_robots_is_refused() -> None:
    with pytest.raises(
        ValueError, match=r"collector\.frames_per_batch: expected a multiple of env\.num_envs = 3, got 64"
    ):
        learner(tiny_env([3]))


def test_training_never_uses_more_than_its_total_frames() -> None:
    ppo = learner(tiny_env([4]), total_frames=64 * 3 - 1)
    used = []
    while not ppo.finished:
        used.append(ppo.iterate()["frames"])
    assert used == [64, 128]
    with pytest.raises(ValueError, match=r"collector\.total_frames: expected at least frames_per_batch = 64, got 63"):
        learner(tiny_env([4]), total_frames=63)


def test_ppo_learns_continuous_actions() -> None:
    torch.manual_seed(0)
    change = {"mini_batch_size": 128, "ppo_epochs": 6, "reward_scale": 1.0, "entropy_coeff": 0.0, "lr": 3e-3}
    ppo = learner(Match(32), frames_per_batch=512, **change)
    success = [ppo.iterate()["success"] for _ in range(8)]
    assert success[0] < 0.3  # other seeds: 0.18 to 0.23
    assert sum(success[-2:]) / 2 > 0.5  # other seeds: 0.64 to 0.90


@pytest.mark.slow
def test_a_compiled_loss_equals_the_eager_one_for_any_bonus_and_minibatch_size() -> None:
    torch._dynamo.utils.counters.clear()  # what other tests compiled
    eager, compiled = (
        learner(tiny_env([4], max_steps=5), frames_per_batch=52, compile=compile) for compile in (False, True)
    )
    for ppo in (eager, compiled):
        torch.manual_seed(1)
        for bonus in (0.01, 0.005, 0.002):
            ppo.learner.entropy_coeff = bonus
            batch = ppo.collect()
            ppo.learner.learn(batch)
    torch.testing.assert_close(parameters(compiled), parameters(eager), atol=1e-5, rtol=1e-4)
    assert sum(torch._dynamo.utils.counters["graph_break"].values()) == 0
    assert torch._dynamo.utils.counters["stats"]["unique_graphs"] <= 2  # one for a fixed size, and one for any size
