"""Base class of tasks in which robots pass the places of a course in order."""

import math
from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import torch
from torch import Tensor
from torchrl.data import TensorSpec, Unbounded

from splatrl.envs.tasks.base import Anywhere, Mark, Memory, Outcome, Step, Verdict
from splatrl.envs.tasks.fitting import require_part
from splatrl.envs.tasks.module import TaskModule
from splatrl.envs.tasks.rewards import FiniteRewards
from splatrl.motions.physics import PhysicsMotion
from splatrl.motions.site import Fits, Site
from splatrl.physics.bank import bank
from splatrl.physics.courses import CourseSettings, draw_courses
from splatrl.values import require_number


@dataclass(frozen=True)
class CourseRewards(FiniteRewards):
    """Terms of the reward, which are summed in each step.

    Attributes:
        progress: per metre by which the robot came nearer to the next place; passing it counts as reaching its centre.
        passed: for passing a place.
        crash: for touching anything, falling over, or leaving the bounds.
        slack: added in every step.

    Raises:
        ValueError: for a reward that is not a finite number.
    """

    progress: float = 1.0
    passed: float = 1.0
    crash: float = -3.0
    slack: float = -0.01


class Course(TaskModule):
    """Pass all places of a course in order without touching anything; courses are generated in the scene from a seed.

    Subclasses define what courses look like, how robots begin, and when a place counts as passed.

    Reward: [B, 1] float32, see ``CourseRewards``.
    Termination: at the last place, which is a success; when anything is touched or the robot falls over; when the
        robot leaves the bounds.
    Truncation: after ``max_steps`` steps.
    State: [B, n] float64, the physics' (``PhysicsMotion``), whose first value is the number of the course. Memory:
        ``passed`` [B, 1] int64, number of places passed; ``next_place`` [B, 4] float32, pose of the next place in the
        world frame (the last place, once that is passed), x, y and z in metres and yaw in radians, for sensors and for
        training a critic on it.

    Training uses the first ``courses`` of them, evaluation the ``test_courses`` that follow.

    Args:
        motion: how the robot moves.
        course: settings from which courses are generated.
        rewards: see ``CourseRewards``.
        courses: number of training courses.
        test_courses: number of test courses.
        seed: seed of the courses.
        max_steps: an episode is truncated after this many steps.

    Raises:
        ValueError: for a motion without physics, rewards of another kind, or a number out of range.
    """

    name: ClassVar[str]
    """Name of a place on maps."""
    jitter: ClassVar[tuple[float, float, float, float]]
    """Maximum random offset from the start of the course along x, y and z, metres, and in yaw, radians."""
    chooses_episodes = True
    varies = False
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
        require_part("motion", motion, PhysicsMotion, "a motion with physics", "physics")
        super().__init__(motion, max_steps)
        for key, count in (("courses", courses), ("test_courses", test_courses)):
            require_number(f"task.{key}", count, 1, 4096, whole=True)
        require_number("task.seed", seed, 0, 2**63 - 1, whole=True)
        self.course, self.rewards = course, rewards or CourseRewards()
        require_part("rewards", self.rewards, CourseRewards, "the rewards of a course", "course")
        self.courses, self.test_courses, self.seed = courses, test_courses, seed
        self.goals_for_success = course.length
        self.register_buffer("places", torch.zeros(0, 0, 4, dtype=torch.float64), persistent=False)

    def settle(self, site: Site, fits: Fits) -> Fits:
        """Generate the courses; see ``Task.settle``."""
        fits = super().settle(site, fits)
        self.generate_courses()
        return fits

    def generate_courses(self) -> None:
        """Generate the courses on the motion's terrain, and a physics model for each.

        Raises:
            ValueError: if there is no room for a course.
        """
        motion, many = self.motion, self.courses + self.test_courses
        bounds, ceiling = (motion.twin.lower.tolist(), motion.twin.upper.tolist()), motion.ceiling or math.inf
        places = torch.from_numpy(draw_courses(motion.terrain, *bounds, self.course, many, self.seed, ceiling))
        self.places = places.to(self.places.device)
        models = bank(motion.physics.models[0], replace(motion.variation, models=many))
        for model, course in zip(models, places, strict=True):
            self._furnish(model, course[1:])
        motion.obey(models)

    @property
    def memory_spec(self) -> Mapping[str, TensorSpec]:
        """Specs of the memory; see the class."""
        return {
            "passed": Unbounded(shape=(1,), dtype=torch.int64),
            "next_place": Unbounded(shape=(4,), dtype=torch.float32),
        }

    def start(self, state: Tensor, anywhere: Anywhere) -> Tensor:
        """Begin at random training courses; see ``Task.start``."""
        rows = torch.randint(self.courses, (len(state),), generator=anywhere.generator, device=state.device)
        return self._begun(rows, anywhere.generator)

    def begin(self, state: Tensor, anywhere: Anywhere) -> Memory:
        """Return a memory in which no place has been passed; see ``Task.begin``."""
        return self._memory(state, torch.zeros(len(state), dtype=torch.int64, device=state.device))

    def goals_reached(self, state: Tensor, memory: Memory) -> Tensor:
        """Return the number of places passed; see ``Task.goals_reached``."""
        return memory["passed"].clone()

    def episodes(self, starts: Tensor, count: int, seed: int) -> dict[str, Tensor]:
        """Return starts that cycle through the test courses; see ``ChoosingTask``."""
        generator = torch.Generator().manual_seed(seed)
        state = self._begun(self.courses + torch.arange(count) % self.test_courses, generator)
        return {"state": state, **self.begin(state, Anywhere(lambda: state, generator))}

    def judge(self, step: Step, anywhere: Anywhere) -> Verdict:
        """Judge a step; see ``Task.judge``."""
        rewards, after, passed = self.rewards, step.move.state, step.memory["passed"].squeeze(1)
        place, was, now = self._place(after, passed), self._position(step.before), self._position(after)
        crashed = (step.move.free_fraction < 1) | self._crashed(after)
        outside = ~crashed & (self._outside(after) | step.move.failed)
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
        """Return a mark at the next place; see ``Task.marks``."""
        return [] if memory is None else [Mark(self.name, memory["next_place"][[0, 1, 3]].double().cpu())]

    def _furnish(self, model: Any, places: Tensor) -> None:
        """Add the objects at places [P, 4] to the physics of their course, an ``MjModel``; by default there is none."""

    def _crashed(self, state: Tensor) -> Tensor:
        """Return whether robots crashed without touching anything: [B, n] -> [B] bool."""
        return torch.zeros(len(state), dtype=torch.bool, device=state.device)

    @abstractmethod
    def _outside(self, state: Tensor) -> Tensor:
        """Return whether robots left the bounds: [B, n] -> [B] bool."""

    @abstractmethod
    def _position(self, state: Tensor) -> Tensor:
        """Return positions of robots in the dimensions in which places are compared: [B, n] -> [B, 2 or 3] float64."""

    @abstractmethod
    def _passes(self, was: Tensor, now: Tensor, place: Tensor) -> Tensor:
        """Return whether straight moves pass places: [B, 2 or 3], [B, 2 or 3], [B, 4] -> [B] bool."""

    def _begun(self, rows: Tensor, generator: torch.Generator) -> Tensor:
        """Draw states at rest near the starts of given courses: [B] -> [B, n]."""
        start = self.places[rows, 0]
        off = 2.0 * torch.rand(len(rows), 4, generator=generator, device=start.device, dtype=torch.float64) - 1.0
        return self.motion.layout.with_model(self._placed(start + off * off.new_tensor(self.jitter)), rows)

    def _placed(self, start: Tensor) -> Tensor:
        """Return states at rest at given poses: [B, 4] x, y, z and yaw -> [B, n]."""
        return self.motion.placed(start[:, [0, 1, 3]])

    def _place(self, state: Tensor, passed: Tensor) -> Tensor:
        """Return the place after ``passed`` others, at most the last one; -1 gives the start: [B, 4] float64."""
        return self.places[self.motion.model_of(state), 1 + passed.clamp(-1, self.course.length - 1)]

    def _memory(self, state: Tensor, passed: Tensor) -> Memory:
        return {"passed": passed.unsqueeze(1), "next_place": self._place(state, passed).float()}
