"""The Gymnasium interface of one robot, with Gymnasium's own checker and wrappers."""

import math
import warnings
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env
from tensordict import TensorDict
from torchrl.data import Unbounded
from torchrl.envs import EnvBase

from splatrl.envs.gymnasium_env import GymnasiumEnv
from splatrl.envs.gymnasium_vector_env import GymnasiumVectorEnv
from splatrl.envs.stateful_env import StatefulEnv
from splatrl.envs.tasks import ImageNav, NavigationTask, Outcome, PointNav
from splatrl.envs.transforms.frame_stack import FrameStack
from tests.envs.clients import BACK_X, FORWARD_X, LEFT_Y, SPIN, make_tiny, vector
from tests.envs.rooms import coarse_apple, drive_env, painted_env
from tests.envs.sensors.test_sensors import sensing_env
from tests.envs.tasks.test_navigation import FORWARD, STOP, env_of, task_of
from tests.envs.tasks.test_navigation import LEFT as TURN_LEFT
from tests.tiny import tiny_env


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


@pytest.mark.parametrize("kind", [PointNav, ImageNav])
def test_an_episode_begins_again_where_an_info_was_told(kind: type[NavigationTask]) -> None:
    env, others = GymnasiumEnv(env_of(task_of(kind))), GymnasiumVectorEnv(env_of(task_of(kind), (2,), 5))
    env.reset(seed=1)
    seen, *_, info = env.step(np.int64(TURN_LEFT))
    again, told = env.reset(options=info)
    counters = {"step_count": 0, "episode_return": 0.0, "level": -1}
    assert all(np.array_equal(again[key], seen[key]) for key in seen)
    assert {key: told[key] for key in counters} == counters
    for key in info.keys() - counters.keys():
        assert np.array_equal(told[key], info[key]), key
    others.reset()
    batched, _ = others.reset(options={key: np.stack([value, value]) for key, value in info.items()})
    assert all(np.array_equal(batched[key][1], seen[key]) for key in seen)
    assert not np.array_equal(env.reset(options={"state": info["state"]})[1]["goal"], info["goal"])


def test_infos_tell_the_measures_of_navigation_under_habitats_names() -> None:
    task = task_of()
    env = GymnasiumEnv(env_of(task))
    row = torch.zeros(1, dtype=torch.int64)
    begun = task.episode(torch.tensor([[0.5, -1.0, 0.0]]), row, torch.zeros(1, 1))
    goal = begun["goal"][0, :2].tolist()
    env.reset(options={"state": [*goal, 0.0], **task.episode(torch.tensor([[*goal, 0.0]]), row, torch.zeros(1, 1))})
    *_, info = env.step(np.int64(TURN_LEFT))
    assert (info["success"], info["is_success"], info["spl"], info["distance_to_goal"]) == (False, False, 0.0, 0.0)
    *_, info = env.step(np.int64(STOP))
    assert (info["success"], info["is_success"], info["spl"], info["soft_spl"]) == (True, True, 1.0, 1.0)
    env.reset(options={"state": [0.5, -1.0, 0.0], **begun})
    *_, info = env.step(np.int64(FORWARD))
    far, start, path = (info[key] for key in ("distance_to_goal", "start_distance", "path_length"))
    assert info["soft_spl"] == pytest.approx(max(0.0, 1 - far / start) * start / max(start, path))
    assert info["goal"].tolist() == begun["goal"][0].tolist() and info["collisions"] == 0 and info["step_count"] == 1


def test_a_reset_without_a_seed_continues_the_random_sequence() -> None:
    env = make_tiny()
    runs = []
    for _ in range(2):
        states = [env.reset(seed=8)[1]["state"]] + [env.reset()[1]["state"] for _ in range(5)]
        runs.append(np.stack(states))
    assert np.array_equal(*runs)
    assert len(np.unique(runs[0], axis=0)) > 1


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
            lambda env: GymnasiumEnv(env_of(task_of())).reset(options={"state": [0.5, -1.0, 0.0], "gaol": 1}),
            ValueError,
            r"options: expected 'state', with any of collisions, .*, goal, .*, got \['gaol', 'state'\]",
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
    ],
)
def test_invalid_calls_and_settings_are_refused(call: Any, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        call(make_tiny("rgb_array"))


def test_nothing_is_rendered_without_a_render_mode() -> None:
    env = make_tiny(render_mode=None)
    env.reset()
    assert env.render() is None


def test_infos_tell_the_level_at_which_an_episode_began() -> None:
    single, several = tiny_env([1], first=1, window=1), vector(tiny_env([2]))
    single.reset()
    single.curriculum.record(torch.zeros(1), torch.ones(1, dtype=torch.bool), torch.ones(1, dtype=torch.bool))
    assert GymnasiumEnv(single).reset()[1]["level"] == 1
    assert GymnasiumEnv(single).reset(options={"state": [0, 0, 0]})[1]["level"] == -1
    assert several.reset()[1]["level"].tolist() == [0, 0]


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
