"""``torch.compile`` works on env steps and on single calls into the core, and changes no result."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import torch
from torch import Tensor

from splatrl.building import build_world, make_env
from splatrl.configuration import load_config
from tests.envs.contract import assert_same
from tests.tiny import tiny_motion, tiny_overrides, tiny_robot

CHOICES = {
    "grid": [],
    "snake": [
        "transforms/pose_noise=uniform",
        "transforms/appearance=varied",
        "memory=stack",
        "transforms/skip=four",
        "transforms.skip.steps=2",
    ],
}


@pytest.fixture(autouse=True)
def fresh() -> Iterator[None]:
    yield
    torch._dynamo.reset()


@pytest.mark.parametrize("task", ["grid", pytest.param("snake", marks=pytest.mark.slow)])
def test_a_compiled_step_gives_the_same_bytes(task: str, tmp_path: Path) -> None:
    env = make_env([*tiny_overrides(tmp_path, task), *CHOICES[task]], [3])
    runs = []
    for step in (torch.compile(env.step, backend="eager"), env.step):
        env.set_seed(0)
        torch.manual_seed(0)
        td = env.reset()
        for _ in range(4):
            td = env.step_mdp(step(env.rand_action(td)))
        runs.append(td)
    assert_same(*runs)


def test_core_calls_between_compiled_graphs_give_the_same_results(tmp_path: Path) -> None:
    world = build_world(load_config(tiny_overrides(tmp_path)))
    states = torch.tensor([[1, 3, 0], [0, 0, 0]])
    poses = tiny_motion().body_to_world(states)
    ahead = tiny_motion().body_to_world(states + torch.tensor([1, 0, 0]))
    cameras = tiny_robot().cameras(poses)
    calls: list[Callable[[], Tensor]] = [
        lambda: world.checker.free_fraction(poses + 0, ahead + 0) * 2,
        lambda: world.checker.sweeps(poses + 0, ahead + 0) ^ True,
        lambda: world.checker.collides(poses + 0) ^ True,
        lambda: world.checker.clearance(poses[:, :3, 3] + 0) * 2,
        lambda: world.drawing.renderer.pixels(cameras) + 1,
    ]
    for call in calls:
        assert torch.equal(torch.compile(call, backend="eager")(), call())
