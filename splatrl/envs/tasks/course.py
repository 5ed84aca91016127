"""What tasks share whose robots pass the places of a course in order."""

import math
from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import torch
from torch import Tensor
from torchrl.data import TensorSpec, Unbounded

from splatrl.envs.tasks.base import Anywhere, Mark, Memory, Outcome, Step, TaskModule, Verdict
from splatrl.envs.tasks.rewards import FiniteRewards
from splatrl.motions.physics import PhysicsMotion
from splatrl.physics.bank import bank
from splatrl.physics.courses import CourseSettings, draw_courses
from splatrl.physics.stepping import Physics
from splatrl.values import require_number


@dataclass(frozen=True)
class CourseRewards(FiniteRewards):
    """The reward of a step, which adds up.

    Attributes:
        progress: for each metre by which the robot came nearer to the next place; one that was passed is reached.
        passed: for a place that was passed.
        crash: for touching anything, or leaving the bounds.
        slack: of every step.

    Raises:
        ValueError: for a reward that is not a finite number.
    """

    progress: float = 1.0
    passed: float = 1.0
    crash: float = -3.0
    slack: float = -0.01


class Course(TaskModule):
    """Pass all places of a course in order without touching anything; a course is drawn in the scene by its number.

    Subclasses say what courses are like, how robots begin, and what passes a place.

    Reward: [B, 1] float32, see ``CourseRewards``.
    Termination: at the last place, which is a success; where anything is touched; where the robot leaves the bounds.
    Truncation: after ``max_steps`` steps.
    State: [B, n] float64, the physics' (``PhysicsMotion``), whose first number is that of the course. Memory:
        ``passed`` [B, 1] int64, how many places were passed; ``next_place`` [B, 4] float32, x, y and z in metres and
        yaw in radians of the next one, world, the last one after it was passed, for sensors and for those who train a
        critic on it.

    Training takes the first ``courses``, tests those after them.

    Args:
        motion: how the robot moves.
        course: what courses are like.
        rewards: see ``CourseRewards``.
        courses: number of courses of training.
        test_courses: number of courses of tests.
        seed: of the courses.
        max_steps: an episode is truncated after this many steps.

    Raises:
        ValueError: for a motion without physics, or a number out of range.
    """

    name: ClassVar[str]
    """Of a place, on maps."""
    jitter: ClassVar[tuple[float, float, float, float]]
    """Largest distance of a start from that of its course along x, y and z, metres, and of its yaw, radians."""
    chooses_episodes = True
    motion: PhysicsMotion
    places: Tensor  # [N, 1 + P, 4] float64, start and places of each course: x, y, z and yaw

    def __init__(
        self,
        motion: PhysicsMotion,
        course: CourseSettings,
        rewards: CourseRewards | None,
        courses: int,
        test_courses: int,
        seed: int,
        max_steps: int,
    ):
        if not isinstance(motion, PhysicsMotion):
            raise ValueError(f"task.motion: expected one with physics, got {type(motion).__name__}")
        super().__init__(motion, max_steps)
        for key, count in (("courses", courses), ("test_courses", test_courses)):
            require_number(f"task.{key}", count, 1, 4096, whole=True)
        require_number("task.seed", seed, 0, 2**63 - 1, whole=True)
        self.course, self.rewards = course, rewards or CourseRewards()
        self.courses, self.test_courses, self.seed = courses, test_courses, seed
        self.goals_for_success = course.length
        self.register_buffer("places", torch.zeros(0, 0, 4, dtype=torch.float64), persistent=False)

    def settle(self) -> None:
        """Draw the courses, after the motion was put into a scene, and give each a model of its own.

        Raises:
            ValueError: where there is no room for a course.
        """
        motion, many = self.motion, self.courses + self.test_courses
        bounds, ceiling = (motion.twin.lower.tolist(), motion.twin.upper.tolist()), motion.ceiling or math.inf
        places = torch.from_numpy(draw_courses(motion.terrain, *bounds, self.course, many, self.seed, ceiling))
        self.places = places.to(self.places.device)
        models = bank(motion.physics.models[0], replace(motion.variation, models=many))
        for model, course in zip(models, places, strict=True):
            self._furnish(model, course[1:])
        motion.physics = Physics(models, motion.physics.substeps, motion.threads)

    @property
    def memory_spec(self) -> Mapping[str, TensorSpec]:
        """See the class."""
        return {
            "passed": Unbounded(shape=(1,), dtype=torch.int64),
            "next_place": Unbounded(shape=(4,), dtype=torch.float32),
        }

    def start(self, state: Tensor, anywhere: Anywhere) -> Tensor:
        """Begin courses of training; see ``Task.start``."""
        rows = torch.randint(self.courses, (len(state),), generator=anywhere.generator, device=state.device)
        return self._begun(rows, anywhere.generator)

    def begin(self, state: Tensor, anywhere: Anywhere) -> Memory:
        """No place was passed; see ``Task.begin``."""
        return self._memory(state, torch.zeros(len(state), dtype=torch.int64, device=state.device))

    def episodes(self, starts: Tensor, count: int, seed: int) -> dict[str, Tensor]:
        """Starts of the courses of tests, in turn; see ``ChoosingTask``."""
        generator = torch.Generator().manual_seed(seed)
        state = self._begun(self.courses + torch.arange(count) % self.test_courses, generator)
        return {"state": state, **self.begin(state, Anywhere(lambda: state, generator))}

    def judge(self, step: Step, anywhere: Anywhere) -> Verdict:
        """Judge a step; see ``Task.judge``."""
        rewards, after, passed = self.rewards, step.move.state, step.memory["passed"].squeeze(1)
        place, was, now = self._place(after, passed), self._position(step.before), self._position(after)
        crashed = (step.move.free_fraction < 1) | self._crashed(after)
        outside = ~crashed & (self._outside(after) | ~after.isfinite().all(1))
        through = self._passes(was, now, place) & ~crashed & ~outside
        before, left = ((at - place[:, : at.shape[1]]).norm(dim=1) for at in (was, now))
        reward = rewards.progress * (before - torch.where(through, 0.0, left)) + rewards.passed * through
        reward = (reward + rewards.crash * (crashed | outside) + rewards.slack).float()
        passed = passed + through
        outcome = torch.where(through, Outcome.GOAL, Outcome.RUNNING)
        outcome = torch.where(outside, Outcome.OUT_OF_BOUNDS, torch.where(crashed, Outcome.COLLISION, outcome))
        terminated = (passed >= self.course.length) | crashed | outside
        memory = self._memory(after, passed)
        return Verdict(reward.unsqueeze(1), terminated.unsqueeze(1), outcome.unsqueeze(1), memory)

    def marks(self, memory: Memory | None = None) -> list[Mark]:
        """The next place; see ``Task.marks``."""
        return [] if memory is None else [Mark(self.name, memory["next_place"][[0, 1, 3]].double().cpu())]

    def _furnish(self, model: Any, places: Tensor) -> None:
        """Put what stands at places [P, 4] into the physics of their course, an ``MjModel``; by default nothing."""

    def _crashed(self, state: Tensor) -> Tensor:
        """Whether robots crashed though they touched nothing: [B, n] -> [B] bool."""
        return torch.zeros(len(state), dtype=torch.bool, device=state.device)

    @abstractmethod
    def _outside(self, state: Tensor) -> Tensor:
        """Whether robots left the bounds: [B, n] -> [B] bool."""

    @abstractmethod
    def _position(self, state: Tensor) -> Tensor:
        """Where robots are, as far as places are: [B, n] -> [B, 2 or 3] float64."""

    @abstractmethod
    def _passes(self, was: Tensor, now: Tensor, place: Tensor) -> Tensor:
        """Whether straight ways pass places: [B, 2 or 3], [B, 2 or 3], [B, 4] -> [B] bool."""

    def _begun(self, rows: Tensor, generator: torch.Generator) -> Tensor:
        """States at rest near the starts of some courses: [B] -> [B, n]."""
        start = self.places[rows, 0]
        off = 2.0 * torch.rand(len(rows), 4, generator=generator, device=start.device, dtype=torch.float64) - 1.0
        return self.motion.with_model(self._placed(start + off * off.new_tensor(self.jitter)), rows)

    def _placed(self, start: Tensor) -> Tensor:
        """States at rest: [B, 4] x, y, z and yaw -> [B, n]."""
        return self.motion.placed(start[:, [0, 1, 3]])

    def _place(self, state: Tensor, passed: Tensor) -> Tensor:
        """The next place of each state, the last one after it was passed; -1 is the start: [B, 4] float64."""
        return self.places[self.motion.model_of(state), 1 + passed.clamp(-1, self.course.length - 1)]

    def _memory(self, state: Tensor, passed: Tensor) -> Memory:
        return {"passed": passed.unsqueeze(1), "next_place": self._place(state, passed).float()}
