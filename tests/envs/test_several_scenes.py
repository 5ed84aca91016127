"""Several scenes in one batch: each row equals the same row in its scene alone."""

import pickle
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.envs import EnvBase
from torchrl.envs.utils import check_env_specs

import splatrl
from splatrl.envs import GymnasiumEnv, GymnasiumVectorEnv
from tests.tiny import LONG_STEPS, WALKING
from tests.two_rooms import in_both, overrides, two_rooms

TASKS = ["grid", "fps", "drive", pytest.param("apple", marks=pytest.mark.slow), "snake"]


def steps(task: str) -> Sequence[str]:
    """Return the overrides with which a task's paths are found sooner."""
    return LONG_STEPS if task in WALKING else ()


@pytest.fixture(scope="module", params=TASKS)
def task(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture(scope="module")
def both(task: str, tmp_path_factory: pytest.TempPathFactory) -> EnvBase:
    return splatrl.make_env([*in_both(tmp_path_factory.mktemp("both"), task), *steps(task)], batch_size=[12], seed=3)


@pytest.fixture(scope="module")
def alone(task: str, tmp_path_factory: pytest.TempPathFactory) -> list[EnvBase]:
    rooms = two_rooms(tmp_path_factory.mktemp("alone"))
    return [
        splatrl.make_env([*overrides(task), *steps(task), f"scene={room}"], batch_size=[12], seed=3) for room in rooms
    ]


def test_outputs_match_the_specs(both: EnvBase) -> None:
    check_env_specs(both)


def test_every_row_is_what_it_would_be_in_its_scene_alone(both: EnvBase, alone: list[EnvBase]) -> None:
    torch.manual_seed(0)
    mixed = both.rollout(15, break_when_any_done=False).flatten()
    assert set(mixed["scene"].flatten().tolist()) == {0, 1}
    for scene, env in enumerate(alone):
        for rows in (mixed["scene"].squeeze(1) == scene).nonzero().squeeze(1).split(12):
            steps = mixed[torch.cat([rows, rows[:1].expand(12 - len(rows))])]
            now = env.reset(steps.exclude("next", "scene"), set_state=True)
            assert torch.equal(now["pixels"], steps["pixels"])
            after = env.step(now.set("action", steps["action"]))["next"]
            for key in ("pixels", "state", "reward", "terminated", "outcome", "free_fraction"):
                assert torch.equal(after[key], steps["next", key]), key


def test_episodes_stay_in_their_scene_and_new_ones_are_drawn(both: EnvBase) -> None:
    torch.manual_seed(1)
    steps = both.rollout(30, break_when_any_done=False)
    assert torch.equal(steps["scene"], steps["next", "scene"])
    begins, scene = steps["step_count"][..., 0] == 0, steps["scene"][..., 0]
    assert not (scene[:, 1:] != scene[:, :-1])[~begins[:, 1:]].any()
    assert len(scene[begins].unique()) == 2


def test_gymnasiums_envs_tell_the_scene_and_begin_in_a_given_one(tmp_path: Path) -> None:
    settings = in_both(tmp_path)
    single = GymnasiumEnv(splatrl.make_env(settings, batch_size=[1]))
    batch = GymnasiumVectorEnv(splatrl.make_env(settings, batch_size=[4]))
    seen, info = batch.reset(seed=3)
    assert set(info["scene"].tolist()) == {0, 1} and info["_scene"].all()
    for row in range(4):
        chosen = {key: info[key][row] for key in ("state", "scene")}
        again, told = single.reset(options=chosen)
        assert np.array_equal(again, seen[row])
        assert told["state"].tolist() == info["state"][row].tolist() and told["scene"] == info["scene"][row]
    assert np.array_equal(batch.reset(options={key: info[key] for key in ("state", "scene")})[0], seen)
    with pytest.raises(ValueError, match=r"options: expected 'state' and 'scene', got \['state'\]"):
        single.reset(options={"state": told["state"]})
    with pytest.raises(
        ValueError, match=r"options\['scene'\]: expected shape \[1, 1\] and values within bounds, got 2"
    ):
        single.reset(options={"state": told["state"], "scene": 2})


def test_the_same_seed_gives_the_same_scenes(both: EnvBase) -> None:
    first, again = (both.set_seed(seed) and both.reset() for seed in (5, 5))
    assert torch.equal(first["scene"], again["scene"]) and torch.equal(first["pixels"], again["pixels"])
    both.set_seed(6)
    assert not torch.equal(first["state"], both.reset()["state"])


def test_a_row_with_its_own_seed_draws_scene_and_start_from_it(both: EnvBase) -> None:
    seeds = [None] * 5 + [11] + [None] * 6
    first, again = both.reset(seeds=seeds), both.reset(seeds=[11] * 12)
    for key in ("scene", "state"):
        assert (again[key] == first[key][5]).all()


@pytest.fixture(scope="module")
def grid(tmp_path_factory: pytest.TempPathFactory) -> EnvBase:
    return splatrl.make_env(in_both(tmp_path_factory.mktemp("grid")), batch_size=[4], seed=0)


def given(env: EnvBase, **values: torch.Tensor) -> TensorDictBase:
    state = torch.zeros(4, 3, dtype=torch.int64)
    return TensorDict({"state": state, **values}, batch_size=env.batch_size)


@pytest.mark.parametrize(
    ("scene", "message"),
    [
        (None, r"scene: expected torch.int64 \[B, 1\] along with the state, got None"),
        (torch.zeros(4, 1), r"scene: expected torch.int64 .* got torch.float32"),
        (torch.zeros(4, 2, dtype=torch.int64), r"scene: expected torch.int64 .* got torch.int64 \[4, 2\]"),
        (torch.tensor([[0], [1], [2], [0]]), "scene: expected an index from 0 to 1, got 2"),
        (torch.tensor([[0], [-1], [0], [0]]), "scene: expected an index from 0 to 1, got -1"),
    ],
)
def test_a_state_without_its_scene_is_refused(grid: EnvBase, scene: torch.Tensor | None, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        grid.reset(given(grid, **({} if scene is None else {"scene": scene})), set_state=True)


def test_some_rows_are_reset_while_the_others_keep_their_scene(grid: EnvBase) -> None:
    td = grid.reset()
    before = td.clone()
    td["_reset"] = torch.tensor([[True], [False], [False], [True]])
    after = grid.reset(td)
    for key in ("scene", "state", "pixels"):
        assert torch.equal(after[key][1:3], before[key][1:3])


def test_an_env_in_several_scenes_is_pickled_by_its_config(grid: EnvBase) -> None:
    copy = pickle.loads(pickle.dumps(grid))
    assert len(pickle.dumps(grid)) < 50_000
    for key in ("scene", "state", "pixels"):
        assert torch.equal(copy.reset()[key], grid.reset()[key])
