"""``SplatEnv``: its contract, and tests specific to it."""

import re
from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor
from torchrl.collectors import MultiSyncCollector
from torchrl.data import TensorSpec, Unbounded
from torchrl.envs import ParallelEnv, StepCounter, TransformedEnv

from splatrl import make_env
from splatrl.building import build_world, env_makers
from splatrl.cameras import Cameras
from splatrl.configuration import load_config
from splatrl.curriculum import Curriculum
from splatrl.envs import SplatEnv, World
from splatrl.envs.drawing import SceneDrawing
from splatrl.envs.tasks import Grid, Outcome
from splatrl.envs.tasks.base import Anywhere, Memory
from splatrl.envs.transforms import PoseNoise
from splatrl.renderers import Parts
from tests.curriculum.graph import successors
from tests.envs.contract import EnvContract
from tests.envs.rooms import coarse_apple, drive_env, painted_env
from tests.tiny import (
    BlockChecker,
    CountingRenderer,
    RememberingRenderer,
    tiny_env,
    tiny_motion,
    tiny_overrides,
    tiny_plan,
    tiny_renderer,
    tiny_robot,
)

FORWARD_X, BACK_X, LEFT_Y, RIGHT_Y, SPIN, SPIN_BACK = range(6)


class TestContract(EnvContract):
    def make(self, batch_size: tuple[int], seed: int = 0) -> SplatEnv:
        return tiny_env(batch_size, seed, max_steps=15, first=3, threshold=0.01, window=5)


class TestContractOfAConfiguredWorld(EnvContract):
    """The same room built from a config: files, the native renderer, its cache and the native checker."""

    world: World

    @pytest.fixture(autouse=True, scope="class")
    @classmethod
    def build(cls, tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
        cls.world = build_world(load_config([*tiny_overrides(tmp_path_factory.mktemp("room")), "renderer.tolerance=0"]))
        yield
        del cls.world

    def make(self, batch_size: tuple[int], seed: int = 0) -> SplatEnv:
        curriculum = Curriculum(self.world.plan, first=3, threshold=0.01, window=5)
        return self.world.env(batch_size[0], curriculum, seed)

    def test_its_plan_equals_that_of_the_hand_made_room(self) -> None:
        assert torch.equal(successors(self.world.plan), successors(tiny_plan()))
        assert torch.equal(self.world.plan.distance, tiny_plan().distance)

    def test_it_shows_what_the_reference_renderer_shows(self) -> None:
        start = TensorDict({"state": torch.tensor([[0, 0, 1], [3, 5, 0], [4, 6, 5]])}, [3])
        envs = self.make((3,)), tiny_env((3,))
        seen, expected = (env.reset(start.clone(), set_state=True)["pixels"].int() for env in envs)
        assert (seen - expected).abs().max() <= 1 and seen.float().std() > 10


def test_another_default_dtype_is_refused() -> None:
    env = tiny_env((3,))
    parts = env.drawing, env.checker, tiny_robot(), env.task, env.curriculum, [3]
    message = r"torch\.set_default_dtype: expected torch\.float32, got torch\.float64"
    torch.set_default_dtype(torch.float64)
    try:
        assert tiny_robot().camera_to_body.dtype == tiny_robot().K.dtype == torch.float32
        for call in (env.reset, partial(SplatEnv, *parts), make_env):
            with pytest.raises(ValueError, match=message):
                call()
    finally:
        torch.set_default_dtype(torch.float32)


def step_from(states: list[list[int]], actions: list[int], max_steps: int = 20) -> TensorDictBase:
    """Take one step with robots placed by hand."""
    env = tiny_env([len(states)], max_steps=max_steps)
    td = env.reset(TensorDict({"state": torch.tensor(states)}, [len(states)]), set_state=True)
    return env.step(td.set("action", torch.tensor(actions)))["next"]


def test_a_blocked_robot_stays_where_it_was_and_reports_how_far_it_was_free() -> None:
    after = step_from([[1, 3, 0], [4, 0, 5], [1, 1, 7]], [FORWARD_X, FORWARD_X, SPIN])
    assert after["state"].tolist() == [[1, 3, 0], [4, 0, 5], [1, 1, 0]]
    assert after["outcome"].flatten().tolist() == [Outcome.COLLISION, Outcome.OUT_OF_BOUNDS, Outcome.RUNNING]
    assert after["terminated"].flatten().tolist() == [True, True, False]
    assert after["reward"].flatten().tolist() == pytest.approx([-10.0, -10.0, -0.2])
    torch.testing.assert_close(after["free_fraction"].flatten(), torch.tensor([0.3, 1.0, 1.0]))
    poses = tiny_motion().body_to_world(after["state"])
    robot = tiny_env([3]).robot
    assert torch.equal(after["pixels"], tiny_renderer().pixels(robot.cameras(poses)))


def test_return_and_length_count_the_steps_of_the_episode() -> None:
    env = tiny_env([2])
    td = env.reset(TensorDict({"state": torch.tensor([[0, 0, 0], [0, 5, 0]])}, [2]), set_state=True)
    for action in ([FORWARD_X, SPIN], [LEFT_Y, FORWARD_X], [SPIN_BACK, FORWARD_X]):
        td = env.step_mdp(env.step(td.set("action", torch.tensor(action))))
    assert td["step_count"].flatten().tolist() == [3, 3]
    assert td["episode_return"].flatten().tolist() == pytest.approx([-0.6, 49.6])
    assert td["state"].tolist() == [[1, 1, 7], [2, 5, 1]]
    assert td["outcome"].flatten().tolist() == [Outcome.RUNNING, Outcome.GOAL]


def test_an_episode_is_truncated_at_the_limit_and_not_before() -> None:
    env = tiny_env([2], max_steps=3)
    td = env.reset(TensorDict({"state": torch.tensor([[0, 0, 0], [4, 0, 0]])}, [2]), set_state=True)
    ends = []
    for _ in range(3):
        td = env.step_mdp(env.step(td.set("action", torch.full((2,), SPIN))))
        ends.append(td["truncated"].flatten().tolist())
    assert ends == [[False, False], [False, False], [True, True]]
    assert (td["outcome"] == Outcome.TIMEOUT).all() and td["done"].all() and not td["terminated"].any()


def test_a_last_step_that_terminates_is_not_truncated() -> None:
    after = step_from([[1, 5, 0], [1, 3, 0], [0, 0, 0], [0, 1, 0]], [FORWARD_X, FORWARD_X, RIGHT_Y, SPIN], max_steps=1)
    assert after["truncated"].flatten().tolist() == [False, False, False, True]
    assert after["terminated"].flatten().tolist() == [True, True, True, False]
    assert after["done"].all()
    expected = [Outcome.GOAL, Outcome.COLLISION, Outcome.OUT_OF_BOUNDS, Outcome.TIMEOUT]
    assert after["outcome"].flatten().tolist() == expected


def test_the_curriculum_counts_each_end_once_and_no_episode_placed_by_hand() -> None:
    env = tiny_env([2], first=1, window=3, threshold=1.0)
    home = torch.tensor([[1, 5, 0], [1, 4, 1]])  # one step to the goal
    td = env.reset(TensorDict({"state": home}, [2]), set_state=True)
    env.step(td.set("action", torch.tensor([FORWARD_X, FORWARD_X])))
    assert env.curriculum.progress.tolist() == [0, 0, 0]
    td["level"] = torch.zeros_like(td["level"])
    env.curriculum.begin(torch.tensor([True, True]))
    env.step(td.set("action", torch.tensor([FORWARD_X, SPIN])))
    assert env.curriculum.progress.tolist() == [0, 1, 1]
    env.step(td.set("action", torch.tensor([FORWARD_X, SPIN])))
    assert env.curriculum.progress.tolist() == [0, 1, 1]
    env.curriculum.begin(torch.tensor([True, False]))
    env.step(td.set("action", torch.tensor([FORWARD_X, FORWARD_X])))
    assert env.curriculum.progress.tolist() == [1, 0, 0]
    assert (env.reset()["level"] == 1).all()


def test_an_episode_that_is_cut_off_is_a_failure_in_the_curriculum() -> None:
    """A time limit around the env, a full reset, and given states cut episodes off."""
    env = tiny_env([3], first=None, window=40, threshold=0.5)
    limited = TransformedEnv(env, StepCounter(3, step_count_key="actions"))
    policy = TensorDictModule(lambda state: torch.full(state.shape[:1], SPIN), ["state"], ["action"])
    after = limited.rollout(7, policy, break_when_any_done=False)["next"]
    won, ends = (after["success"] & after["done"]).sum(), after["done"].sum()
    assert ends - won >= 4 and not after["done"][:, -1].any()
    assert env.curriculum.progress.tolist() == [0, ends, won]
    env.reset()
    assert env.curriculum.progress.tolist() == [0, ends + 3, won]
    home = torch.tensor([[1, 5, 0]] * 3)
    mask = torch.tensor([[True], [False], [True]])
    td = env.reset(TensorDict({"state": home, "_reset": mask}, [3]), set_state=True)
    assert env.curriculum.progress.tolist() == [0, ends + 5, won]
    assert env.curriculum.cohort.tolist() == [False, True, False]  # episodes from given states are no members
    env.reset(td.set("_reset", mask))
    assert env.curriculum.progress.tolist() == [0, ends + 5, won] and env.curriculum.cohort.all()


def test_robots_that_wait_stay_in_the_cohort() -> None:
    for looked_up in (True, False):
        env = tiny_env([3], first=None, window=20, threshold=0.5, max_steps=1)
        if not looked_up:
            env.lattice_steps = None
        td = env.reset().set("action", torch.full((3,), SPIN))
        env.step(td.set("_step", torch.tensor([[False], [True], [False]])))
        assert env.curriculum.progress.tolist() == [0, 1, 0]
        assert env.curriculum.cohort.tolist() == [True, False, True]


WHAT_STEPS = {
    "lookup table": ["grid"],
    "continuous motion": ["drive"],
    "sensors and goals": ["pointnav", "sensors=[rgb,depth,gps,compass,lidar,pointgoal]"],
}


@pytest.mark.parametrize("name", WHAT_STEPS)
def test_robots_that_do_not_step_stay_unchanged_and_are_not_rendered(name: str, tmp_path: Path) -> None:
    task, *more = WHAT_STEPS[name]
    env = make_env([*tiny_overrides(tmp_path, task), *more, "renderer.cache=null"], batch_size=[6], seed=1)
    torch.manual_seed(0)
    given = env.rand_action(env.rollout(3)[:, -1].exclude("next"))
    whole = env.step(given.clone())["next"]
    stepping = torch.tensor([[True], [False], [True], [False], [False], [True]])
    env.drawing.renderer = counting = CountingRenderer(env.drawing.renderer)
    partly = env.step(given.clone().set("_step", stepping))["next"]
    assert counting.rendered == 3
    rows, others = stepping.flatten(), ~stepping.flatten()
    for key, expected in whole.items():
        assert torch.equal(partly[key][rows], expected[rows]), key
        if key != "reward":
            assert torch.equal(partly[key][others], given[key][others]), key
    assert not partly["reward"][others].any() and not torch.equal(whole["state"][others], given["state"][others])
    nobody = env.step(given.clone().set("_step", torch.zeros_like(stepping)))["next"]
    assert torch.equal(nobody["state"], given["state"])


class CameraRecorder(RememberingRenderer):
    """Remembers the cameras that it was last asked to render."""

    def pixels(self, cameras: Cameras, parts: Parts | None = None, only: Tensor | None = None) -> Tensor:
        self.cameras = cameras
        return super().pixels(cameras, parts, only)


def test_a_camera_offset_moves_the_camera_and_not_the_robot() -> None:
    recorder = CameraRecorder(tiny_renderer())
    env = tiny_env([2], renderer=recorder)
    start = {"state": torch.tensor([[0, 1, 0], [3, 0, 2]])}
    td = env.reset(TensorDict(start, [2]), set_state=True)
    still = recorder.cameras.camera_to_world
    offset = torch.tensor([[0.0] * 6, [0.01, 0.02, 0.03, 0.0, 0.0, 0.0]])
    moved = env.reset(TensorDict({**start, "camera_offset": offset}, [2]), set_state=True)
    shift = recorder.cameras.camera_to_world[:, :3, 3] - still[:, :3, 3]
    torch.testing.assert_close(shift, offset[:, :3])
    assert torch.equal(moved["state"], td["state"])
    after = env.step(moved.set("action", torch.tensor([SPIN, SPIN])))["next"]
    shift = recorder.cameras.camera_to_world[:, :3, 3] - still[:, :3, 3]
    torch.testing.assert_close(shift, offset[:, :3])
    assert after["state"].tolist() == [[0, 1, 1], [3, 0, 3]]


def test_a_camera_offset_goes_to_its_own_row_on_a_partial_reset() -> None:
    recorder = CameraRecorder(tiny_renderer())
    env = tiny_env([3], renderer=recorder)
    td = env.reset()
    offset = torch.zeros(3, 6)
    offset[:, 2] = torch.tensor([0.1, 0.2, 0.3])
    mask = torch.tensor([[False], [True], [True]])
    env.reset(td.update({"camera_offset": offset, "_reset": mask}), set_state=False)
    torch.testing.assert_close(recorder.cameras.camera_to_world[1:, 2, 3], torch.tensor([0.7, 0.8]))


@pytest.mark.parametrize("batch_size", [[], [0], [2, 3], [2.0], "8", [True], 8])
def test_a_batch_that_is_not_one_positive_number_is_refused(batch_size: list[int]) -> None:
    with pytest.raises(ValueError, match="batch_size: expected a list with one whole number"):
        tiny_env(batch_size)


def test_a_memory_that_uses_the_envs_own_keys_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    taken = dict.fromkeys(("_draw", "level", "mine", "pixels"), Unbounded(shape=(1,)))
    monkeypatch.setattr(Grid, "memory_spec", taken)
    with pytest.raises(
        ValueError, match=r"task\.memory_spec: expected keys that the env does not use, got _draw, level, pixels"
    ):
        tiny_env((2,))


def test_envs_without_a_seed_differ() -> None:
    first, second = (tiny_env([16], seed=None).reset()["state"] for _ in range(2))
    assert not torch.equal(first, second)


def test_the_block_checker_of_these_tests_matches_hand_calculation() -> None:
    checker, motion = BlockChecker(), tiny_motion()
    start = motion.body_to_world(torch.tensor([[1, 3, 0], [3, 3, 0], [2, 1, 0], [2, 4, 0], [1, 1, 0], [2, 3, 0]]))
    end = motion.body_to_world(torch.tensor([[2, 3, 0], [2, 3, 0], [2, 2, 0], [2, 3, 0], [2, 1, 0], [2, 3, 1]]))
    fraction = checker.free_fraction(start, end)
    torch.testing.assert_close(fraction, torch.tensor([0.3, 0.3, 1.0, 0.3, 1.0, 0.0]))
    assert checker.sweeps(start, end).tolist() == [True, True, False, True, False, True]
    assert checker.collides(end).tolist() == [True, True, False, True, False, True]


def test_two_processes_step_their_own_envs() -> None:
    env = ParallelEnv(2, [partial(tiny_env, (3,), seed) for seed in (1, 2)], mp_start_method="fork")
    batch = env.rollout(5, break_when_any_done=False)
    env.close()
    assert batch.shape == (2, 3, 5)
    assert torch.equal(batch["state"][0, :, 0], tiny_env((3,), 1).reset()["state"])
    assert not torch.equal(batch["state"][0, :, 0], batch["state"][1, :, 0])


@pytest.fixture
def forks() -> Iterator[None]:
    """Lets TorchRL's collectors fork their workers, so that these need not import PyTorch anew."""
    torch.multiprocessing.set_start_method("fork", force=True)
    yield
    torch.multiprocessing.set_start_method(None, force=True)


@pytest.mark.usefixtures("forks")
def test_two_processes_collect_in_a_world_that_each_builds_from_its_path(tmp_path: Path) -> None:
    room = tiny_overrides(tmp_path)
    collector = MultiSyncCollector(
        [partial(make_env, room, (3,), seed) for seed in (1, 2)], None, frames_per_batch=60, total_frames=120
    )
    collector.set_seed(0)
    batches = [batch.clone() for batch in collector]
    collector.shutdown()
    assert [batch.numel() for batch in batches] == [60, 60]
    assert all((batch["next", "step_count"] == batch["step_count"] + 1).all() for batch in batches)
    assert all(batch["pixels"].float().std() > 10 for batch in batches)


@pytest.mark.parametrize(
    ("state", "got"),
    [
        (torch.tensor([[0, 0, 0], [4, 6, 8], [5, 0, 0]]), r"torch.int64 \[4, 6, 8\] in row 1"),
        (torch.tensor([[-1, 0, 0], [0, 0, 0], [0, 0, 0]]), r"torch.int64 \[-1, 0, 0\] in row 0"),
        (torch.zeros(3, 3), r"torch.float32 \[0.0, 0.0, 0.0\] in row 0"),
    ],
)
def test_a_state_that_the_task_does_not_have_is_refused(state: Tensor, got: str) -> None:
    with pytest.raises(ValueError, match=rf"state: expected torch.int64 from \[0, 0, 0\] to \[4, 6, 7\], got {got}"):
        tiny_env([3]).reset(TensorDict({"state": state}, [3]), set_state=True)


@pytest.mark.parametrize("key", ["state", "level", "goals"])
@pytest.mark.parametrize("looked_up", [True, False])
def test_an_input_that_lacks_what_travels_of_an_episode_is_refused(looked_up: bool, key: str) -> None:
    env = tiny_env([2])
    if not looked_up:
        env.lattice_steps = None
    td = env.reset().set("action", torch.tensor([0, 1]))
    with pytest.raises(ValueError, match=rf"^step: expected {key} in its TensorDict, in which episodes travel"):
        env.step(td.exclude(key))


@pytest.mark.parametrize("action", [-1, 6, 2**40])
def test_an_action_that_does_not_exist_is_refused(action: int) -> None:
    for env in (tiny_env([2]), painted_env(coarse_apple(), 2)):
        td = env.reset().set("action", torch.tensor([0, action]))
        with pytest.raises(ValueError, match=rf"action: expected whole numbers from 0 to \d, got {action}"):
            env.step(td)


WRONG_KINDS = {
    "torch.float32 [2]": torch.tensor([0.0, 1.0]),
    "torch.int32 [2]": torch.tensor([0, 1], dtype=torch.int32),
    "torch.uint8 [2]": torch.tensor([0, 1], dtype=torch.uint8),
    "torch.bool [2]": torch.tensor([True, False]),
    "torch.int64 [2, 1]": torch.tensor([[0], [1]]),
    "torch.int64 [2, 6]": torch.eye(6, dtype=torch.int64)[:2],
}


@pytest.mark.parametrize("got", WRONG_KINDS)
def test_an_action_of_another_dtype_or_shape_is_refused(got: str) -> None:
    for env in (tiny_env([2]), painted_env(coarse_apple(), 2)):
        td = env.reset().set("action", WRONG_KINDS[got])
        with pytest.raises(ValueError, match=rf"^action: expected torch\.int64 \[B\], got {re.escape(got)}$"):
            env.step(td)


def test_a_continuous_action_of_another_dtype_or_shape_is_refused() -> None:
    env = drive_env()
    td = env.reset()
    for action in (torch.zeros(1, 2, dtype=torch.float64), torch.zeros(1), torch.zeros(1, 3)):
        with pytest.raises(ValueError, match=r"^action: expected torch\.float32 \[B, 2\], got torch\.float"):
            env.step(td.set("action", action))


def test_an_action_may_carry_gradients_which_end_at_the_env() -> None:  # as of a rollout outside torch.no_grad()
    def policy(td: TensorDict) -> TensorDict:
        return td.set("action", torch.full((2, 2), 0.1, requires_grad=True).tanh())

    rollout = drive_env((2,)).rollout(3, policy, break_when_any_done=False)
    assert rollout["action"].requires_grad and not rollout["next"].requires_grad


def test_a_reset_to_no_state_is_refused() -> None:
    env = tiny_env([2])
    with pytest.raises(ValueError, match=r"^state: expected torch\.int64 \[B, 3\] with set_state=True, got none"):
        env.reset(env.reset().exclude("state"), set_state=True)


@pytest.mark.parametrize("seed", [-1, 1.5, "a", True, 2**64])
def test_a_seed_that_is_no_whole_number_of_64_bits_is_refused(seed: Any) -> None:
    env = tiny_env([2])
    for call in (env.set_seed, TransformedEnv(env).set_seed, partial(tiny_env, [2]), PoseNoise, env_makers):
        given = {"workers": 2} if call is env_makers else {}
        with pytest.raises(ValueError, match=rf"^seed: expected a whole number from 0 to {2**64 - 1}, got"):
            call(seed=seed, **given)


def test_numpys_whole_numbers_are_seeds() -> None:
    first, second = tiny_env([8], seed=np.int64(3)), tiny_env([8], seed=4)
    assert second.set_seed(np.int64(3)) == tiny_env([8]).set_seed(3)
    assert torch.equal(first.reset()["state"], second.reset()["state"])
    tiny_env([2], seed=2**64 - 1).reset()


@pytest.mark.parametrize("task", ["drive", "push"])
def test_an_action_that_is_not_finite_is_refused(task: str, tmp_path: Path) -> None:
    env = make_env(tiny_overrides(tmp_path, task), batch_size=[2])
    td = env.reset().set("action", torch.tensor([[0.1, 0.0], [torch.nan, 0.25]]))
    with pytest.raises(ValueError, match=r"^action: expected finite numbers, got \[nan, 0\.25\]$"):
        env.step(td)


class Lottery(Grid):
    """A grid task whose episodes begin at random states of its own, each with a random number to remember."""

    @property
    def memory_spec(self) -> Mapping[str, TensorSpec]:
        return {"number": Unbounded(shape=(1,), dtype=torch.float32)}

    def start(self, state: Tensor, anywhere: Anywhere) -> Tensor:
        chosen = torch.rand(len(state), generator=anywhere.generator) < 0.5
        return torch.where(chosen[:, None], state, anywhere())

    def begin(self, state: Tensor, anywhere: Anywhere) -> Memory:
        return {"number": torch.rand(len(state), 1, generator=anywhere.generator)}


def test_everything_an_episode_begins_with_depends_on_the_seed_of_its_robot_alone() -> None:
    def env(robots: int) -> SplatEnv:
        task, curriculum = Lottery(tiny_motion(), goal=(0.5, 1.0, 0.0)), Curriculum(tiny_plan(), None)
        drawing = SceneDrawing(tiny_renderer())
        return SplatEnv(drawing, BlockChecker(), tiny_robot(), task, curriculum, [robots])

    first, other = env(3).reset(seeds=[3, 4, 5]), env(3).reset(seeds=[7, None, 5])
    alone = [env(1).reset(seeds=[seed]) for seed in (3, 4, 5)]
    for key in ("state", "number", "pixels"):
        assert torch.equal(first[key], torch.cat([one[key] for one in alone])), key
        assert torch.equal(first[key][2], other[key][2]), key
    seeded = env(1)
    seeded.set_seed(4)
    assert torch.equal(seeded.reset()["number"], alone[1]["number"])
    assert len({float(number) for number in first["number"]}) == 3


@pytest.mark.parametrize("seeds", [[1], [1, 2, 3], [1, 2.0], ["1", None]])
def test_seeds_that_are_not_one_whole_number_per_robot_are_refused(seeds: list[Any]) -> None:
    with pytest.raises(ValueError, match="seeds: expected 2 whole numbers or None, got"):
        tiny_env([2]).reset(seeds=seeds)
