"""The env contract on a GPU, in worlds that are built for it."""

from collections.abc import Iterator

import pytest
import torch
from torchrl.envs import EnvBase

from splatrl.building import build_world
from splatrl.collision.cuda import CudaChecker
from splatrl.configuration import load_config
from splatrl.curriculum import Curriculum
from splatrl.envs import SplatEnv
from splatrl.envs.world import World
from splatrl.renderers import DeviceLatticeRenderer
from splatrl.renderers.cuda import CudaRenderer
from tests.envs.contract import EnvContract, base_env
from tests.tiny import tiny_env, tiny_gaussians, tiny_overrides

pytestmark = pytest.mark.gpu


class OnAGpu(EnvContract):
    """The contract on a GPU for a task of the tiny room."""

    world: World
    task: str
    changes: tuple[str, ...] = ()

    @pytest.fixture(autouse=True, scope="class")
    @classmethod
    def build(cls, tmp_path_factory: pytest.TempPathFactory, cuda_device: torch.device) -> Iterator[None]:
        given = [*tiny_overrides(tmp_path_factory.mktemp("room"), cls.task), *cls.changes, "task.max_steps=12"]
        cls.world = build_world(load_config([*(o for o in given if o != "device=cpu"), "device=cuda"]))
        yield
        del cls.world

    def make(self, batch_size: tuple[int], seed: int = 0) -> EnvBase:
        return self.world.env(batch_size[0], Curriculum(self.world.plan, first=3, threshold=0.01, window=5), seed)

    def test_everything_is_on_the_gpu(self) -> None:
        env = self.make((3,))
        base = base_env(env)
        renderer = base.drawing.renderer
        assert isinstance(renderer.renderer if isinstance(renderer, DeviceLatticeRenderer) else renderer, CudaRenderer)
        assert base.generator.device.type == "cuda"
        assert {value.device.type for value in env.rollout(2).values(True, True)} == {"cuda"}


class TestGrid(OnAGpu):
    task = "grid"

    def test_the_checker_runs_on_the_gpu(self) -> None:
        assert isinstance(base_env(self.make((3,))).checker, CudaChecker)


class TestDrive(OnAGpu):
    task = "drive"


class TestApple(OnAGpu):
    task, changes = "apple", ("collision=auto",)


def test_an_env_moves_to_the_gpu_and_goes_on_there(cuda_device: torch.device) -> None:
    env = tiny_env((5,), max_steps=6)
    moved = env.to(cuda_device)
    assert moved is env and isinstance(env, SplatEnv) and env.generator.device.type == "cuda"
    env.drawing.renderer = CudaRenderer(tiny_gaussians(), device=cuda_device)
    batch = env.rollout(20, break_when_any_done=False)
    assert batch.device.type == "cuda" and batch["next", "done"].any()
