"""Workers begin in different states, and each has its own curriculum."""

import subprocess
import sys
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import torch
from torchrl.collectors import Collector
from torchrl.envs import EnvBase, EnvCreator, ParallelEnv, SerialEnv

from splatrl.building import build_world, env_makers, make_env, worker_seed
from splatrl.configuration import load_config
from splatrl.datasets import planner_episodes, write_demonstrations
from splatrl.envs.nesting import layers
from tests.tiny import tiny_overrides

PAGE = (Path(__file__).parents[2] / "docs" / "clients.md").read_text()
SNIPPETS = [block.split("```")[0] for block in PAGE.split("```python\n")[1:]]


def begun(env: EnvBase) -> list[list[Any]]:
    """Reset an env and return where the robots of each worker begin."""
    return env.reset()["state"].tolist()


def in_processes(makers: Any) -> ParallelEnv:
    return ParallelEnv(2, makers, mp_start_method="fork")


def test_workers_without_a_seed_begin_in_different_states(tmp_path: Path) -> None:
    make = partial(make_env, tiny_overrides(tmp_path), (5,))
    env = in_processes(make)
    first, second = begun(env)
    env.close()
    assert first != second
    assert begun(make()) == begun(make()) == begun(make_env(tiny_overrides(tmp_path), (5,), 0))  # the main process


@pytest.mark.filterwarnings("ignore:A lambda function was passed")
@pytest.mark.parametrize("kind", [EnvCreator, lambda make: lambda: make()])
def test_workers_of_an_env_creator_or_a_lambda_begin_in_different_states(kind: Any, tmp_path: Path) -> None:
    env = in_processes(kind(partial(make_env, tiny_overrides(tmp_path), (5,))))
    first, second = begun(env)
    env.close()
    assert first != second


def test_a_collector_takes_an_env_creator(tmp_path: Path) -> None:
    creator = EnvCreator(partial(make_env, [*tiny_overrides(tmp_path), "transforms/pose_noise=uniform"], (3,)))
    collector = Collector(creator, None, frames_per_batch=6, total_frames=6)
    assert [batch.shape for batch in collector] == [(3, 2)]
    collector.shutdown()


def test_workers_that_are_given_a_seed_use_it(tmp_path: Path) -> None:
    make = partial(make_env, tiny_overrides(tmp_path), (5,), 3)
    env = in_processes(make)
    states = begun(env)
    env.close()
    assert states == [begun(make())] * 2


def test_env_makers_give_the_same_workers_in_parallel_and_in_series(tmp_path: Path) -> None:
    makers = env_makers(2, tiny_overrides(tmp_path), (5,), seed=4)
    parallel, serial = in_processes(makers), SerialEnv(2, makers)
    states = begun(parallel)
    parallel.close()
    assert begun(serial) == states == [begun(make()) for make in makers]
    assert states[0] != states[1]
    assert states[0] != begun(env_makers(2, tiny_overrides(tmp_path), (5,), seed=5)[0]())


def test_worker_seeds_differ_and_fit_into_63_bits() -> None:
    seeds = [worker_seed(seed, *worker) for seed in range(20) for worker in ((), (0,), (1,), (2,), (1, 1), (1, 2))]
    assert len(set(seeds)) == len(seeds) and all(0 <= seed < 2**63 for seed in seeds)
    assert worker_seed(0, 1) == worker_seed(0, 1)


@pytest.mark.parametrize(
    ("workers", "seed", "key"), [(0, 0, "workers"), (1.5, 0, "workers"), (2, -1, "seed"), (2, 0.5, "seed")]
)
def test_an_invalid_number_of_workers_or_seed_is_refused(workers: int, seed: int, key: str) -> None:
    with pytest.raises(ValueError, match=f"{key}: expected a whole number"):
        env_makers(workers, seed=seed)


def test_overrides_that_are_no_list_are_refused_before_a_worker_starts() -> None:
    with pytest.raises(ValueError, match=r"^overrides: expected a list of texts such as .*, got 'task=grid'$"):
        env_makers(2, "task=grid")


def test_each_worker_has_a_curriculum_of_its_own(tmp_path: Path) -> None:
    env = SerialEnv(2, env_makers(2, [*tiny_overrides(tmp_path), "curriculum.window=1"], (1,)))
    env.reset()
    first, second = (layers(one)[0].curriculum for one in env._envs)
    first.record(torch.zeros(1), torch.ones(1, dtype=torch.bool), torch.ones(1, dtype=torch.bool))
    assert (first.level, second.level) == (1, 0)
    assert env.reset()["level"].flatten().tolist() == [1, 0]
    saved = env.state_dict()
    other = SerialEnv(2, env_makers(2, [*tiny_overrides(tmp_path), "curriculum.window=1"], (1,), seed=9))
    other.reset()
    other.load_state_dict(saved)
    assert [int(layers(one)[0].curriculum.level) for one in other._envs] == [1, 0]


WITH_WORKERS = [pytest.mark.slow]  # each worker imports all libraries anew


@pytest.mark.parametrize(
    "snippet",
    [
        pytest.param(snippet, marks=WITH_WORKERS if "__main__" in snippet else [], id=str(number))
        for number, snippet in enumerate(SNIPPETS)
    ],
)
def test_a_snippet_of_the_clients_page_runs(snippet: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    if "demos/" in snippet:
        world = build_world(load_config(tiny_overrides(tmp_path)))
        (tmp_path / "demos").mkdir()
        write_demonstrations(tmp_path / "demos", planner_episodes(world, 6))
    if "__main__" not in snippet:
        exec(compile(snippet, "clients.md", "exec"), {})
        return
    (tmp_path / "snippet.py").write_text(snippet)  # its workers import it
    done = subprocess.run([sys.executable, "snippet.py"], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
