"""Gymnasium's interface: its own checker, its wrappers, and a client that learns."""

import math
import warnings
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env
from gymnasium.wrappers.vector import RecordEpisodeStatistics
from stable_baselines3 import PPO
from stable_baselines3.common.monitor import Monitor
from tensordict import TensorDict
from torchrl.data import Unbounded
from torchrl.envs import EnvBase
from torchrl.envs.transforms import RewardScaling, TransformedEnv

from splatrl.envs.gymnasium_env import GymnasiumEnv, GymnasiumVectorEnv
from splatrl.envs.tasks import Outcome
from tests.envs.rooms import coarse_apple, drive_env, painted_env
from tests.tiny import tiny_env

FORWARD_X, BACK_X, LEFT_Y, RIGHT_Y, SPIN, SPIN_BACK = range(6)


def make_tiny(render_mode: str | None = None, **settings: Any) -> GymnasiumEnv:
    """Make the tiny env, as an entry point for ``gymnasium.make``."""
    return GymnasiumEnv(tiny_env([1], **settings), render_mode=render_mode)


def make_driving(render_mode: str | None = None) -> GymnasiumEnv:
    """An env with continuous control."""
    return GymnasiumEnv(drive_env(), render_mode=render_mode)


def make_painted(render_mode: str | None = None) -> GymnasiumEnv:
    """An env under a transform that changes reward and outcome."""
    return GymnasiumEnv(painted_env(coarse_apple(), 1), render_mode=render_mode)


@pytest.mark.parametrize("make", [make_tiny, make_driving, make_painted])
def test_gymnasiums_checker_has_nothing_to_say(make: Callable[..., GymnasiumEnv]) -> None:
    spec = gymnasium.envs.registration.EnvSpec("Tiny-v0", entry_point=make, disable_env_checker=True)
    env = gymnasium.make(spec, render_mode="rgb_array").unwrapped
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env)


def test_a_step_shows_what_the_env_shows() -> None:
    view, env = GymnasiumEnv(tiny_env([1])), tiny_env([1])
    observation, info = view.reset(seed=4)
    env.set_seed(4)
    td = env.reset()
    for action in (FORWARD_X, SPIN, LEFT_Y):
        assert np.array_equal(observation, td["pixels"][0].numpy()) and np.array_equal(view.render(), observation)
        assert info["state"].tolist() == td["state"][0].tolist()
        observation, reward, terminated, truncated, info = view.step(np.int64(action))
        after = env.step(td.set("action", torch.tensor([action])))["next"]
        assert (reward, terminated, truncated) == tuple(after[k].item() for k in ("reward", "terminated", "truncated"))
        td = after
    assert observation.shape == (12, 16, 3) and observation.dtype == np.uint8


def test_an_episode_begins_at_a_given_state_and_ends_with_its_outcome() -> None:
    env = make_tiny(max_steps=2)
    for state, action, outcome in (
        ([1, 5, 0], FORWARD_X, Outcome.GOAL),
        ([1, 3, 0], FORWARD_X, Outcome.COLLISION),
        ([0, 0, 3], BACK_X, Outcome.OUT_OF_BOUNDS),
    ):
        _, info = env.reset(options={"state": np.array(state)})
        assert info["state"].tolist() == state and info["outcome"] == Outcome.RUNNING and info["success"] is False
        _, _, terminated, truncated, info = env.step(np.int64(action))
        assert terminated and not truncated and info["outcome"] == outcome
        assert info["success"] is (outcome == Outcome.GOAL)
    env.reset(options={"state": [0, 0, 0]})
    assert env.step(np.int64(SPIN))[2:4] == (False, False)
    assert env.step(np.int64(SPIN))[2:4] == (False, True)


def test_a_reset_without_a_seed_goes_on_with_the_generator() -> None:
    env = make_tiny()
    runs = []
    for _ in range(2):
        states = [env.reset(seed=8)[1]["state"]] + [env.reset()[1]["state"] for _ in range(5)]
        runs.append(np.stack(states))
    assert np.array_equal(*runs)
    assert len(np.unique(runs[0], axis=0)) > 1


def test_later_steps_do_not_change_an_observation_that_was_handed_out() -> None:
    env = make_tiny()
    observation, _ = env.reset(seed=0)
    kept = observation.copy()
    moved, *_ = env.step(np.int64(SPIN))
    assert np.array_equal(observation, kept) and not np.array_equal(moved, kept)


def unbounded_env() -> EnvBase:
    """An env whose action has no limits."""
    env = tiny_env([1])
    env.action_spec = Unbounded((1, 2))
    return env


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (
            lambda env: env.reset(options={"pose": 1}),
            ValueError,
            r"options: expected 'state' or nothing, got \['pose'\]",
        ),
        (lambda env: env.reset(options={"state": [5, 0, 0]}), ValueError, r"options\['state'\]: expected \[1, 3\]"),
        (lambda env: env.reset(options={"state": [0, 0]}), ValueError, r"options\['state'\]: expected \[1, 3\]"),
        (lambda env: env.step(np.int64(0)), gymnasium.error.ResetNeeded, "step: expected reset first"),
        (lambda env: env.render(), gymnasium.error.ResetNeeded, "render: expected reset first"),
        (lambda env: (env.reset(), env.step(np.int64(6))), ValueError, r"action: expected one of Discrete\(6\), got 6"),
        (lambda env: (env.reset(), env.step(np.int64(-1))), ValueError, "action"),
        (lambda env: GymnasiumEnv(unbounded_env()), ValueError, "env: expected a discrete or a bounded float32 action"),
        (lambda env: GymnasiumEnv(tiny_env([2])), ValueError, r"env: expected batch size \[1\], got \[2\]"),
        (lambda env: GymnasiumEnv(tiny_env([1]), "human"), ValueError, "render_mode: expected 'rgb_array' or None"),
        (lambda env: GymnasiumVectorEnv(tiny_env([2])).reset(seed=[1, 2]), ValueError, "seed: expected one number"),
    ],
)
def test_what_makes_no_sense_is_refused(call: Any, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        call(make_tiny("rgb_array"))


def test_nothing_is_rendered_without_a_render_mode() -> None:
    env = make_tiny(render_mode=None)
    env.reset()
    assert env.render() is None


def vector(env: EnvBase | None = None, **settings: Any) -> GymnasiumVectorEnv:
    return GymnasiumVectorEnv(env or tiny_env([3], **settings))


def test_robots_whose_episode_ends_begin_the_next_in_the_same_step() -> None:
    env = vector()
    before, info = env.reset(seed=1, options={"state": [[1, 5, 0], [0, 0, 0], [1, 3, 0]]})
    assert before in env.observation_space and info["state"].tolist() == [[1, 5, 0], [0, 0, 0], [1, 3, 0]]
    seen, reward, terminated, truncated, info = env.step(np.array([FORWARD_X, SPIN, FORWARD_X]))
    assert terminated.tolist() == [True, False, True] and not truncated.any()
    assert reward.tolist() == pytest.approx([50.0, -0.2, -10.0])
    assert info["_final_obs"].tolist() == info["_final_info"].tolist() == [True, False, True]
    assert info["final_info"]["outcome"][[0, 2]].tolist() == [Outcome.GOAL, Outcome.COLLISION]
    assert info["final_info"]["state"].tolist() == [[2, 5, 0], [0, 0, 1], [1, 3, 0]]
    assert info["final_info"]["success"].tolist() == [True, False, False]
    assert info["outcome"].tolist() == [Outcome.RUNNING] * 3 and info["state"][1].tolist() == [0, 0, 1]
    single = make_tiny()
    for row in range(3):
        shown, _ = single.reset(options={"state": info["state"][row]})
        assert np.array_equal(seen[row], shown)
    last, _ = single.reset(options={"state": [2, 5, 0]})
    assert np.array_equal(info["final_obs"][0], last) and info["final_obs"][1] is None
    assert np.array_equal(np.stack(env.render()), seen)


def test_a_batch_gives_what_single_robots_give() -> None:
    batch, singles = vector(tiny_env([2])), [make_tiny(), make_tiny()]
    starts = np.array([[0, 1, 5], [4, 0, 2]])
    batch.reset(options={"state": starts})
    for single, state in zip(singles, starts, strict=True):
        single.reset(options={"state": state})
    for actions in ([SPIN, LEFT_Y], [FORWARD_X, BACK_X], [SPIN_BACK, SPIN]):
        seen, reward, *_ = batch.step(np.array(actions))
        for row, single in enumerate(singles):
            shown, alone, *_ = single.step(np.int64(actions[row]))
            assert np.array_equal(seen[row], shown) and reward[row] == alone


def test_the_same_seed_gives_the_same_batch() -> None:
    env = vector()
    first, second, third = (env.reset(seed=seed)[1]["state"] for seed in (3, 3, 4))
    assert np.array_equal(first, second) and not np.array_equal(first, third)


def test_gymnasiums_wrappers_count_the_episodes() -> None:
    env = RecordEpisodeStatistics(vector(max_steps=6))
    env.reset(seed=0)
    env.action_space.seed(0)
    lengths: list[int] = []
    for _ in range(40):
        _, _, terminated, truncated, info = env.step(env.action_space.sample())
        ended = terminated | truncated
        assert ("episode" in info) == bool(ended.any())
        if ended.any():
            assert np.array_equal(info["_episode"], ended)
            lengths += info["episode"]["l"][ended].tolist()
    assert len(lengths) > 10 and max(lengths) == 6 and sum(lengths) <= 40 * 3


def test_transforms_show_through() -> None:
    env = vector(TransformedEnv(tiny_env([3]), RewardScaling(0.0, 0.5)))
    env.reset(seed=0, options={"state": [[1, 5, 0], [0, 0, 0], [1, 3, 0]]})
    _, reward, *_ = env.step(np.array([FORWARD_X, SPIN, FORWARD_X]))
    assert reward.tolist() == pytest.approx([25.0, -0.1, -5.0])


@pytest.mark.parametrize(
    ("action", "linear", "angular"),
    [
        ((1.0, 1.0), 0.5, math.pi),
        ((-1.0, -1.0), -0.25, -math.pi),
        ((1.0, 0.0), 0.5, 0.0),
        ((-1 / 3, 0.0), 0.0, 0.0),
        ((0.0, 0.5), 0.125, math.pi / 2),
    ],
)
def test_a_continuous_action_goes_from_the_lowest_to_the_highest(
    action: tuple[float, float], linear: float, angular: float
) -> None:
    view, env = make_driving(), drive_env()
    start = torch.tensor([[-0.75, 1.0, 0.5]])
    _, info = view.reset(options={"state": start[0].numpy()})
    assert np.array_equal(info["state"], start[0])
    td = env.reset(TensorDict({"state": start}, [1]), set_state=True)
    after = env.step(td.set("action", torch.tensor([[linear, angular]])))["next"]
    seen, reward, _, _, info = view.step(np.array(action, np.float32))
    np.testing.assert_allclose(info["state"], after["state"][0], atol=1e-6)
    assert reward == after["reward"].item() and np.abs(seen.astype(int) - after["pixels"][0].numpy()).max() <= 1


def test_a_continuous_action_can_have_double_precision_and_may_not_leave_the_box() -> None:
    env = make_driving()
    env.reset(seed=0)
    space = env.action_space
    assert space == gymnasium.spaces.Box(-1.0, 1.0, (2,), np.float32)
    env.step(np.array([0.3, -0.2]))
    for action in ([1.1, 0.0], [0.0, np.nan], [0.0], 0.5):
        with pytest.raises(ValueError, match="action: expected one of Box"):
            env.step(np.array(action))


def test_a_batch_drives_as_single_robots_do() -> None:
    batch, singles = vector(drive_env([3])), [make_driving() for _ in range(3)]
    assert batch.action_space.shape == (3, 2) and batch.single_action_space == singles[0].action_space
    starts = np.array([[-0.75, 1.0, 0.0], [-0.5, 0.0, 0.0], [0.25, 1.0, 0.0]], np.float32)
    batch.reset(options={"state": starts})
    actions = np.array([[0.2, 0.3], [1.0, 0.0], [0.9, -0.1]], np.float32)
    seen, reward, terminated, _, info = batch.step(actions)
    assert terminated.tolist() == [False, True, True] and info["final_info"]["success"].tolist() == [False, False, True]
    for row, single in enumerate(singles):
        single.reset(options={"state": starts[row]})
        shown, alone, ended, _, told = single.step(actions[row])
        assert alone == reward[row] and ended == terminated[row]
        if ended:
            assert np.array_equal(info["final_obs"][row], shown)
            assert np.array_equal(info["final_info"]["state"][row], told["state"])
        else:
            assert np.array_equal(seen[row], shown) and np.array_equal(info["state"][row], told["state"])


def test_a_goal_that_a_transform_grants_is_what_a_client_is_told() -> None:
    env, batch = make_painted(), vector(painted_env(coarse_apple(), 2))
    before_apple, far = [0.25, 1.0, 0.0], [-0.75, 1.0, 0.0]
    env.reset(options={"state": np.array(before_apple)})
    _, reward, terminated, truncated, info = env.step(np.int64(0))
    assert (reward, terminated, truncated, info["success"]) == (50.0, True, False, True)
    batch.reset(options={"state": np.array([far, before_apple])})
    seen, reward, terminated, _, info = batch.step(np.array([0, 0]))
    assert reward.tolist() == pytest.approx([-0.2, 50.0]) and terminated.tolist() == [False, True]
    assert info["final_info"]["success"].tolist() == [False, True] and (info["final_obs"][1][..., 1] == 0).all()
    assert info["outcome"].tolist() == [Outcome.RUNNING] * 2 and seen.shape == (2, 12, 16, 3)


def test_stable_baselines_drives_with_it() -> None:
    env = make_driving()
    model = PPO("MlpPolicy", env, n_steps=32, batch_size=32, n_epochs=1, seed=0, device="cpu").learn(64)
    observation, _ = env.reset(seed=0)
    action, _ = model.predict(observation)
    assert env.action_space.contains(action) and model.num_timesteps == 64


def test_stable_baselines_learns_with_it() -> None:
    torch.manual_seed(0)
    env = Monitor(make_tiny(max_steps=12, first=1))
    model = PPO("MlpPolicy", env, 1e-3, n_steps=128, batch_size=64, gamma=0.9, ent_coef=0.01, seed=0, device="cpu")
    model.learn(2560)
    success = np.array(env.get_episode_rewards()) > 0
    assert sum(env.get_episode_lengths()) <= 2560
    assert success[-150:].mean() > 0.5  # random actions reach 0.37 ± 0.04
