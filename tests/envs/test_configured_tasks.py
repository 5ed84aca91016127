"""The env contract for tasks off the lattice, built from their configs in the tiny room with coarse steps."""

from abc import abstractmethod
from collections.abc import Iterator
from dataclasses import replace

import pytest
import torch
from torchrl.envs import EnvBase

from splatrl.building import build_world
from splatrl.configuration import load_config
from splatrl.curriculum import Curriculum
from splatrl.envs import SplatEnv
from splatrl.envs.tasks import Outcome
from splatrl.envs.world import World
from tests.envs.contract import EnvContract, base_env, seeded_rollout
from tests.tiny import LONG_STEPS, tiny_overrides


class ConfiguredContract(EnvContract):
    """An env contract that builds its world once."""

    limit: tuple[str, ...] = ("task.max_steps=6",)
    steps = 7  # more than the limit of an episode
    world: World

    @classmethod
    @abstractmethod
    def overrides(cls) -> tuple[str, ...]:
        """The overrides that choose the task and change its settings."""

    @pytest.fixture(autouse=True, scope="class")
    @classmethod
    def build(cls, tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
        task, *changes = cls.overrides()
        room = tiny_overrides(tmp_path_factory.mktemp("room"), task)
        cls.world = build_world(load_config([*room, *cls.limit, *changes]))
        yield
        del cls.world

    def make(self, batch_size: tuple[int], seed: int = 0) -> EnvBase:
        curriculum = Curriculum(self.world.plan, first=3, threshold=0.01, window=5)
        return self.world.env(batch_size[0], curriculum, seed)


class TestFps(ConfiguredContract):
    @classmethod
    def overrides(cls) -> tuple[str, ...]:
        return ("fps", *LONG_STEPS)

    def test_it_has_no_transform(self) -> None:
        assert isinstance(self.make((1,)), SplatEnv)


class TestDrive(ConfiguredContract):
    @classmethod
    def overrides(cls) -> tuple[str, ...]:
        wheels = ("task.motion.time_step=0.5", "task.motion.angular_deg=180.0", "task.motion.spacing=0.25")
        return ("drive", *wheels, "task.motion.headings=4")

    def test_actions_are_two_velocities(self) -> None:
        batch = seeded_rollout(self.make((3,)), 5, 0)
        assert batch["action"].shape == (3, 5, 2) and batch["action"].dtype == torch.float32
        assert batch["action"].std() > 0.1


class TestApple(ConfiguredContract):
    @classmethod
    def overrides(cls) -> tuple[str, ...]:
        return ("apple", *LONG_STEPS, "landmarks.object=[-0.75,-1.0,0.5]")  # where nothing else is red

    def test_goals_are_reached_only_near_the_apple_and_with_it_in_view(self) -> None:
        env = self.make((64,))
        assert isinstance(env, SplatEnv)
        env.curriculum.schedule = replace(env.curriculum.schedule, window=64)  # all robots are members of its cohort
        after = seeded_rollout(env, self.steps, 0)["next"]
        goal = (after["outcome"] == Outcome.GOAL).flatten()
        assert goal.any() and not goal.all()
        task = base_env(env).task
        away = (after["state"][..., :2] - task.place[:2]).norm(dim=-1).flatten()
        share = after["sprite_share"].flatten()
        assert (away[goal] <= task.reach * 1.001).all()
        assert share[goal].min() > 0.05 and share[~goal].mean() < share[goal].mean()
        assert torch.equal(after["terminated"].flatten() & goal, goal)
        assert base_env(env).curriculum.level > 0
