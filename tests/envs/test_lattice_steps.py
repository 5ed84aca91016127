"""Looked-up steps equal those computed by motion, checker and task, and only steps on the lattice are looked up."""

from collections.abc import Callable
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest
import torch
from tensordict import TensorDict
from torch import Tensor

from splatrl.building import build_world
from splatrl.collision.base import Checker
from splatrl.configuration import load_config
from splatrl.curriculum import Curriculum
from splatrl.envs import SplatEnv, World
from splatrl.envs.drawing import SceneDrawing
from splatrl.envs.lattice_steps import suits
from splatrl.envs.tasks import Grid, Outcome, Step, Verdict
from splatrl.envs.tasks.base import Anywhere
from splatrl.motions import LatticeMotion
from splatrl.motions.base import Move
from tests.envs.contract import assert_same, base_env
from tests.envs.devices import Painter
from tests.tiny import tiny_env, tiny_motion, tiny_overrides


@cache
def world(task: str) -> World:
    """Build the tiny room with a task."""
    coarse = ["task.motion.angle_step_deg=30"] if task == "hemisphere" else []  # a ninth of its states
    with TemporaryDirectory() as folder:
        return build_world(load_config([*tiny_overrides(Path(folder), task), "task.max_steps=6", *coarse]))


def pair(task: str, batch: int, **curriculum: Any) -> tuple[SplatEnv, SplatEnv]:
    """Make an env that looks its steps up and one that computes them, both with painted views."""
    envs = []
    for _ in range(2):
        env = base_env(world(task).env(batch, Curriculum(world(task).plan, **curriculum)))
        env.drawing = SceneDrawing(Painter())
        envs.append(env)
    envs[1].lattice_steps = None
    return envs[0], envs[1]


def assert_same_counts(env: SplatEnv, other: SplatEnv) -> None:
    for key in ("progress", "cohort"):
        assert torch.equal(*(getattr(one.curriculum, key) for one in (env, other))), key


@pytest.mark.parametrize("shaken", [False, True])
@pytest.mark.parametrize("task", ["grid", "circle", "polar_plane", "hemisphere"])
def test_every_looked_up_step_equals_the_computed_one(task: str, shaken: bool) -> None:
    motion = world(task).task.motion
    states, actions = motion.states(), motion.actions()
    count, generator = len(states) * len(actions), torch.Generator().manual_seed(0)

    def drawn(*limits: int) -> Tensor:
        return torch.randint(*limits, (count, 1), generator=generator)

    given = {"state": states.repeat(len(actions), 1), "action": actions.repeat_interleave(len(states))}
    given |= {"step_count": drawn(0, 7), "goals": drawn(0, 2), "level": drawn(-1, 2)}
    given["episode_return"] = torch.rand(count, 1, generator=generator)
    if shaken:
        given["camera_offset"] = 0.01 * torch.rand(count, 6, generator=generator)
    looks_up, takes = pair(task, count, window=count, threshold=0.5)
    for env in (looks_up, takes):
        env.curriculum.begin(torch.ones(count, dtype=torch.bool))
    assert looks_up.lattice_steps is not None
    after, expected = (env.step(TensorDict(given, [count]))["next"] for env in (looks_up, takes))
    assert_same(after, expected)
    assert_same_counts(looks_up, takes)
    assert all(looks_up.curriculum.progress[1:] > 0)
    met = {Outcome.RUNNING, Outcome.GOAL, Outcome.COLLISION, Outcome.TIMEOUT}
    met |= {Outcome.OUT_OF_BOUNDS} if task in ("polar_plane", "hemisphere") else set()  # elsewhere walls end episodes
    assert set(after["outcome"].unique().tolist()) == met


def test_a_non_contiguous_column_of_a_rollout_is_stepped_and_restarted_like_its_copy() -> None:
    looks_up, takes = pair("grid", 6)
    column = takes.rollout(3, break_when_any_done=False)[:, 1]
    assert not column["state"].is_contiguous()
    for env in (looks_up, takes):
        env.curriculum = Curriculum(world("grid").plan)
        env.set_seed(1)
    given = column.exclude("next", "pixels")
    assert_same(looks_up.step(given.clone(False))["next"], takes.step(given.clone())["next"])
    after, rows = dict(column["next"].items()), torch.tensor([1, 4])
    copied = {key: value.contiguous() for key, value in after.items()}
    assert_same(TensorDict(looks_up.restarted(after, rows), [6]), TensorDict(takes.restarted(copied, rows), [6]))


def test_looked_up_starts_equal_those_of_a_reset() -> None:
    envs = pair("grid", 6, first=1)
    torch.manual_seed(0)
    stepped = envs[0].step(envs[0].rand_action(envs[0].reset()))
    envs[1].load_state_dict(envs[0].state_dict())
    after = envs[0].step_mdp(stepped)
    for done in ([0, 1, 0, 0, 1, 1], [1] * 6, [0] * 6):
        after["done"] = after["terminated"] = torch.tensor(done).bool().unsqueeze(1)
        for env in envs:
            env.curriculum.progress[0] = 2
        assert_same(*(env.maybe_reset(after.clone()) for env in envs))
        assert_same_counts(*envs)
        assert torch.equal(*(env.generator.get_state() for env in envs))


def test_starts_after_a_lower_threshold_was_set_are_of_the_next_level_whether_looked_up_or_not() -> None:
    strict, after, envs = (
        pair("grid", 4, first=1, threshold=1.0, window=4)[0],
        [],
        pair("grid", 4, first=1, threshold=0.5, window=4),
    )
    td = strict.reset()
    strict.curriculum.progress.copy_(torch.tensor([0, 2, 2]))
    strict.curriculum.cohort.copy_(torch.tensor([False, False, True, True]))
    td["done"] = td["terminated"] = torch.tensor([True, True, False, False]).unsqueeze(1)
    for env in envs:
        env.load_state_dict(strict.state_dict())
        after.append(env.maybe_reset(td.clone()))
    assert_same(*after)
    assert_same_counts(*envs)
    assert after[0]["level"].flatten().tolist() == [1, 1, 0, 0]
    assert envs[0].curriculum.progress.tolist() == [1, 0, 0]


def test_starts_are_not_looked_up_for_entries_of_another_dtype() -> None:
    env = pair("grid", 3)[0]
    after, rows = env.reset(), torch.tensor([1])
    before = env.generator.get_state()
    odd = {**after, "goals": after["goals"].int()}
    assert env.lattice_steps.begin(odd, rows, env.generator) is None
    assert torch.equal(env.generator.get_state(), before)
    assert env.lattice_steps.begin({**after}, rows, env.generator) is not None


@pytest.mark.parametrize("batch", [1, 5])
def test_looked_up_rollouts_equal_computed_ones(batch: int) -> None:
    rollouts, envs = [], pair("grid", batch, first=1, threshold=0.1, window=4)
    for env in envs:
        torch.manual_seed(0)
        rollouts.append(env.rollout(200 // batch, break_when_any_done=False))
    assert_same(*rollouts)
    assert_same_counts(*envs)
    assert envs[0].curriculum.level > 1
    assert torch.equal(envs[0].generator.get_state(), envs[1].generator.get_state())


@pytest.mark.parametrize("window", [3, 30])
def test_looked_up_steps_count_robots_that_wait_or_are_cut_off_like_computed_ones(window: int) -> None:
    envs, generator = pair("grid", 5, first=1, threshold=0.3, window=window), torch.Generator().manual_seed(0)
    now, levels = [env.reset() for env in envs], set[int]()
    for _ in range(60):
        action = torch.randint(0, 6, (5,), generator=generator)
        steps, cut = torch.rand(2, 5, 1, generator=generator) < torch.tensor([0.7, 0.2]).view(2, 1, 1)
        for row, env in enumerate(envs):
            after = env.step(now[row].set("action", action.clone()).set("_step", steps))
            ended = env.step_mdp(after).exclude("_step")
            ended["done"] |= cut
            now[row] = env.maybe_reset(ended)
        assert_same(*now)
        assert_same_counts(*envs)
        levels.add(int(envs[0].curriculum.level))
    assert len(levels) > 1


@pytest.mark.parametrize(
    "changed",
    [
        {"state": torch.tensor([[2, 3, 8], [0, 0, 0]])},
        {"state": torch.tensor([[0, 0, 0], [0, -1, 0]])},
        {"action": torch.tensor([0, 6])},
        {"action": torch.tensor([0.0, 1.0])},
        {"episode_return": torch.zeros(2, 1, dtype=torch.float64)},
        {"goals": torch.zeros(2, 3, dtype=torch.int64)},
    ],
)
def test_inputs_off_the_lattice_are_not_looked_up_and_change_nothing(changed: dict[str, Tensor]) -> None:
    env = tiny_env((2,), window=1)
    td = env.rand_action(env.reset())
    before, running = env.curriculum.progress.clone(), env.curriculum.cohort.clone()
    assert env.lattice_steps.step(td.clone().update(changed)) is None
    assert torch.equal(env.curriculum.progress, before) and torch.equal(env.curriculum.cohort, running)
    assert env.lattice_steps.step(td) is not None


def test_a_looked_up_step_leaves_its_input_unchanged_and_accepts_strided_memory() -> None:
    env = tiny_env((3,))
    td = env.rand_action(env.reset())
    wide = TensorDict({key: torch.stack([value, value], 1) for key, value in td.items()}, [3, 2])[:, 0]
    kept = td.clone()
    assert not wide["state"].is_contiguous()
    assert_same(env.step(wide.clone(False))["next"], env.step(td.clone(False))["next"])
    assert_same(td, kept)


class ByPicture(Grid):
    """A grid task whose verdict may depend on the image."""

    def judge(self, step: Step, anywhere: Anywhere) -> Verdict:
        return super().judge(step, anywhere)


class Elsewhere(Grid):
    """A grid task that changes where episodes begin."""

    def start(self, state: Tensor, anywhere: Anywhere) -> Tensor:
        return state.flip(0)


class Slipping(LatticeMotion):
    """A motion that does not always carry out the given action."""

    def move(self, state: Tensor, action: Tensor, checker: Checker) -> Move:
        return super().move(state, action.roll(1), checker)


class Deaf(Curriculum):
    """A curriculum that records no episode."""

    def record(self, level: Tensor, finished: Tensor, success: Tensor) -> None:
        pass


@pytest.mark.parametrize(
    ("make_task", "looked_up"),
    [
        (lambda: Grid(tiny_motion(), (0.5, 1.0, 0.0)), True),
        (lambda: ByPicture(tiny_motion(), (0.5, 1.0, 0.0)), False),
        (lambda: Elsewhere(tiny_motion(), (0.5, 1.0, 0.0)), False),
        (lambda: Grid(Slipping(0.5, 0.5, 45.0), (0.5, 1.0, 0.0)), False),
        (lambda: Grid(LatticeMotion(0.5, 0.01, 1.0), (0.5, 1.0, 0.0)), False),  # too many states
    ],
)
def test_only_steps_that_depend_on_state_and_action_alone_are_looked_up(
    make_task: Callable[[], Grid], looked_up: bool
) -> None:
    env = tiny_env((2,))
    assert suits(make_task(), env.curriculum) is looked_up
    assert not suits(make_task(), Deaf(world("grid").plan))
