"""Recordings hold every step of an episode, from the first pose to the last."""

import pytest
import torch
from tensordict import TensorDictBase
from torch import Tensor

from splatrl.envs.tasks import Apple, Outcome, Snake
from splatrl.envs.tasks.base import Anywhere, Memory, Step, Verdict
from splatrl.evaluation.recording import record_episodes
from splatrl.renderers import Parts
from tests.envs.rooms import PLACE, coarse_forward, painted_env
from tests.tiny import tiny_env, tiny_plan, tiny_renderer, tiny_task


def scripted(*actions: list[int]) -> "Script":
    return Script(torch.tensor(actions).T)


class Script:
    """A policy that plays rows of actions, [T, B], and then repeats the last row."""

    def __init__(self, actions: Tensor):
        self.actions, self.step = actions, 0

    def __call__(self, td: TensorDictBase) -> TensorDictBase:
        td["action"] = self.actions[min(self.step, len(self.actions) - 1)].clone()
        self.step += 1
        return td


STARTS = torch.tensor(
    [[0, 0, 2], [2, 2, 1], [1, 4, 0]]
)  # far from all else, south of the block, two steps from the goal
ACTIONS = [0, 4, 3], [4, 2, 4], [0, 0, 0]  # out of bounds; into the block; to the goal


def test_each_recording_ends_where_its_own_episode_ends() -> None:
    policy = scripted(*ACTIONS)
    counted: list[int] = []
    recordings = record_episodes(tiny_env((3,)), policy, STARTS, progress=counted.append)
    assert policy.step == sum(counted) == 3  # as many steps as the longest episode
    assert [r.outcome for r in recordings] == [Outcome.OUT_OF_BOUNDS, Outcome.COLLISION, Outcome.GOAL]
    assert [r.action.tolist() for r in recordings] == [[0, 4, 3], [4, 2], [0]]
    for recording in recordings:
        steps = len(recording.action)
        assert recording.pixels.shape == (steps + 1, 12, 16, 3) and recording.pixels.dtype == torch.uint8
        assert recording.planar.shape == (steps + 1, 3) and recording.body_to_world.shape == (steps + 1, 4, 4)
    assert [r.episode_return.tolist() for r in recordings] == [
        pytest.approx([0, -0.2, -0.4, -10.4]),
        pytest.approx([0, -0.2, -10.2]),
        pytest.approx([0, 50]),
    ]


def test_every_recorded_pose_has_the_pixels_that_are_seen_from_it() -> None:
    env = tiny_env((3,))
    recordings = record_episodes(env, scripted(*ACTIONS), STARTS)
    motion = tiny_task().motion
    states = [[[0, 0, 2], [1, 0, 2], [1, 0, 3], [1, 0, 3]], [[2, 2, 1], [2, 2, 2], [2, 2, 2]], [[1, 4, 0], [2, 4, 0]]]
    for recording, expected in zip(recordings, states, strict=True):
        state = torch.tensor(expected)
        assert torch.equal(recording.planar, motion.planar(state))
        assert torch.equal(recording.body_to_world, motion.body_to_world(state))
        seen = tiny_renderer().pixels(env.robot.cameras(recording.body_to_world))
        assert torch.equal(recording.pixels, seen)


def test_a_task_without_memory_parts_and_marks_records_none() -> None:
    (recording, *_) = record_episodes(tiny_env((3,)), scripted(*ACTIONS), STARTS)
    assert (dict(recording.memory), recording.parts, list(recording.marks)) == ({}, None, [])


def test_the_memory_parts_and_marks_of_a_task_are_recorded_at_every_step() -> None:
    env = painted_env(Runaway(coarse_forward(), PLACE, max_steps=5), batch=2)
    starts = torch.tensor([[-1.0, -1.5, 0.0], [-1.0, 1.5, 0.0]])
    recordings = record_episodes(env, scripted([0, 0, 0], [2, 2, 2]), starts)
    for recording in recordings:
        steps = torch.arange(len(recording.action) + 1)
        expected = torch.tensor(PLACE) + 0.1 * steps.unsqueeze(1) * torch.tensor([0.0, 1.0, 0.0])
        drawn = torch.cat([expected[:1], expected[:-1]])  # a view is drawn before the task judges its step
        torch.testing.assert_close(recording.memory["target"], drawn)
        assert [len(marks) for marks in recording.marks] == [1] * len(steps)
        shown = torch.stack([marks[0].planar for marks in recording.marks])
        torch.testing.assert_close(shown[:, :2].float(), expected[:, :2])
        assert recording.parts is not None
        assert recording.parts.model.tolist() == [[1]] * len(steps)
        stands = recording.parts.model_to_world[:, 0]
        torch.testing.assert_close(stands[:, :2, 3], drawn[:, :2] + recording.planar[:, :2].float())


def test_reached_goals_are_recorded_only_for_tasks_with_several_goals() -> None:
    env = painted_env(Snake(coarse_forward(), PLACE, max_steps=3), batch=1)
    start, apple = torch.tensor([[0.0, 1.0, 0.0]]), {"target": torch.tensor([PLACE])}
    (recording,) = record_episodes(env, scripted([0, 0, 2]), start, memory=apple)  # the second step reaches the apple
    assert recording.goals is not None and recording.goals.tolist() == [0, 0, 1, 1]
    (plain, *_) = record_episodes(tiny_env((3,)), scripted(*ACTIONS), STARTS)
    assert plain.goals is None and plain.goal_image is None


def test_episodes_can_start_with_a_given_memory() -> None:
    env = painted_env(Runaway(coarse_forward(), PLACE, max_steps=2), batch=1)
    given = {"target": torch.tensor([[0.1, 0.2, 0.3]])}
    (recording,) = record_episodes(env, scripted([0, 2]), torch.tensor([[-1.0, -1.5, 0.0]]), memory=given)
    torch.testing.assert_close(recording.memory["target"][0], given["target"][0])


class Runaway(Apple):
    """The apple moves north by 0.1 m per step, and a part is placed at the sum of its position and the robot's."""

    def judge(self, step: Step, anywhere: Anywhere) -> Verdict:
        ahead = step.memory["target"] + torch.tensor([0.0, 0.1, 0.0])
        return super().judge(step, anywhere)._replace(memory={"target": ahead})

    def parts(self, state: Tensor, memory: Memory) -> Parts:
        poses = torch.eye(4).repeat(len(state), 1, 1, 1)
        poses[:, 0, :2, 3] = memory["target"][:, :2] + state[:, :2]
        return Parts(torch.ones(len(state), 1, dtype=torch.int64), poses)


def test_an_episode_that_does_not_end_times_out_at_max_steps() -> None:
    spinning = scripted(*[[4]] * 3)
    recordings = record_episodes(tiny_env((3,), max_steps=5), spinning, STARTS.clone().fill_(0))
    assert [(r.outcome, len(r.action)) for r in recordings] == [(Outcome.TIMEOUT, 5)] * 3


def test_sampling_depends_only_on_the_seed() -> None:
    def policy(td: TensorDictBase) -> TensorDictBase:
        return td.set("action", torch.randint(0, 6, td.batch_size))

    starts = tiny_plan().states[tiny_plan().start_rows[:3]]
    torch.manual_seed(0)
    before = torch.get_rng_state()
    first, again, other = (record_episodes(tiny_env((3,)), policy, starts, seed=seed) for seed in (1, 1, 2))
    assert torch.equal(torch.get_rng_state(), before)
    played = [[r.action.tolist() for r in recordings] for recordings in (first, again, other)]
    assert played[0] == played[1] != played[2]


def test_an_env_with_another_batch_size_is_refused() -> None:
    with pytest.raises(ValueError, match=r"one robot per start \(3\), got 2"):
        record_episodes(tiny_env((2,)), scripted(*ACTIONS), STARTS)
