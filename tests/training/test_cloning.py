"""Behaviour cloning: policies learn to act as demonstrated, with and without memory."""

import math
from pathlib import Path

import pytest
import torch
from torch import Tensor
from torch.nn.functional import one_hot

from splatrl.building import build_model, build_world
from splatrl.configuration import load_config
from splatrl.datasets import planner_episodes
from splatrl.evaluation import run_episodes
from splatrl.training import Cloner, CloningSettings
from splatrl.training.cloning import imitation, width
from splatrl.training.distributions import Choice, Squashed
from tests.tiny import tiny_overrides

SETTINGS = CloningSettings(epochs=30, mini_batch_size=64, lr=1e-3, critic_coeff=0.5)


@pytest.mark.parametrize("memory", ["gru", *(pytest.param(name, marks=pytest.mark.slow) for name in ("none", "stack"))])
def test_a_cloned_policy_reaches_the_goal_as_demonstrated(memory: str, tmp_path: Path) -> None:
    cfg = load_config([*tiny_overrides(tmp_path), f"memory={memory}"])
    world = build_world(cfg)
    shown = planner_episodes(world, 100)
    torch.manual_seed(0)
    model = build_model(cfg, world.env(1))
    env, starts = world.env(30), world.plan.starts[::8]
    before = run_episodes(env, model.get_policy_operator(), starts).success.double().mean()
    frames = {
        "pixels": shown.stacked(4 if memory == "stack" else 1),
        "target": one_hot(shown.frames["action"], 6).float(),
        "value_target": shown.returns(0.9) / 50.0,
        "frame": shown.frames["frame"],
    }
    first = Cloner(model, CloningSettings(1, 64, 0.0, 0.5)).fit(frames)
    last = Cloner(model, SETTINGS).fit(frames)
    after = run_episodes(env, model.get_policy_operator(), starts).success.double().mean()
    assert first == pytest.approx(1.79, abs=0.05) and last < 0.8
    assert before < 0.3 and after > 0.5
    begun = shown.frames[shown.starts]
    seen = world.env(len(begun)).reset(begun.select("state"), set_state=True)
    model.get_value_operator()(seen)
    told = frames["value_target"][shown.starts]
    assert torch.corrcoef(torch.stack([seen["state_value"].squeeze(1).detach(), told]))[0, 1] > 0.6


def test_memory_does_not_carry_over_between_episodes(tmp_path: Path) -> None:
    cfg = load_config([*tiny_overrides(tmp_path), "memory=gru"])
    env = build_world(cfg).env(1)
    torch.manual_seed(0)
    cloner = Cloner(build_model(cfg, env), SETTINGS)
    features = torch.randn(7, 128)
    frame = torch.tensor([0, 1, 2, 0, 0, 1, 2])
    together = cloner._hidden(features, frame)
    apart = [cloner._hidden(features[rows], frame[rows]) for rows in (slice(0, 3), slice(3, 4), slice(4, 7))]
    torch.testing.assert_close(together, torch.cat(apart))


def test_frames_that_begin_within_an_episode_are_refused(tmp_path: Path) -> None:
    cfg = load_config([*tiny_overrides(tmp_path), "memory=gru"])
    cloner = Cloner(build_model(cfg, build_world(cfg).env(1)), SETTINGS)
    with pytest.raises(ValueError, match="frame: expected 0 first, where an episode begins, got 3"):
        cloner.fit({"frame": torch.tensor([3, 4, 0, 1]), "target": torch.zeros(4, 6)})


def test_every_frame_is_learned_from_once_per_epoch(tmp_path: Path) -> None:
    for memory in ("none", "gru"):
        cfg = load_config([*tiny_overrides(tmp_path), f"memory={memory}"])
        cloner = Cloner(build_model(cfg, build_world(cfg).env(1)), CloningSettings(1, 4, 1e-3, 0.5))
        frame = torch.tensor([0, 1, 2, 0, 0, 1, 2, 3, 4, 0])
        shown = {"frame": frame, "target": torch.arange(10)}
        batches = list(cloner._minibatches(shown))
        assert torch.cat([some["target"] for some in batches]).sort().values.tolist() == list(range(10))
        assert memory == "none" or all(some["frame"][0] == 0 for some in batches)


def test_the_imitation_loss_matches_values_worked_out_by_hand() -> None:
    logits = torch.tensor([[2.0, 0.0], [0.0, 3.0]])
    expected = -logits.log_softmax(1)[torch.arange(2), torch.tensor([0, 0])].mean()
    first = torch.tensor([[1.0, 0.0], [1.0, 0.0]])
    assert imitation(Choice(logits), first) == pytest.approx(float(expected))
    shares = torch.tensor([[0.5, 0.5], [0.5, 0.5]])
    assert imitation(Choice(logits), shares) == pytest.approx(float(-logits.log_softmax(1).mean()))

    def squashed(loc: float, *actions: list[float]) -> Tensor:
        low, high = torch.tensor([0.0, -2.0]), torch.tensor([1.0, 2.0])
        policy = Squashed(torch.full((len(actions), 2), loc), torch.ones(len(actions), 2), low, high)
        return imitation(policy, torch.tensor(actions))

    assert squashed(0.0, [1.0, 0.0]) == pytest.approx(0.5), "half a range from one action, none from the other"
    assert squashed(20.0, [1.0, 0.0]) == pytest.approx(0.5, abs=1e-4)
    nan = math.nan
    assert squashed(0.0, [nan, nan], [1.0, 0.0]) == squashed(0.0, [1.0, 0.0]), "nothing is known of the first"


@pytest.mark.parametrize(("power", "learned"), [(2.0, -0.2), (1.0, -1.0)])
def test_the_power_decides_whether_the_mean_or_the_median_action_is_learned(power: float, learned: float) -> None:
    low, high = torch.tensor([-1.0]), torch.tensor([1.0])
    target = torch.tensor([[-1.0], [-1.0], [-1.0], [1.0], [1.0]])
    loc = torch.zeros(1, requires_grad=True)
    optimiser = torch.optim.Adam([loc], lr=0.05)
    for _ in range(200):
        policy = Squashed(loc.expand(5, 1), torch.ones(5, 1), low, high)
        optimiser.zero_grad()
        imitation(policy, target, power).backward()
        optimiser.step()
    assert policy.deterministic_sample[0].item() == pytest.approx(learned, abs=0.02)


def test_frames_without_a_target_action_give_no_gradient() -> None:
    logits = torch.tensor([[2.0, 0.0], [0.0, 3.0]], requires_grad=True)
    target = torch.tensor([[1.0, 0.0], [math.nan, math.nan]])
    loss = imitation(Choice(logits), target)
    loss.backward()
    assert loss.detach() == pytest.approx(float(-logits[0].detach().log_softmax(0)[0]))
    assert logits.grad is not None and not logits.grad[1].any() and logits.grad[0].all()
    assert imitation(Choice(logits), target[1:].expand(2, 2)) == 0.0


@pytest.mark.parametrize("name", ["epochs", "mini_batch_size", "lr", "critic_coeff"])
def test_settings_out_of_range_are_named(name: str) -> None:
    values = {"epochs": 1, "mini_batch_size": 1, "lr": 1e-3, "critic_coeff": 0.5}
    with pytest.raises(ValueError, match=f"cloning.{name}: expected"):
        CloningSettings(**(values | {name: -1}))


@pytest.mark.parametrize("power", [0.5, 3.0])
def test_a_power_that_is_not_between_1_and_2_is_refused(power: float) -> None:
    with pytest.raises(ValueError, match=r"cloning\.power: expected a number from 1\.0 to 2\.0, got"):
        CloningSettings(1, 1, 1e-3, 0.5, power)


def test_the_width_of_the_policy_learns_the_error_of_its_mode() -> None:
    low, high = torch.tensor([0.0, -2.0]), torch.tensor([1.0, 2.0])
    loc = torch.zeros(3, 2, requires_grad=True)
    raw = torch.full((3, 2), 0.5, requires_grad=True)
    target = torch.tensor([[0.6, 0.0], [0.4, 1.0], [math.nan, math.nan]])
    optimiser = torch.optim.SGD([raw], lr=0.5)
    for _ in range(200):
        optimiser.zero_grad()
        width(Squashed(loc, raw, low, high), target).backward()
        optimiser.step()
    torch.testing.assert_close(raw[:2], torch.tensor([[0.2, 0.0], [0.2, 0.5]]), atol=1e-3, rtol=0.0)
    assert (raw[2] == 0.5).all(), "nothing is known there"
    assert loc.grad is None or not loc.grad.any(), "the mode learns nothing from it"
    assert width(Choice(torch.zeros(2, 3)), torch.ones(2, 3) / 3.0) == 0.0


def test_the_learning_rate_decays_linearly_if_asked(tmp_path: Path) -> None:
    cfg = load_config(tiny_overrides(tmp_path))
    world = build_world(cfg)
    shown = planner_episodes(world, 2)
    cloner = Cloner(build_model(cfg, world.env(1)), CloningSettings(4, 64, 1e-3, 0.5))
    frames = {
        "pixels": shown.frames["pixels"],
        "target": one_hot(shown.frames["action"], 6).float(),
        "value_target": shown.returns(0.9),
        "frame": shown.frames["frame"],
    }
    rates: list[float] = []
    step = cloner._step
    cloner._step = lambda some: rates.append(cloner.optimizer.param_groups[0]["lr"]) or step(some)  # type: ignore
    cloner.fit(frames, anneal=True)
    assert list(dict.fromkeys(rates)) == pytest.approx([1e-3, 7.5e-4, 5e-4, 2.5e-4])
    rates.clear()
    cloner.fit(frames)
    assert set(rates) == {1e-3}
