"""The vectorised Gymnasium interface: a batch of robots, in each autoreset mode."""

from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers.vector import NormalizeObservation, RecordEpisodeStatistics
from torchrl.envs import EnvBase
from torchrl.envs.transforms import RewardScaling, TransformedEnv

from splatrl.envs.gymnasium_env import GymnasiumEnv
from splatrl.envs.gymnasium_vector_env import GymnasiumVectorEnv
from splatrl.envs.tasks import Outcome
from splatrl.envs.transforms import Appearance
from tests.envs.clients import BACK_X, FORWARD_X, LEFT_Y, SPIN, SPIN_BACK, make_tiny, vector
from tests.envs.rooms import drive_env
from tests.envs.sensors.test_sensors import sensing_env
from tests.envs.transforms.views import transformed
from tests.tiny import tiny_env


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


def test_a_list_of_seeds_gives_the_starts_of_single_robots_under_pose_noise_too() -> None:
    several = vector(transformed((3,), 0, ("PoseNoise",), sprite=False))
    single = GymnasiumEnv(transformed((1,), 0, ("PoseNoise",), sprite=False))
    states = several.reset(seed=[4, 7, 9])[1]["state"]
    assert states.tolist() == [single.reset(seed=seed)[1]["state"].tolist() for seed in (4, 7, 9)]


def test_an_info_holds_what_transforms_drew_and_a_reset_to_it_shows_the_same_views() -> None:
    env = vector(transformed((3,), 0, ("PoseNoise",), sprite=False))
    seen, info = env.reset(seed=4)
    again, told = env.reset(options=info)
    assert info["camera_offset"].any() and np.array_equal(told["camera_offset"], info["camera_offset"])
    assert np.array_equal(again, seen)


def test_transforms_take_effect_through_the_gymnasium_interface() -> None:
    env = vector(TransformedEnv(tiny_env([3]), RewardScaling(0.0, 0.5)))
    env.reset(seed=0, options={"state": [[1, 5, 0], [0, 0, 0], [1, 3, 0]]})
    _, reward, *_ = env.step(np.array([FORWARD_X, SPIN, FORWARD_X]))
    assert reward.tolist() == pytest.approx([25.0, -0.1, -5.0])


def test_a_batch_drives_as_single_robots_do() -> None:
    batch, singles = vector(drive_env([3])), [GymnasiumEnv(drive_env()) for _ in range(3)]
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


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (
            lambda: GymnasiumVectorEnv(tiny_env([2]), render_mode="human"),
            ValueError,
            "render_mode: expected 'rgb_array' or None",
        ),
        (
            lambda: GymnasiumVectorEnv(tiny_env([2])).reset(seed=[1, 2, 3]),
            ValueError,
            r"seed: expected one number, or a list of 2, got \[1, 2, 3\]",
        ),
        (
            lambda: GymnasiumVectorEnv(tiny_env([2]), "Never"),
            ValueError,
            "autoreset_mode: expected one of NextStep, SameStep, Disabled, got Never",
        ),
        (
            lambda: GymnasiumVectorEnv(tiny_env([2])).reset(options={"reset_mask": np.array([True, False])}),
            gymnasium.error.ResetNeeded,
            "reset: expected a call without reset_mask first",
        ),
    ],
)
def test_invalid_calls_and_settings_of_a_batch_are_refused(
    call: Callable[[], Any], error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        call()


def test_nothing_is_rendered_of_a_batch_without_a_render_mode() -> None:
    batch = GymnasiumVectorEnv(tiny_env([2]), render_mode=None)
    batch.reset()
    assert batch.render() is None
