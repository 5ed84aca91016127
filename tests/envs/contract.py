"""The contract of every env as tests: derive from ``EnvContract`` and implement ``make`` to run them."""

from abc import ABC, abstractmethod
from copy import copy
from functools import partial

import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.collectors import Collector
from torchrl.envs import EnvBase, SerialEnv, TransformedEnv
from torchrl.envs.utils import check_env_specs, step_mdp

from splatrl.envs import SplatEnv
from tests.tiny import CountingRenderer


def base_env(env: EnvBase) -> SplatEnv:
    """Return the ``SplatEnv`` under any transforms."""
    while isinstance(env, TransformedEnv):
        env = env.base_env
    assert isinstance(env, SplatEnv)
    return env


def stateful(env: EnvBase) -> list[EnvBase]:
    """Return the envs that save all state together: ``TransformedEnv.state_dict`` holds only the transforms."""
    base = base_env(env)
    return [base] if base is env else [base, env]


def seeded_rollout(env: EnvBase, steps: int, seed: int) -> TensorDictBase:
    """Return a rollout of random actions from a reset that depends only on ``seed``."""
    env.set_seed(seed)
    torch.manual_seed(seed)
    return env.rollout(steps, break_when_any_done=False)


def assert_same(left: TensorDictBase, right: TensorDictBase) -> None:
    """Assert that both hold the same keys and bytes."""
    assert set(left.keys(True, True)) == set(right.keys(True, True))
    for key in left.keys(True, True):
        assert torch.equal(left[key], right[key]), key


class EnvContract(ABC):
    """Tests that hold for every env; random actions must end episodes within ``steps``."""

    steps = 24

    @abstractmethod
    def make(self, batch_size: tuple[int], seed: int = 0) -> EnvBase:
        """Make a new env."""

    @pytest.fixture(scope="class")
    @classmethod
    def kept(cls) -> list[TensorDictBase]:
        """Cache of the rollout that ``rolled`` makes."""
        return []

    @pytest.fixture
    def rolled(self, kept: list[TensorDictBase]) -> TensorDictBase:
        """A rollout of three robots from seed 7, made once."""
        if not kept:
            kept.append(seeded_rollout(self.make((3,)), self.steps, 7))
        return kept[0]

    @pytest.mark.parametrize("batch", [1, 3])
    def test_outputs_match_the_specs(self, batch: int) -> None:
        check_env_specs(self.make((batch,)), break_when_any_done="both", seed=0)

    def test_a_wrong_batch_size_is_refused(self) -> None:
        env, larger = self.make((3,)), self.make((5,))
        assert env.batch_locked
        td = larger.rand_action(larger.reset())
        for method in (env.reset, env.step):
            with pytest.raises(RuntimeError, match="batch"):
                method(td.clone())

    def test_an_episode_ends_within_the_steps_of_this_contract(self, rolled: TensorDictBase) -> None:
        assert rolled["next", "done"].sum() >= 2

    def test_a_partial_reset_leaves_the_other_rows_as_they_are(self) -> None:
        env = self.make((6,))
        before = env.rollout(5, break_when_any_done=True)[:, -1]["next"].clone()
        before["done"][1] = before["terminated"][1] = True  # rows that end and are not reset stay done
        for seed in range(3):
            mask = (torch.rand(6, 1, generator=torch.Generator().manual_seed(seed)) < 0.5).to(env.device)
            mask[0], mask[1] = True, False
            after = env.reset(before.clone().exclude("reward").set("_reset", mask), set_state=False)
            for key in env.observation_spec.keys(True, True):
                assert torch.equal(after[key][~mask.squeeze(1)], before[key][~mask.squeeze(1)]), key
            for key in ("done", "terminated", "truncated"):
                assert torch.equal(after[key], before[key] & ~mask), key
            assert (after["step_count"][mask] == 0).all() and (before["step_count"][mask] > 0).all()

    def test_a_partial_reset_renders_only_the_rows_that_it_resets(self) -> None:
        env = self.make((6,))
        base = base_env(env)
        base.drawing = copy(base.drawing)  # other envs share it
        base.drawing.renderer = counting = CountingRenderer(base.drawing.renderer)
        td = env.reset()
        assert counting.rendered == 6
        mask = torch.tensor([[True], [False], [False], [True], [False], [False]], device=env.device)
        env.reset(td.set("_reset", mask), set_state=False)
        assert counting.rendered == 6 + 2

    def test_each_step_starts_from_the_result_of_the_previous_one(self, rolled: TensorDictBase) -> None:
        batch = rolled
        goes_on = ~batch["next", "done"][:, :-1, 0]
        assert goes_on.any() and not goes_on.all()
        for key in batch["next"].keys(True, True):
            if key in batch.keys(True, True):
                assert torch.equal(batch[key][:, 1:][goes_on], batch["next", key][:, :-1][goes_on]), key
        begins = batch["step_count"][:, 1:][~goes_on]
        assert (begins == 0).all()
        assert torch.equal(batch["next", "level"], batch["level"])  # an episode keeps the level at which it began

    def test_a_rollout_continues_where_another_stopped(self) -> None:
        env = self.make((3,))
        first = env.rollout(2, break_when_any_done=False)
        second = env.rollout(
            2, auto_reset=False, tensordict=env.maybe_reset(step_mdp(first[:, -1])), break_when_any_done=False
        )
        ended = first["next", "done"][:, -1]
        assert torch.equal(second["step_count"][:, 0], torch.where(ended, 0, first["next", "step_count"][:, -1]))
        assert torch.equal(second["pixels"][:, 0][~ended[:, 0]], first["next", "pixels"][:, -1][~ended[:, 0]])

    def test_the_same_seed_gives_the_same_bytes(self, rolled: TensorDictBase) -> None:
        assert_same(rolled, seeded_rollout(self.make((3,), 99), self.steps, 7))

    def test_seeding_in_the_constructor_equals_set_seed(self) -> None:
        env = self.make((3,), seed=1)
        env.set_seed(5)
        assert_same(env.reset(), self.make((3,), seed=5).reset())

    def test_another_seed_gives_other_starts(self) -> None:
        env = self.make((16,))
        env.set_seed(1)
        first = env.reset()["state"]
        env.set_seed(2)
        assert not torch.equal(first, env.reset()["state"])

    def test_a_reset_with_set_state_false_ignores_the_given_state(self) -> None:
        td = self.make((16,)).reset()
        first = td["state"].clone()
        again = self.make((16,), seed=1).reset(td, set_state=False)
        assert not torch.equal(again["state"], first)
        assert torch.equal(again["state"], self.make((16,), seed=1).reset()["state"])

    def test_an_episode_can_begin_at_a_given_state(self) -> None:
        env = self.make((3,))
        given = env.reset().select("state", "pixels")
        seen = env.reset(given.clone(), set_state=True)
        assert torch.equal(seen["state"], given["state"])
        assert (seen["level"] == -1).all() and not seen["done"].any()
        moved = env.rollout(4, break_when_any_done=False)
        assert not torch.equal(moved["state"][:, 0], given["state"])
        again = env.reset(TensorDict({"state": given["state"]}, [3]), set_state=True)
        assert torch.equal(again["pixels"], given["pixels"])

    def test_an_env_with_a_loaded_state_dict_continues_byte_for_byte(self) -> None:
        env = self.make((3,), seed=3)
        carried = env.rollout(self.steps, break_when_any_done=False)[:, -1]
        other = self.make((3,), seed=4)
        other.reset()
        for own, new in zip(stateful(env), stateful(other), strict=True):
            new.load_state_dict({key: value.clone() for key, value in own.state_dict().items()})
        for key in ("progress", "cohort"):
            assert torch.equal(*(getattr(base_env(each).curriculum, key) for each in (other, env)))
        runs = []
        for each in (env, other):
            torch.manual_seed(0)
            start = each.maybe_reset(step_mdp(carried.clone()))
            steps = self.steps // 2
            runs.append(each.rollout(steps, auto_reset=False, tensordict=start, break_when_any_done=False).clone())
        assert_same(*runs)
        assert_same(env.reset(), other.reset())

    def test_later_steps_do_not_change_earlier_results(self) -> None:
        env = self.make((3,))
        torch.manual_seed(0)
        td = env.reset()
        handed: list[tuple[TensorDictBase, TensorDictBase]] = []
        for _ in range(self.steps):
            step, td = env.step_and_maybe_reset(env.rand_action(td))
            handed.append((step, step.clone()))
        assert any(then["next", "done"].any() for _, then in handed)
        for step, then in handed:
            assert_same(step, then)

    def test_moving_to_its_own_device_changes_nothing(self, rolled: TensorDictBase) -> None:
        env = self.make((3,))
        assert env.to(env.device) is env
        assert_same(seeded_rollout(env, 5, 7), rolled[:, :5])

    def test_a_robot_does_not_depend_on_the_others(self) -> None:
        batch = seeded_rollout(self.make((19,)), 1, 0)  # more than PyTorch vectorises at a time
        alone = self.make((1,))
        for row in (0, 9, 18):
            start = alone.reset(batch[row : row + 1, 0].select("state"), set_state=True)
            assert torch.equal(start["pixels"], batch["pixels"][row : row + 1, 0])
            step = alone.step(start.set("action", batch["action"][row : row + 1, 0]))["next"]
            for key in ("pixels", "state", "reward", "done", "outcome", "free_fraction"):
                assert torch.equal(step[key], batch["next", key][row : row + 1, 0]), key

    def test_it_runs_in_a_serial_env(self) -> None:
        env = SerialEnv(2, [partial(self.make, (3,), seed) for seed in (1, 2)])
        batch = env.rollout(self.steps, break_when_any_done=False)
        assert batch.shape == (2, 3, self.steps)
        assert batch["next", "done"].any(-2).any()
        env.close()

    def test_it_runs_in_a_collector(self) -> None:
        torch.manual_seed(0)
        frames = 3 * (self.steps // 2)
        collector = Collector(partial(self.make, (3,)), None, frames_per_batch=frames, total_frames=2 * frames)
        batches = list(collector)
        collector.shutdown()
        assert [batch.numel() for batch in batches] == [frames] * 2
        last, first = batches[0][:, -1]["next"], batches[1][:, 0]
        goes_on = ~last["done"].squeeze(1)
        assert torch.equal(last["pixels"][goes_on], first["pixels"][goes_on])
