"""Gymnasium makes envs of the tasks by ID."""

import warnings
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import splatrl
from splatrl.configuration import load_config, options
from splatrl.envs import GymnasiumEnv, GymnasiumVectorEnv
from splatrl.envs.nesting import layers
from splatrl.gymnasium_ids import TASKS, gymnasium_id
from tests.preloaded import start
from tests.tiny import tiny_overrides
from tests.two_rooms import in_both


def room(folder: Path, task: str = "grid") -> dict[str, Any]:
    """Write the tiny room, and return the arguments with which ``gymnasium.make`` builds it."""
    given = [each for each in tiny_overrides(folder, task) if not each.startswith(("task=", "scene"))]
    return {"scene": str(folder / "tiny.ply"), "overrides": given}


def test_every_task_has_an_id() -> None:
    assert sorted(TASKS) == sorted(options("task"))
    assert gymnasium_id("polar_plane") == "splatrl/PolarPlane-v0"
    registered = [name for name in gymnasium.registry if name.startswith("splatrl/")]
    assert registered == [gymnasium_id(task) for task in TASKS]


@pytest.mark.parametrize("task", ["grid", "drive", "circle"])
def test_gymnasiums_checker_finds_no_faults(task: str, tmp_path: Path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = gymnasium.make(gymnasium_id(task), render_mode="rgb_array", **room(tmp_path, task))
        assert isinstance(env.unwrapped, GymnasiumEnv)
        check_env(env.unwrapped)
        observation, _ = env.reset(seed=0)
        assert np.array_equal(env.render(), observation)


def test_an_env_made_by_id_equals_the_one_that_the_library_makes(tmp_path: Path) -> None:
    env = gymnasium.make("splatrl/Grid-v0", seed=3, **room(tmp_path))
    assert env.unwrapped.render_mode is None
    seen, info = env.reset()
    expected, told = GymnasiumEnv(splatrl.make_env(tiny_overrides(tmp_path), [1], seed=3)).reset()
    assert np.array_equal(seen, expected) and np.array_equal(info["state"], told["state"])


def test_without_a_seed_envs_begin_differently(tmp_path: Path) -> None:
    def starts(seed: int | None = None) -> list[Any]:
        env = gymnasium.make("splatrl/Grid-v0", seed=seed, **room(tmp_path))
        batch = gymnasium.make_vec("splatrl/Grid-v0", num_envs=2, seed=seed, **room(tmp_path))
        return [*(env.reset()[1]["state"].tolist() for _ in range(8)), *batch.reset()[1]["state"].tolist()]

    assert starts() != starts()
    assert starts(3) == starts(3)


def test_several_scenes_and_generated_scenes_can_be_chosen(tmp_path: Path) -> None:
    both = in_both(tmp_path)
    chosen = [each for each in both if not each.startswith(("task=", "scene="))]
    envs = gymnasium.make_vec("splatrl/Grid-v0", num_envs=8, scene="many", overrides=chosen)
    assert isinstance(envs, GymnasiumVectorEnv)
    seen, _ = envs.reset(seed=0)
    expected, _ = GymnasiumVectorEnv(splatrl.make_env(both, [8])).reset(seed=0)
    assert np.array_equal(seen, expected)
    assert load_config(["scene='yard'", "scene.seed=3"]) == load_config(["scene=yard", "scene.seed=3"])


def test_a_batch_is_one_env_that_steps_all_robots(tmp_path: Path) -> None:
    envs = gymnasium.make_vec("splatrl/Grid-v0", num_envs=3, **room(tmp_path))
    assert isinstance(envs, GymnasiumVectorEnv)
    seen, _ = envs.reset(seed=0)
    assert seen.shape == (3, 12, 16, 3)
    _, reward, *_ = envs.step(np.array([4, 4, 5]))
    assert reward.shape == (3,)
    slow = gymnasium.make_vec("splatrl/Grid-v0", num_envs=2, vectorization_mode="sync", **room(tmp_path))
    assert slow.reset(seed=0)[0].shape == (2, 12, 16, 3)


@pytest.mark.parametrize("vectorized", [False, True])
def test_gymnasiums_limit_of_steps_ends_episodes_that_the_curriculum_counts(tmp_path: Path, vectorized: bool) -> None:
    chosen = room(tmp_path)
    chosen["overrides"] += ["curriculum.first=null", "curriculum.window=40", "task.max_steps=1000"]
    if vectorized:
        envs = gymnasium.make_vec("splatrl/Grid-v0", num_envs=1, max_episode_steps=3, **chosen)
        assert layers(envs.env)[0].task.max_steps == 3
    else:
        envs = gymnasium.make("splatrl/Grid-v0", max_episode_steps=3, **chosen)
    envs.reset(seed=0)
    ends = limits = won = 0
    for _ in range(20):
        _, _, terminated, truncated, info = envs.step(np.array([4]) if vectorized else 4)  # turns on the spot
        if np.any(terminated | truncated):
            ends, limits = ends + 1, limits + np.sum(truncated)
            won += np.sum(info["final_info"]["success"] if vectorized else info["success"])
            if not vectorized:
                envs.reset()
    base = layers((envs if vectorized else envs.unwrapped).env)[0]
    assert limits >= 5 and base.curriculum.progress.tolist() == [0, ends, won]


def test_gymnasium_can_import_the_package_by_itself(tmp_path: Path) -> None:
    asks = f"import gymnasium; print(gymnasium.make('splatrl:splatrl/Circle-v0', **{room(tmp_path, 'circle')}).spec.id)"
    said, _ = start("-c", asks, bare=True).communicate(60)
    assert said.split() == ["splatrl/Circle-v0"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"scene": "nowhere.ply"}, "scene: expected one of backyard.*or an existing path, got nowhere.ply"),
        ({"overrides": ["seed=-1"]}, "seed: expected a whole number"),
        ({"overrides": ["robot.fov=70"]}, r"robot\.fov: no such key, did you mean robot\.fov_deg"),
        ({"overrides": "robot.fov_deg=70"}, "overrides: expected a list of texts"),
    ],
)
def test_invalid_arguments_are_refused_by_name(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        gymnasium.make("splatrl/Grid-v0", **arguments)
