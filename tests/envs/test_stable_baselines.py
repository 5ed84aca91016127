"""Stable-Baselines3 learns with one robot, and with a batch of them."""

from pathlib import Path

import numpy as np
import pytest
import torch

pytest.importorskip("stable_baselines3", reason="needs the extra sb3: pip install 'splatrl[sb3]'")

from gymnasium.spaces import Dict
from stable_baselines3 import PPO
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecFrameStack, VecMonitor
from torchrl.envs import StepCounter, TransformedEnv

from splatrl.building import env_makers
from splatrl.envs.gymnasium_env import GymnasiumEnv
from splatrl.envs.gymnasium_vector_env import GymnasiumVectorEnv
from splatrl.envs.stable_baselines import StableBaselinesVecEnv
from splatrl.envs.tasks import Outcome
from tests.envs.rooms import drive_env
from tests.envs.sensors.test_sensors import sensing_env
from tests.envs.tasks.test_navigation import LEFT, STOP, env_of, task_of
from tests.preloaded import start
from tests.tiny import tiny_env, tiny_overrides

FORWARD_X, BACK_X, LEFT_Y, RIGHT_Y, SPIN, SPIN_BACK = range(6)


def batch(count: int = 3, **settings: int) -> StableBaselinesVecEnv:
    return StableBaselinesVecEnv(tiny_env([count], **settings))


def test_a_batch_gives_the_results_of_the_vector_env() -> None:
    env, other = batch(), GymnasiumVectorEnv(tiny_env([3]))
    assert env.observation_space == other.single_observation_space and env.action_space == other.single_action_space
    assert env.seed(4) == [4, 5, 6]
    assert np.array_equal(env.reset(), other.reset(seed=[4, 5, 6])[0])
    for action in (FORWARD_X, SPIN, LEFT_Y, FORWARD_X):
        actions = np.full(3, action)
        seen, reward, done, infos = env.step(actions)
        expected, paid, terminated, truncated, told = other.step(actions)
        assert np.array_equal(seen, expected) and reward.tolist() == pytest.approx(paid.tolist())
        assert np.array_equal(done, terminated | truncated) and reward.dtype == np.float32
        for row in np.flatnonzero(~done):
            assert infos[row]["state"].tolist() == told["state"][row].tolist()


def test_an_episode_ends_with_its_last_view_and_its_outcome() -> None:
    env = batch(3, max_steps=1)
    env.set_options([{"state": state} for state in ([1, 5, 0], [0, 0, 0], [1, 3, 0])])
    env.reset()
    seen, reward, done, infos = env.step(np.array([FORWARD_X, SPIN, FORWARD_X]))
    assert done.all() and reward.tolist() == pytest.approx([50.0, -0.2, -10.0])
    assert [info["outcome"] for info in infos] == [Outcome.GOAL, Outcome.TIMEOUT, Outcome.COLLISION]
    assert [info["TimeLimit.truncated"] for info in infos] == [False, True, False]
    assert [info["is_success"] for info in infos] == [True, False, False]
    single = GymnasiumEnv(tiny_env([1]))
    for row, state in enumerate(([2, 5, 0], [0, 0, 1], [1, 3, 0])):
        last, _ = single.reset(options={"state": state})
        assert np.array_equal(infos[row]["terminal_observation"], last)
        assert infos[row]["state"].tolist() == state
    assert not np.array_equal(seen[0], infos[0]["terminal_observation"])
    for row, begun in enumerate(env.reset_infos):  # of the new episodes, as in Stable-Baselines3's own envs
        assert begun["step_count"] == 0 and np.array_equal(seen[row], single.reset(options=begun)[0])


def test_a_monitor_records_measures_and_a_batch_begins_again_at_its_infos() -> None:
    env = VecMonitor(StableBaselinesVecEnv(env_of(task_of(), (2,))), info_keywords=("spl", "distance_to_goal"))
    env.seed(1)
    first = env.reset()
    env.set_options(env.unwrapped.reset_infos)
    again = env.reset()
    assert all(np.array_equal(again[key], first[key]) for key in first)
    _, _, done, infos = env.step(np.array([STOP, LEFT]))
    assert done.tolist() == [True, False] and infos[0]["is_success"] is False
    assert {"r", "l", "spl", "distance_to_goal"} <= infos[0]["episode"].keys() and infos[0]["episode"]["spl"] == 0.0
    assert infos[1]["goal"].shape == (3,) and "episode" not in infos[1]


def test_an_episode_that_ends_at_the_limit_of_a_step_counter_is_not_truncated_too() -> None:
    env = StableBaselinesVecEnv(TransformedEnv(tiny_env([2]), StepCounter(1, step_count_key="actions")))
    env.set_options([{"state": state} for state in ([1, 5, 0], [0, 0, 0])])
    env.reset()
    _, _, done, infos = env.step(np.array([FORWARD_X, SPIN]))
    assert done.all() and [info["outcome"] for info in infos] == [Outcome.GOAL, Outcome.RUNNING]
    assert [info["TimeLimit.truncated"] for info in infos] == [False, True]


def test_shared_attributes_are_reported_for_each_robot() -> None:
    env = batch()
    assert env.get_attr("render_mode") == ["rgb_array"] * 3 and env.get_attr("num_envs", [1]) == [3]
    assert env.get_attr("action_space") == [env.action_space] * 3
    assert env.get_attr("observation_space", 1) == [env.observation_space]
    assert env.env_is_wrapped(Monitor) == [False] * 3
    env.set_attr("colour", "red")
    assert env.get_attr("colour", 0) == ["red"]
    env.reset()
    assert len(env.get_images()) == 3 and env.render().ndim == 3
    with pytest.raises(ValueError, match="indices: expected all robots, since they share colour, got 1"):
        env.set_attr("colour", "blue", 1)
    with pytest.raises(NotImplementedError, match=r"turn: expected a call on \.vector"):
        env.env_method("turn")
    with pytest.raises(ValueError, match="options: expected 'state' for all robots or for none"):
        env.set_options([{"state": [0, 0, 0]}, {}, {}])
        env.reset()
    env.close()


def test_stable_baselines_wrappers_work_around_a_batch() -> None:
    env = VecMonitor(VecFrameStack(batch(4, max_steps=6), 2))
    assert env.reset().shape == (4, 12, 16, 6)
    lengths = []
    for _ in range(20):
        *_, infos = env.step(np.full(4, SPIN))
        lengths += [info["episode"]["l"] for info in infos if "episode" in info]
    assert len(lengths) >= 12 and max(lengths) == 6


def test_a_batch_learns() -> None:
    torch.manual_seed(0)
    env = VecMonitor(batch(16, max_steps=12, first=1))
    model = PPO("MlpPolicy", env, 1e-3, n_steps=16, batch_size=64, gamma=0.9, ent_coef=0.01, seed=0, device="cpu")
    model.learn(2048)
    mean, _ = evaluate_policy(model, env, n_eval_episodes=64, deterministic=False)
    assert mean > 28  # a policy that has not learned reaches 14 ± 4


def test_a_batch_with_wheels_learns_too() -> None:
    model = PPO("MlpPolicy", StableBaselinesVecEnv(drive_env([4])), n_steps=8, batch_size=32, n_epochs=1, device="cpu")
    assert model.learn(64).num_timesteps == 64


class Flattened(BaseFeaturesExtractor):
    """Concatenates all observations into one vector."""

    def __init__(self, space: Dict):
        super().__init__(space, sum(int(np.prod(one.shape)) for one in space.values()))

    def forward(self, observed: dict[str, torch.Tensor]) -> torch.Tensor:
        return torch.cat([one.flatten(1) for one in observed.values()], 1)


def test_a_batch_with_sensors_learns_too() -> None:
    env = StableBaselinesVecEnv(sensing_env((4,)))
    flat = {"features_extractor_class": Flattened}  # the views are too small for its convolutions
    model = PPO("MultiInputPolicy", env, policy_kwargs=flat, n_steps=8, batch_size=32, n_epochs=1, device="cpu")
    assert model.learn(64).num_timesteps == 64


def test_subprocesses_run_single_robots(tmp_path: Path) -> None:
    makers = env_makers(2, tiny_overrides(tmp_path), (1,))
    processes = SubprocVecEnv([lambda make=make: GymnasiumEnv(make()) for make in makers], start_method="fork")
    here = DummyVecEnv([lambda make=make: GymnasiumEnv(make()) for make in makers])
    assert np.array_equal(processes.reset(), here.reset())
    for action in (SPIN, FORWARD_X, SPIN):
        assert np.array_equal(processes.step(np.full(2, action))[0], here.step(np.full(2, action))[0])
    processes.close()


def test_without_stable_baselines_one_line_says_what_to_install() -> None:
    program = "import sys; sys.modules['stable_baselines3'] = None\nimport splatrl.envs.stable_baselines"
    said, _ = start("-c", program).communicate(timeout=60)
    assert "ImportError: stable_baselines3 is missing: pip install 'splatrl[sb3]'" in said


def test_stable_baselines_trains_a_single_driving_robot() -> None:
    env = GymnasiumEnv(drive_env())
    model = PPO("MlpPolicy", env, n_steps=32, batch_size=32, n_epochs=1, seed=0, device="cpu").learn(64)
    observation, _ = env.reset(seed=0)
    action, _ = model.predict(observation)
    assert env.action_space.contains(action) and model.num_timesteps == 64


@pytest.mark.slow
def test_stable_baselines_learns_with_a_single_robot() -> None:
    torch.manual_seed(0)
    env = Monitor(GymnasiumEnv(tiny_env([1], max_steps=12, first=1)))
    options = {"n_steps": 128, "batch_size": 64, "n_epochs": 8, "gamma": 0.9, "ent_coef": 0.01}
    model = PPO("MlpPolicy", env, 2e-3, **options, seed=0, device="cpu")
    model.learn(1536)
    success = np.array(env.get_episode_rewards()) > 0
    assert sum(env.get_episode_lengths()) <= 1536
    assert success[-150:].mean() > 0.5  # random actions reach 0.37 ± 0.04
