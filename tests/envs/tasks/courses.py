"""Tests that hold for every task whose robots pass the places of a course."""

from typing import Any

import pytest
import torch

from splatrl.collision.nothing import NoChecker
from splatrl.envs.tasks import Course, Outcome, Step, Verdict
from splatrl.envs.tasks.base import Anywhere
from splatrl.motions import Move

NOTHING: Any = NoChecker.__new__(NoChecker)
PLANE = torch.tensor([0.0, 0.0, 1.0, 0.05], dtype=torch.float64)


@pytest.fixture(autouse=True)
def cache(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SPLATRL_CACHE", str(tmp_path))


def anywhere(task: Course, count: int = 1) -> Anywhere:
    return Anywhere(lambda: task.motion.home.expand(count, -1), torch.Generator().manual_seed(0))


def judged(task: Course, before: torch.Tensor, after: torch.Tensor, passed: int = 0, free: float = 1.0) -> Verdict:
    """Return the verdict on one step of one robot."""
    move = Move(after, task.motion.body_to_world(after), torch.tensor([free]), task.motion.inside(after))
    memory = {"passed": torch.tensor([[passed]]), "next_place": torch.zeros(1, 4)}
    return task.judge(Step(before, torch.zeros(1, 2), move, memory), anywhere(task))


def wander(task: Course, steps: int, action: tuple[float, ...]) -> torch.Tensor:
    """Count the places passed by robots that repeat one action: [6, 1] int64."""
    state = task.start(task.motion.home.expand(6, -1), anywhere(task, 6))
    memory, actions = task.begin(state, anywhere(task, 6)), torch.tensor(action).expand(6, -1)
    for _ in range(steps):
        move = task.motion.move(state, actions, NOTHING)
        memory = task.judge(Step(state, actions, move, memory), anywhere(task, 6)).memory
        state = move.state
    return memory["passed"]


class CourseContract:
    """Tests of a course task; subclasses define how to make one."""

    taught: int
    """Steps within which the teacher finishes; random rollouts end within those of ``ConfiguredContract``."""

    def course(self, courses: int = 2, test_courses: int = 3) -> Course:
        """Make a settled task with short courses."""
        raise NotImplementedError

    def test_training_and_tests_take_different_courses(self) -> None:
        task = self.course()
        trained = task.start(task.motion.home.expand(64, -1), anywhere(task, 64))[:, 0]
        assert set(trained.tolist()) == {0.0, 1.0}
        assert set(task.episodes(task.motion.states(), 9, 0)["state"][:, 0].tolist()) == {2.0, 3.0, 4.0}

    def test_a_teacher_that_knows_the_state_finishes_the_test_courses(self) -> None:
        task = self.course(1, 6)
        begun = task.episodes(task.motion.states(), 6, 0)
        state, memory = begun["state"], {key: begun[key] for key in task.memory_spec}
        assert state[:, 0].tolist() == [1, 2, 3, 4, 5, 6]
        outcomes: dict[int, int] = {}
        for _ in range(self.taught):
            action = task.teach(state, memory)
            assert action is not None
            move = task.motion.move(state, action, NOTHING)
            verdict = task.judge(Step(state, action, move, memory), anywhere(task, 6))
            for row in verdict.terminated.squeeze(1).nonzero().flatten().tolist():
                outcomes.setdefault(row, int(verdict.outcome[row]))
            state, memory = move.state, dict(verdict.memory)
            if len(outcomes) == 6:
                break
        assert outcomes == dict.fromkeys(range(6), int(Outcome.GOAL))

    def test_the_next_place_is_that_of_the_course(self) -> None:
        task = self.course()
        state = task.start(task.motion.home.expand(8, -1), anywhere(task, 8))
        memory = task.begin(state, anywhere(task, 8))
        assert torch.equal(memory["next_place"], task.places[state[:, 0].long(), 1].float())
        assert [mark.name for mark in task.marks({key: each[0] for key, each in memory.items()})] == [task.name]

    def test_an_invalid_number_of_courses_is_refused(self) -> None:
        with pytest.raises(ValueError, match=r"task\.courses"):
            self.course(courses=0)
