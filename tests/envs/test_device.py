"""Neither a step nor the automatic reset of finished robots makes the host wait for the device."""

from collections.abc import Iterator
from copy import copy
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.envs import EnvBase

from splatrl.building import build_world
from splatrl.configuration import load_config
from splatrl.curriculum import Curriculum
from splatrl.device_faults import FaultFlag
from splatrl.envs.drawing import billboard
from splatrl.envs.restart import restart
from splatrl.envs.transforms import appearance, episode_look, weather_images
from splatrl.envs.world import World
from splatrl.training import trunk
from tests.envs.contract import assert_same, base_env
from tests.envs.devices import (
    HostReadError,
    NoHostReads,
    NoTransfers,
    Painter,
    SquareChecker,
    pretend_device,
)
from tests.envs.transforms.views import transformed
from tests.tiny import LONG_STEPS, WALKING, CountingRenderer, tiny_env, tiny_overrides

SHAKEN = ["transforms/pose_noise=unsteady", "transforms/appearance=varied"]
WORLDS = {
    "grid": ["grid"],
    "fps": ["fps"],
    "drive": ["drive"],
    "circle": ["circle"],
    "hemisphere": ["hemisphere"],
    "apple": ["apple"],
    "snake": ["snake"],
    "poster": ["poster"],
    "shaken sim2real": ["sim2real", *SHAKEN],
    "rainy fps": ["fps", "transforms/appearance=weather"],
    "remembering fps": ["fps", "memory=gru", "transforms/appearance=weather"],
    "stacking grid": ["grid", "memory=stack"],
    "late pointnav": [
        "pointnav",
        "transforms/latency=varied",
        "transforms/appearance=weather",
        "sensors=[rgb,depth,pointgoal,gps,compass]",
    ],
    "skipping grid": ["grid", "transforms/pose_noise=unsteady", "transforms/skip=four"],
    "skipping snake": ["snake", "transforms/pose_noise=unsteady", "transforms/skip=four"],
}
SIMILAR = ("fps", "circle", "hemisphere", "apple", "snake", "poster", "rainy fps", "stacking grid", "skipping grid")
"""Worlds of which every part also occurs in another one; they are tested with ``-m slow``."""
NAMES = [pytest.param(name, marks=[pytest.mark.slow] if name in SIMILAR else []) for name in WORLDS]


@cache
def world(name: str) -> World:
    """Build the tiny room with the task of this name."""
    task, *more = WORLDS[name]
    with TemporaryDirectory() as folder:
        steps = LONG_STEPS if task in WALKING else ()
        return build_world(load_config([*tiny_overrides(Path(folder), task), *more, *steps, "task.max_steps=5"]))


def made(name: str, batch: int = 5, device: str = "cpu") -> EnvBase:
    """Make an env that works as it does on a GPU, with a renderer and a checker that never synchronise."""
    env = world(name).env(batch, Curriculum(world(name).plan, 2, threshold=0.01, window=10**6), 1, device)
    base = base_env(env)
    base.drawing = copy(base.drawing)  # the world keeps its own
    base.drawing.renderer, base.checker = Painter(), SquareChecker()
    base.lattice_steps = None  # a GPU does not look steps up
    return env


@pytest.fixture
def whole_overlay(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make code that is special-cased on a CPU work as on a GPU: on all pixels and rows, and in PyTorch."""
    monkeypatch.setattr(billboard, "_points", lambda inside: torch.arange(len(inside), device=inside.device))
    monkeypatch.setattr(episode_look, "_wanted", lambda mask: None)
    for module in (appearance, weather_images):
        monkeypatch.setattr(module, "in_core", lambda images: False)
    monkeypatch.setattr(trunk, "_by_core", lambda images: False)


def steps(env: EnvBase, count: int, seed: int = 0) -> Iterator[TensorDictBase]:
    """Yield random steps with automatic resets, each with its input and output."""
    torch.manual_seed(seed)
    now = env.reset()
    for _ in range(count):
        stepped = env.step(env.rand_action(now))
        yield stepped
        now = restart(env, stepped["next"])


@pytest.mark.parametrize("name", NAMES)
def test_steps_and_resets_leave_nothing_on_the_cpu_and_fetch_nothing_from_it(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    pretend_device(monkeypatch)
    env = made(name, device="meta")
    now = env._reset(set_state=False)  # TorchRL's reset synchronises to check whether anything is done
    action = env.action_spec.zero()
    for watch in (False, True):  # one-off copies happen in the first step
        with NoTransfers() if watch else torch.no_grad():
            stepped = env.step(now.clone().set("action", action))
            again = restart(env, stepped["next"])
        assert {value.device.type for value in stepped.values(True, True)} == {"meta"}
        assert {value.device.type for value in again.values()} == {"meta"}


@pytest.mark.usefixtures("whole_overlay")
@pytest.mark.parametrize("name", NAMES)
def test_an_automatic_reset_equals_torchrls_without_host_reads(name: str) -> None:
    mine, theirs = made(name), made(name)
    torch.manual_seed(0)
    now, expected = mine.reset(), theirs.reset()
    count = 0
    for _ in range(8):
        action = mine.rand_action(now)["action"]
        other = theirs.step(expected.set("action", action.clone()))
        with NoHostReads():
            stepped = mine.step(now.set("action", action))
            before = stepped["next"].clone()
            now = restart(mine, stepped["next"])
        assert_same(before, other["next"])
        assert_same(stepped["next"], before)
        expected = theirs.step_mdp(other)
        expected = theirs.reset(expected.set("_reset", expected["done"].clone()), select_reset_only=True)
        assert_same(now, expected.select(*now.keys()))
        ended = before["done"].squeeze(1)
        assert (now["step_count"][ended] == 0).all() and not now["done"].any()
        count += int(ended.sum())
    assert count > 0 and base_env(mine).curriculum.progress[1] == count
    assert torch.equal(base_env(mine).generator.get_state(), base_env(theirs).generator.get_state())


def test_an_automatic_reset_renders_only_finished_robots() -> None:
    env = transformed((4,))
    base_env(env).drawing.renderer = counting = CountingRenderer(base_env(env).drawing.renderer)
    stepped = env.step(env.rand_action(env.reset()))
    stepped["next", "done"][1] = stepped["next", "terminated"][1] = True
    before = counting.rendered
    env._reset(TensorDict({"_reset": stepped["next", "done"]}, [4]), set_state=False)
    assert counting.rendered - before == stepped["next", "done"].sum()


@pytest.mark.parametrize("device", ["cpu", "meta"])
def test_moving_an_env_moves_all_its_tensors(device: str, monkeypatch: pytest.MonkeyPatch) -> None:
    pretend_device(monkeypatch)

    env = made("shaken sim2real")
    base = base_env(env)
    moved = env.to(device)
    assert base_env(moved) is base and moved.device.type == device
    assert {value.device.type for value in moved._reset(set_state=False).values()} == {device}
    assert {value.device.type for value in (*base.buffers(), *env.transform.buffers())} == {device}


def test_moving_an_env_restarts_its_generator_from_the_seed(monkeypatch: pytest.MonkeyPatch) -> None:
    pretend_device(monkeypatch)
    env = tiny_env((4,), seed=3)
    first = env.generator.get_state().clone()
    env.reset()
    assert not torch.equal(env.generator.get_state(), first)
    assert torch.equal(env.to("meta").generator.get_state(), first)


class Refusing(Painter):
    """Records one row as faulty, as a kernel does."""

    def __init__(self) -> None:
        self.fault = FaultFlag("cpu")

    def raise_faults(self) -> None:
        row = self.fault.take()
        if row is not None:
            raise ValueError(f"camera_to_world[{row}]: expected finite values")


def test_faults_recorded_on_a_device_are_raised_once_when_asked_for() -> None:
    env = tiny_env((3,), renderer=Refusing())
    env.raise_faults()
    env.drawing.renderer.fault.flag.fill_(2)
    with pytest.raises(ValueError, match=r"camera_to_world\[2\]: expected finite values"):
        env.raise_faults()
    env.raise_faults()
    tiny_env((3,)).raise_faults()  # other renderers record no faults


@pytest.mark.parametrize(
    "read",
    [
        lambda x: bool(x.any()),
        lambda x: x[x > 1],
        lambda x: x[torch.tensor(1)],
        lambda x: x.index_put((x > 1,), torch.tensor(0.0)),
        lambda x: x.__setitem__(torch.tensor([1]), 0.0),
        lambda x: x.nonzero(),
        lambda x: x.multinomial(1),
        lambda x: x.unique(),
        lambda x: torch.equal(x, x),
    ],
)
def test_a_host_read_is_detected(read: object) -> None:
    with pytest.raises(HostReadError), NoHostReads():
        read(torch.arange(3.0))


@pytest.mark.parametrize(
    "fetch", [lambda x: x + torch.ones(3).to("meta"), lambda x: x[torch.zeros(3).long()], lambda x: x + torch.tensor(2)]
)
def test_a_cpu_tensor_is_detected(fetch: object) -> None:
    with pytest.raises(HostReadError), NoTransfers():
        fetch(torch.zeros(3, device="meta"))
