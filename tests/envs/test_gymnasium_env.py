"""The Gymnasium interface, with Gymnasium's own checker and wrappers."""

import math
import warnings
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers.vector import NormalizeObservation, RecordEpisodeStatistics
from tensordict import TensorDict
from torchrl.data import Unbounded
from torchrl.envs import EnvBase
from torchrl.envs.transforms import RewardScaling, TransformedEnv

from splatrl.envs.gymnasium_env import GymnasiumEnv
from splatrl.envs.gymnasium_vector_env import GymnasiumVectorEnv
from splatrl.envs.stateful_env import StatefulEnv
from splatrl.envs.tasks import ImageNav, Outcome
from splatrl.envs.transforms import Appearance
from splatrl.envs.transforms.frame_stack import FrameStack
from tests.envs.rooms import coarse_apple, drive_env, painted_env
from tests.envs.sensors.test_sensors import sensing_env
from tests.envs.tasks.test_navigation import LEFT as TURN_LEFT
from tests.envs.tasks.test_navigation import env_of, task_of
from tests.envs.transforms.views import transformed
from tests.tiny import tiny_env

FORWARD_X, BACK_X, LEFT_Y, RIGHT_Y, SPIN, SPIN_BACK = range(6)


def make_tiny(render_mode: str | None = None, **settings: Any) -> GymnasiumEnv:
    """Make the tiny env, as an entry point for ``gymnasium.make``."""
    return GymnasiumEnv(tiny_env([1], **settings), render_mode=render_mode)


def make_driving(render_mode: str | None = None) -> GymnasiumEnv:
    """Make an env with continuous control."""
    return GymnasiumEnv(drive_env(), render_mode=render_mode)


def make_painted(render_mode: str | None = None) -> GymnasiumEnv:
    """Make an env whose reward and outcome depend on what the image shows."""
    return GymnasiumEnv(painted_env(coarse_apple(), 1), render_mode=render_mode)


def make_sensing(render_mode: str | None = None) -> GymnasiumEnv:
    """Make an env with every kind of sensor: images, vectors and bits."""
    return GymnasiumEnv(sensing_env((1,)), render_mode=render_mode)


@pytest.mark.parametrize("make", [make_tiny, make_driving, make_painted, make_sensing])
def test_gymnasiums_checker_gives_no_warning(make: Callable[..., GymnasiumEnv]) -> None:
    spec = gymnasium.envs.registration.EnvSpec("Tiny-v0", entry_point=make, disable_env_checker=True)
    env = gymnasium.make(spec, render_mode="rgb_array").unwrapped
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=".*infinity")  # metres from the start have no limit
        check_env(env)


def test_a_gymnasium_env_gives_the_results_of_the_env() -> None:
    view, env = GymnasiumEnv(tiny_env([1])), tiny_env([1])
    observation, info = view.reset(seed=5)
    env.set_seed(5)
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


def test_a_reset_without_a_seed_continues_the_random_sequence() -> None:
    env = make_tiny()
    runs = []
    for _ in range(2):
        states = [env.reset(seed=8)[1]["state"]] + [env.reset()[1]["state"] for _ in range(5)]
        runs.append(np.stack(states))
    assert np.array_equal(*runs)
    assert len(np.unique(runs[0], axis=0)) > 1


def test_sensor_readings_are_observed_beside_the_pixels() -> None:
    batch, bare = GymnasiumVectorEnv(sensing_env((3,), seed=5)), sensing_env((3,), seed=5)
    keys = {"pixels", *bare.sensors}
    seen, _ = batch.reset()
    td, ends = bare.reset(), 0
    for _ in range(12):
        assert set(seen) == keys and batch.observation_space.contains(seen)
        assert all(np.array_equal(seen[key], td[key].numpy()) for key in keys)
        after, td = bare.step_and_maybe_reset(td.set("action", torch.full((3,), FORWARD_X)))
        seen, _, terminated, truncated, infos = batch.step(np.full(3, FORWARD_X))
        for row in (terminated | truncated).nonzero()[0]:
            ends += 1
            last = infos["final_obs"][row]
            assert all(np.array_equal(last[key], after["next", key][row].numpy()) for key in keys)
    assert ends > 0


def test_discrete_actions_may_be_of_any_integer_type() -> None:
    single, several = make_tiny(), vector(tiny_env([2]))
    for kind in (np.int64, np.int32, np.uint8):
        for env, action in ((single, kind(SPIN)), (several, np.full(2, SPIN, kind))):
            env.reset(options={"state": np.zeros((env.unwrapped.env.numel(), 3))})
            assert (env.step(action)[4]["state"] == [0, 0, 1]).all()


def test_later_steps_do_not_change_an_earlier_observation() -> None:
    env = make_tiny()
    observation, _ = env.reset(seed=0)
    kept = observation.copy()
    moved, *_ = env.step(np.int64(SPIN))
    assert np.array_equal(observation, kept) and not np.array_equal(moved, kept)


def unbounded_env() -> EnvBase:
    """Make an env whose action has no limits."""
    env = tiny_env([1])
    env.action_spec = Unbounded((1, 2))
    return env


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (
            lambda env: env.reset(options={"pose": 1}),
            ValueError,
            r"options: expected 'state', got \['pose'\]",
        ),
        (
            lambda env: env.reset(options={"state": [5, 0, 0]}),
            ValueError,
            r"options\['state'\]: expected shape \[1, 3\]",
        ),
        (lambda env: env.reset(options={"state": [0, 0]}), ValueError, r"options\['state'\]: expected shape \[1, 3\]"),
        (lambda env: env.step(np.int64(0)), gymnasium.error.ResetNeeded, r"step: expected a call to reset\(\) first"),
        (lambda env: env.render(), gymnasium.error.ResetNeeded, r"render: expected a call to reset\(\) first"),
        (
            lambda env: (env.reset(), env.step(np.int64(6))),
            ValueError,
            r"action: expected an action in Discrete\(6\), got 6",
        ),
        (lambda env: (env.reset(), env.step(np.int64(-1))), ValueError, "action"),
        (lambda env: GymnasiumEnv(unbounded_env()), ValueError, "env: expected a discrete or bounded float32 action"),
        (lambda env: GymnasiumEnv(tiny_env([2])), ValueError, r"env: expected batch size \[1\], got \[2\]"),
        (lambda env: GymnasiumEnv(tiny_env([1]), "human"), ValueError, "render_mode: expected 'rgb_array' or None"),
        (
            lambda env: GymnasiumVectorEnv(tiny_env([2]), render_mode="human"),
            ValueError,
            "render_mode: expected 'rgb_array' or None",
        ),
        (
            lambda env: GymnasiumVectorEnv(tiny_env([2])).reset(seed=[1, 2, 3]),
            ValueError,
            r"seed: expected one number, or a list of 2, got \[1, 2, 3\]",
        ),
        (
            lambda env: GymnasiumVectorEnv(tiny_env([2]), "Never"),
            ValueError,
            "autoreset_mode: expected one of NextStep, SameStep, Disabled, got Never",
        ),
        (
            lambda env: GymnasiumVectorEnv(tiny_env([2])).reset(options={"reset_mask": np.array([True, False])}),
            gymnasium.error.ResetNeeded,
            "reset: expected a call without reset_mask first",
        ),
    ],
)
def test_invalid_calls_and_settings_are_refused(call: Any, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        call(make_tiny("rgb_array"))


def test_nothing_is_rendered_without_a_render_mode() -> None:
    env = make_tiny(render_mode=None)
    env.reset()
    assert env.render() is None
    batch = GymnasiumVectorEnv(tiny_env([2]), render_mode=None)
    batch.reset()
    assert batch.render() is None


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


def test_a_batch_gives_the_results_of_single_robots() -> None:
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


def test_gymnasiums_statistics_wrapper_counts_the_episodes() -> None:
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


def test_a_list_of_seeds_gives_each_robot_the_start_of_its_own_seed() -> None:
    env = vector(tiny_env([4]))
    _, first = env.reset(seed=[5, 6, 5, 9])
    alone = [make_tiny().reset(seed=seed)[1]["state"] for seed in (5, 6, 5, 9)]
    assert np.array_equal(first["state"], np.stack(alone))
    assert not np.array_equal(first["state"][0], first["state"][1])
    _, other = env.reset(seed=[6, 5, 1, 2])
    assert np.array_equal(other["state"][:2], first["state"][[1, 0]])
    runs = []
    for seeds in ([5, 6, 5, 9], np.array([5, 6, 5, 9]), (5, 6, 5, 8)):
        env.reset(seed=seeds)
        env.action_space.seed(0)
        runs.append(np.stack([env.step(env.action_space.sample())[4]["state"] for _ in range(30)]))
    assert np.array_equal(runs[0], runs[1]) and not np.array_equal(runs[0], runs[2])


def test_a_robot_without_a_seed_continues_the_random_sequence() -> None:
    env, same = vector(), vector()
    for one in (env, same):
        one.reset(seed=1)
    expected = same.reset()[1]["state"]
    state = env.reset(seed=[None, 7, None])[1]["state"]
    assert np.array_equal(state[[0, 2]], expected[[0, 2]])
    assert np.array_equal(state[1], make_tiny().reset(seed=7)[1]["state"])


def test_the_curriculum_still_counts_episodes_after_a_list_of_seeds() -> None:
    env = tiny_env([2], first=1, window=1000)
    batch = vector(env)
    batch.reset(seed=[1, 2])
    for _ in range(30):
        batch.step(np.array([FORWARD_X, FORWARD_X]))
    assert env.curriculum.progress[1] > 2


def next_step(env: EnvBase | None = None, **settings: Any) -> GymnasiumVectorEnv:
    return GymnasiumVectorEnv(env or tiny_env([3], **settings), AutoresetMode.NEXT_STEP)


def test_robots_whose_episode_ends_begin_the_next_in_the_next_step() -> None:
    env = next_step()
    assert env.metadata["autoreset_mode"] == AutoresetMode.NEXT_STEP
    env.reset(seed=1, options={"state": [[1, 5, 0], [0, 0, 0], [1, 3, 0]]})
    seen, reward, terminated, truncated, info = env.step(np.array([FORWARD_X, SPIN, FORWARD_X]))
    assert terminated.tolist() == [True, False, True] and not truncated.any() and "final_obs" not in info
    assert reward.tolist() == pytest.approx([50.0, -0.2, -10.0])
    assert info["state"].tolist() == [[2, 5, 0], [0, 0, 1], [1, 3, 0]]
    assert info["outcome"].tolist() == [Outcome.GOAL, Outcome.RUNNING, Outcome.COLLISION]
    single = make_tiny()
    assert np.array_equal(seen[0], single.reset(options={"state": [2, 5, 0]})[0])
    seen, reward, terminated, truncated, info = env.step(np.array([FORWARD_X, SPIN, FORWARD_X]))
    assert reward.tolist() == pytest.approx([0.0, -0.2, 0.0]) and not (terminated | truncated).any()
    assert info["outcome"].tolist() == [Outcome.RUNNING] * 3 and info["state"][1].tolist() == [0, 0, 2]
    for row in range(3):
        shown, _ = single.reset(options={"state": info["state"][row]})
        assert np.array_equal(seen[row], shown)
    begun = info["state"][[0, 2]]
    _, reward, _, _, info = env.step(np.array([SPIN, SPIN, SPIN]))
    assert np.array_equal(info["state"][[0, 2]], (begun + np.array([0, 0, 1])) % [5, 7, 8]) and (reward != 0).all()


def test_the_curriculum_counts_a_finished_episode_once_in_each_autoreset_mode() -> None:
    counted = []
    for mode in (AutoresetMode.SAME_STEP, AutoresetMode.NEXT_STEP):
        env = tiny_env([1], first=1, window=1000)
        batch = GymnasiumVectorEnv(env, mode)
        batch.reset(seed=0)
        ends = 0
        for _ in range(40):
            _, _, terminated, truncated, _ = batch.step(np.array([FORWARD_X]))
            ends += int((terminated | truncated).sum())
        counted.append((int(env.curriculum.progress[1]), ends))
    assert all(progress == ends > 3 for progress, ends in counted)


def test_a_reset_forgets_which_episodes_had_ended() -> None:
    env = next_step()
    env.reset(options={"state": [[1, 5, 0]] * 3})
    env.step(np.array([FORWARD_X] * 3))
    env.reset(options={"state": [[0, 0, 0]] * 3})
    _, reward, _, _, info = env.step(np.array([SPIN] * 3))
    assert reward.tolist() == pytest.approx([-0.2] * 3) and info["state"].tolist() == [[0, 0, 1]] * 3


@pytest.mark.parametrize("mode", [AutoresetMode.SAME_STEP, AutoresetMode.NEXT_STEP])
def test_episode_statistics_are_right_in_each_autoreset_mode(mode: AutoresetMode) -> None:
    env = RecordEpisodeStatistics(GymnasiumVectorEnv(tiny_env([3], max_steps=6), mode))
    env.reset(seed=0)
    lengths: list[int] = []
    for _ in range(30):
        *_, info = env.step(np.full(3, SPIN))
        lengths += info["episode"]["l"][info["_episode"]].tolist() if "episode" in info else []
    assert len(lengths) > 10 and max(lengths) == 6 and set(lengths) <= set(range(1, 7))


def test_without_autoreset_the_client_resets_robots_whose_episode_ended() -> None:
    env = RecordEpisodeStatistics(GymnasiumVectorEnv(tiny_env([3]), AutoresetMode.DISABLED))
    env.reset(seed=1, options={"state": [[1, 5, 0], [0, 0, 0], [1, 3, 0]]})
    seen, _, terminated, _, info = env.step(np.array([FORWARD_X, SPIN, FORWARD_X]))
    assert info["state"].tolist() == [[2, 5, 0], [0, 0, 1], [1, 3, 0]] and info["episode"]["l"].tolist() == [1, 0, 1]
    with pytest.raises(gymnasium.error.ResetNeeded, match="the robots whose episode has ended"):
        env.step(np.full(3, SPIN))
    shown, info = env.reset(seed=[7, 8, 9], options={"reset_mask": terminated})
    assert np.array_equal(shown[1], seen[1]) and info["_state"].tolist() == [True, False, True]
    assert info["outcome"].tolist() == [Outcome.RUNNING] * 3 and info["state"][1].tolist() == [0, 0, 1]
    alone = [make_tiny().reset(seed=seed) for seed in (7, 9)]
    for row, (view, told) in zip((0, 2), alone, strict=True):
        assert np.array_equal(shown[row], view) and info["state"][row].tolist() == told["state"].tolist()
    _, reward, *_, info = env.step(np.full(3, SPIN))
    assert (reward != 0).all() and info["state"][1].tolist() == [0, 0, 2]
    for mask in (np.zeros(3, dtype=bool), np.ones(2, dtype=bool), np.array([0, 1, 0])):
        with pytest.raises(ValueError, match=r"options: expected 'reset_mask' alone, \[3\] bool"):
            env.unwrapped.reset(options={"reset_mask": mask})
    with pytest.raises(ValueError, match="'reset_mask' alone"):
        env.unwrapped.reset(options={"reset_mask": np.ones(3, dtype=bool), "state": [[0, 0, 0]] * 3})


def test_infos_tell_the_level_at_which_an_episode_began() -> None:
    single, several = tiny_env([1], first=1, window=1), vector(tiny_env([2]))
    single.reset()
    single.curriculum.record(torch.zeros(1), torch.ones(1, dtype=torch.bool), torch.ones(1, dtype=torch.bool))
    assert GymnasiumEnv(single).reset()[1]["level"] == 1
    assert GymnasiumEnv(single).reset(options={"state": [0, 0, 0]})[1]["level"] == -1
    assert several.reset()[1]["level"].tolist() == [0, 0]


def test_wrappers_that_need_next_step_autoreset_accept_it() -> None:
    with pytest.raises(ValueError, match="NEXT_STEP"):
        NormalizeObservation(vector())
    env = NormalizeObservation(next_step(max_steps=4))
    env.reset(seed=0)
    for _ in range(12):
        seen, *_ = env.step(np.full(3, SPIN))
    assert seen.shape == (3, 12, 16, 3) and np.isfinite(seen).all() and abs(float(seen.mean())) < 1


def test_next_step_autoreset_works_under_transforms() -> None:
    env = next_step(transformed((3,), 0, ("PoseNoise",), sprite=False))
    env.reset(seed=0)
    env.action_space.seed(0)
    ended = np.zeros(3, dtype=bool)
    for _ in range(30):
        _, reward, terminated, truncated, info = env.step(env.action_space.sample())
        assert (reward[ended] == 0).all() and not (terminated | truncated)[ended].any()
        assert (info["outcome"][ended] == Outcome.RUNNING).all()
        ended = terminated | truncated
    assert info["state"].shape == (3, 3)


def test_each_episode_has_a_look_of_its_own_in_each_autoreset_mode() -> None:
    for make in (vector, next_step):
        env = make(TransformedEnv(tiny_env([2], max_steps=2), Appearance()))
        env.reset(seed=0)
        looks = set()
        for _ in range(9):
            env.step(np.full(2, SPIN))
            looks |= set(env._present["appearance"][:, 0].tolist())
        assert len(looks) >= 6


def test_an_episode_that_has_ended_takes_no_further_step() -> None:
    env = make_tiny(max_steps=1, first=1)
    env.reset(seed=0)
    env.step(np.int64(SPIN))
    with pytest.raises(gymnasium.error.ResetNeeded, match="step: expected a call to reset"):
        env.step(np.int64(SPIN))
    env.reset()
    env.step(np.int64(SPIN))


def test_clients_may_edit_all_that_they_are_given_without_moving_robots() -> None:
    for env, action in ((make_tiny("rgb_array"), np.int64(SPIN)), (vector(tiny_env([2])), np.full(2, SPIN))):
        seen, info = env.reset(seed=5)
        before = env._present.clone()
        edited = {key: value for key, value in info.items() if isinstance(value, np.ndarray)} | {"seen": seen}
        assert {"state", "seen"} <= edited.keys()
        for value in edited.values():
            value[...] = 1 - value
        np.asarray(env.render()[0])[:] = 0
        for key in before.keys(True, True):
            assert torch.equal(env._present[key], before[key]), key
        env.step(action)


@pytest.mark.parametrize("adapt", [GymnasiumEnv, GymnasiumVectorEnv])
def test_clients_may_edit_observations_without_changing_later_ones(adapt: Callable[[EnvBase], Any]) -> None:
    edited, other = (adapt(StatefulEnv(env_of(task_of(ImageNav)), FrameStack(2))) for _ in range(2))
    for step in range(4):
        action = np.full(edited.action_space.shape, TURN_LEFT)
        seen, expected = ((env.step(action) if step else env.reset(seed=5))[0] for env in (edited, other))
        assert seen.keys() == {"pixels", "imagegoal"}
        for key, value in seen.items():
            assert np.array_equal(value, expected[key]), (step, key)
            value //= 2


def test_stacked_views_are_shown_by_the_latest_one() -> None:
    env = GymnasiumEnv(StatefulEnv(tiny_env([1]), FrameStack(3)), render_mode="rgb_array")
    observation, _ = env.reset(seed=5)
    assert observation.shape == (12, 16, 9) and env.render().shape == (12, 16, 3)
    observation, *_ = env.step(np.int64(SPIN))
    assert np.array_equal(env.render(), observation[..., 6:]) and not np.array_equal(env.render(), observation[..., :3])


def test_a_list_of_seeds_gives_the_starts_of_single_robots_under_pose_noise_too() -> None:
    several = vector(transformed((3,), 0, ("PoseNoise",), sprite=False))
    single = GymnasiumEnv(transformed((1,), 0, ("PoseNoise",), sprite=False))
    states = several.reset(seed=[4, 7, 9])[1]["state"]
    assert states.tolist() == [single.reset(seed=seed)[1]["state"].tolist() for seed in (4, 7, 9)]


def test_transforms_take_effect_through_the_gymnasium_interface() -> None:
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
def test_a_continuous_action_spans_the_range_from_lowest_to_highest(
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
        with pytest.raises(ValueError, match="action: expected an action in Box"):
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


def test_a_goal_that_depends_on_the_image_is_reported_to_the_client() -> None:
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
