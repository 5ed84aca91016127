"""Envs that use the GPU kernels, emulated on the CPU and, if there is one, on a GPU."""

from collections.abc import Callable
from functools import cache

import pytest
import torch
from tensordict import TensorDictBase

from splatrl.bodies import Box
from splatrl.collision import NativeChecker, Occupancy
from splatrl.collision.cuda import CudaChecker
from splatrl.curriculum import Curriculum, plan
from splatrl.envs import Robot, SplatEnv
from splatrl.envs.drawing import SceneDrawing
from splatrl.envs.restart import restart
from splatrl.envs.tasks import Fps, Grid, Task
from splatrl.motions import ForwardMotion
from splatrl.renderers import DeviceLatticeRenderer, NativeRenderer
from splatrl.renderers.cuda import CudaRenderer
from tests.emulator import emulated
from tests.envs.devices import NoHostReads
from tests.tiny import BODY, HEIGHT, tiny_gaussians, tiny_motion

ROBOTS = 9
Make = Callable[[str], SplatEnv]


@cache
def occupancy() -> Occupancy:
    """Return the occupancy of the room."""
    return Occupancy.from_gaussians(tiny_gaussians(), resolution=0.1)


def task_of(name: str) -> Task:
    """Make a task with one of the two kinds of motion, on a lattice or off it."""
    if name == "grid":
        return Grid(tiny_motion(), goal=(0.5, 1.0, 0.0), max_steps=7)
    motion = ForwardMotion(HEIGHT, 0.25, 30.0, (-1.0, -1.5), (1.0, 1.5))
    return Fps(motion, goal=(0.5, 1.0, 0.0), max_steps=7)


def env_of(name: str, device: torch.device | str, renderer: object, checker: object) -> SplatEnv:
    """Make an env of robots in the room, the same on both devices."""
    task, box = task_of(name), Box(BODY.size)
    found = plan(task.motion, NativeChecker(occupancy(), box), task.reached)
    robot = Robot(box, HEIGHT, image_width=16, image_height=12)
    curriculum = Curriculum(found, None)
    return SplatEnv(SceneDrawing(renderer), checker, robot, task, curriculum, [ROBOTS], 0, device)


def on_cpu(name: str) -> SplatEnv:
    """Make an env with the CPU's renderer and checker."""
    return env_of(name, "cpu", NativeRenderer(tiny_gaussians()), NativeChecker(occupancy(), Box(BODY.size)))


@pytest.fixture(params=["emulated", pytest.param("gpu", marks=pytest.mark.gpu)])
def make(request: pytest.FixtureRequest) -> Make:
    """Return a function that makes envs with the GPU's renderer and checker."""
    body = Box(BODY.size)
    if request.param == "gpu":
        device = request.getfixturevalue("cuda_device")
        renderer, checker = CudaRenderer(tiny_gaussians(), device=device), CudaChecker(occupancy(), body, device)
    else:
        device, renderer = "cpu", CudaRenderer(tiny_gaussians(), load=emulated)
        checker = CudaChecker(occupancy(), body, load=emulated)
    album = DeviceLatticeRenderer(renderer, 2**20)  # where views repeat
    return lambda name: env_of(name, device, album if name == "grid" else renderer, checker)


def walked(env: SplatEnv, steps: int) -> list[TensorDictBase]:
    """Take steps with automatic resets, with starts and actions that do not depend on the device."""
    g = torch.Generator().manual_seed(3)
    states = env.task.motion.states()
    first = states[torch.randint(len(states), (ROBOTS,), generator=g).to(states.device)]
    now = env.reset(env._reset().set("state", first), set_state=True)
    found = []
    for _ in range(steps):
        action = torch.randint(env.action_spec.space.n, (ROBOTS,), generator=g).to(env.device)
        stepped = env.step(now.set("action", action))
        found.append(stepped["next"].cpu())
        now = restart(env, stepped["next"])
        start = states[torch.randint(len(states), (ROBOTS,), generator=g).to(states.device)]
        now["state"] = torch.where(stepped["next", "done"], start, now["state"])  # the devices' generators differ
    return found


@pytest.mark.parametrize("name", ["grid", "fps"])
def test_robots_move_as_they_do_on_a_cpu(make: Make, name: str) -> None:
    env = make(name)
    here, there = walked(on_cpu(name), 24), walked(env, 24)
    env.raise_faults()
    outcomes = torch.stack([step["outcome"] for step in here])
    assert len(outcomes.unique()) >= 4  # of five outcomes
    for ours, theirs in zip(here, there, strict=True):
        for key in ("outcome", "reward", "done", "terminated", "truncated", "step_count"):
            assert torch.equal(ours[key], theirs[key]), key
        for key in ("state", "free_fraction", "episode_return"):
            torch.testing.assert_close(ours[key], theirs[key], atol=1e-5, rtol=1e-5)
        assert ((ours["pixels"].int() - theirs["pixels"].int()).abs() <= 1).float().mean() > 0.999


def test_steps_and_resets_read_nothing_on_the_host(make: Make) -> None:
    env = make("grid")
    now = env.reset()
    action = torch.zeros(ROBOTS, dtype=torch.int64, device=env.device)
    with NoHostReads():
        for _ in range(3):
            stepped = env.step(now.set("action", action))
            now = restart(env, stepped["next"])
    assert env.capturable
    env.raise_faults()


def test_a_non_finite_pose_is_reported_when_faults_are_raised(make: Make) -> None:
    env = make("fps")
    now = env.reset()
    now["state"][4, 0] = torch.nan
    env.step(now.set("action", torch.zeros(ROBOTS, dtype=torch.int64, device=env.device)))
    with pytest.raises(ValueError, match="4"):
        env.raise_faults()
    with pytest.raises(ValueError, match="4"):  # the renderer's fault, and then the checker's
        env.raise_faults()
    env.raise_faults()
