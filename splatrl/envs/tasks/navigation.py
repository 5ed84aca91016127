"""The navigation tasks of Habitat's users: reach a goal of each episode's own, and say so."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import torch
from torch import Tensor
from torchrl.data import TensorSpec, Unbounded

from splatrl.collision.base import Checker
from splatrl.curriculum.geodesics import Geodesics, ground
from splatrl.envs.sensors.odometry import wrapped
from splatrl.envs.tasks.base import Anywhere, Mark, Memory, Outcome, Step, TaskModule, Verdict
from splatrl.envs.tasks.navigation_teacher import lead
from splatrl.envs.tasks.rewards import FiniteRewards
from splatrl.motions.planar import StoppingMotion
from splatrl.values import require_number

TRIES = 50
LOST = 16
"""Steps after which what an image told of the goal's place is worth no more, for the teacher of ``ImageNav``."""
ROUNDING = 1e-3
"""Of headings, radians."""


@dataclass(frozen=True)
class NavigationRewards(FiniteRewards):
    """The reward of a step, as in habitat-baselines' ``NavRLEnv`` (Savva et al. 2019): progress + slack + success.

    Attributes:
        progress: for each metre by which the goal has come nearer on the shortest way.
        slack: of every step.
        success: for stopping at the goal.

    Raises:
        ValueError: for a reward that is not a finite number.
    """

    progress: float = 1.0
    slack: float = -0.01
    success: float = 2.5


class NavigationTask(TaskModule):
    """Go to a goal that is drawn with each start, and stop there.

    Action: the motion's, of which some are stop: the first one of ``NavigateMotion``; with ``DriveMotion`` both
        velocities within a tenth of their limits, as Habitat's ``VelocityAction`` takes them.
    Reward: [B, 1] float32; the metres by which the shortest way to the goal became shorter, less a slack, and more for
        a stop at the goal (``NavigationRewards``).
    Termination: at a stop. It is a success where the shortest way to the goal is below ``success_distance``. A robot
        that touches something, or would leave the bounds, stays or slides as its motion says, and goes on.
    Truncation: after ``max_steps`` steps.
    State: [B, 3] float32, x and y in metres and yaw in radians. Memory: ``goal`` [B, 3] float32, likewise; ``goal_row``
        [B, 1] int64, its number; ``distance_to_goal``, ``start_distance`` and ``path_length`` [B, 1] float32, metres;
        ``collisions`` [B, 1] int64.

    Distances are those of the shortest way on which the body fits (``Geodesics``). The goals of a scene are a seeded
    set of places that are connected to each other, some for training and others for tests; any start may have any of
    them that is neither too near nor too far.

    Args:
        motion: how the robots move.
        rewards: see ``NavigationRewards``.
        success_distance: of the shortest way, metres.
        nearest: shortest way from a start to its goal, metres.
        farthest: longest way, metres.
        goals: number of goals for training in each scene.
        test_goals: number of those for tests.
        cell: of the grid on which ways are found, metres.
        seed: of the goals.
        max_steps: an episode is truncated after this many steps.

    Raises:
        ValueError: for a motion without stop or off the plane, or a number out of range.
    """

    chooses_episodes = True
    motion: StoppingMotion

    def __init__(
        self,
        motion: StoppingMotion,
        rewards: NavigationRewards | None = None,
        success_distance: float = 0.2,
        nearest: float = 1.0,
        farthest: float = 30.0,
        goals: int = 64,
        test_goals: int = 32,
        cell: float = 0.05,
        seed: int = 0,
        max_steps: int = 500,
    ):
        if not isinstance(motion, StoppingMotion):
            raise ValueError(
                f"task.motion: expected one that can stop, navigate or drive, got {type(motion).__name__}; "
                "type motion@task.motion=navigate"
            )
        super().__init__(motion, max_steps)
        require_number("task.success_distance", success_distance, 1e-6, 1e6)
        require_number("task.nearest", nearest, 0.0, 1e6)
        require_number("task.farthest", farthest, nearest, 1e6)
        require_number("task.goals", goals, 1, 10**5, whole=True)
        require_number("task.test_goals", test_goals, 1, 10**5, whole=True)
        require_number("task.cell", cell, 1e-3, 1e3)
        require_number("task.seed", seed, 0, 2**63 - 1, whole=True)
        self.rewards = rewards or NavigationRewards()
        self.success_distance, self.nearest, self.farthest = success_distance, nearest, farthest
        self.goal_counts, self.cell, self.seed = (goals, test_goals), cell, seed
        self.geodesics: Geodesics

    def settle(self, checker: Checker, fits: Callable[[Tensor], Tensor] | None = None) -> None:
        """Find the goals of a scene and the ways to them; the task is not complete before.

        Args:
            checker: tells where the robot fits.
            fits: body_to_world [N, 4, 4] -> [N] bool, where robots may be besides; None is everywhere.

        Raises:
            ValueError: where the robot fits nowhere, or no way to a goal is as long as the shortest that is asked.
        """
        self.geodesics = Geodesics.drawn(ground(self.motion, checker, self.cell, fits), *self.goal_counts, self.seed)
        longest = self.geodesics.longest
        if longest < self.nearest:
            raise ValueError(
                f"task.nearest: expected at most {longest:.2f} m, the longest way there is, got {self.nearest:g}"
            )

    @property
    def memory_spec(self) -> Mapping[str, TensorSpec]:
        """See the class."""
        number = Unbounded(shape=(1,), dtype=torch.float32)
        count = Unbounded(shape=(1,), dtype=torch.int64)
        measures = {key: number.clone() for key in ("distance_to_goal", "start_distance", "path_length")}
        goal = Unbounded(shape=(3,), dtype=torch.float32)
        return {"goal": goal, "goal_row": count, **measures, "collisions": count.clone()}

    def begin(self, state: Tensor, anywhere: Anywhere) -> Memory:
        """Draw a goal for each start; see ``Task.begin``."""
        place, generator = self._place(state), anywhere.generator
        row = self.geodesics.draw(place, self.nearest, self.farthest, generator)
        yaw = math.tau * torch.rand(len(state), 1, generator=generator, device=state.device)
        return self.episode(state, row, yaw)

    def episode(self, state: Tensor, row: Tensor, yaw: Tensor) -> dict[str, Tensor]:
        """What is remembered where episodes with given goals begin.

        Args:
            state: [B, 3] starts.
            row: [B] int64, rows of ``geodesics``.
            yaw: [B, 1] float32 of the goals, radians.
        """
        far = self.geodesics.distance(self._place(state), row).unsqueeze(1)
        return {
            "goal": torch.cat([self.geodesics.goals[row], yaw], 1),
            "goal_row": row.unsqueeze(1),
            "distance_to_goal": far,
            "start_distance": far.clone(),
            "path_length": torch.zeros_like(far),
            "collisions": torch.zeros_like(row).unsqueeze(1),
        }

    def episodes(self, starts: Tensor, count: int, seed: int) -> dict[str, Tensor]:
        """Starts and goals for tests in one scene, drawn by a seed; a scene of several is chosen by ``at``.

        Args:
            starts: [S, 3] states in which episodes may begin.
            count: number of episodes.
            seed: of what is drawn.

        Returns:
            ``state`` [N, 3], and what ``episode`` gives for each.

        Raises:
            ValueError: where no start and goal are as far from each other as asked.
        """
        generator = torch.Generator().manual_seed(seed)
        found: list[dict[str, Tensor]] = []
        left = count
        for _ in range(TRIES):
            state = starts[torch.randint(len(starts), (count,), generator=generator)]
            row = self.geodesics.draw(self._place(state), self.nearest, self.farthest, generator, tests=True)
            yaw = math.tau * torch.rand(count, 1, generator=generator)
            one = {"state": state, **self.episode(state, row, yaw)}
            far = one["start_distance"].squeeze(1)
            rows = ((far >= self.nearest) & (far <= self.farthest)).nonzero().squeeze(1)[:left]
            found.append({key: value[rows] for key, value in one.items()})
            left -= len(rows)
            if left == 0:
                return {key: torch.cat([each[key] for each in found]) for key in found[0]}
        raise ValueError(
            f"task.nearest, task.farthest: expected starts and goals {self.nearest} to {self.farthest} m apart, found "
            f"{count - left} of {count}"
        )

    def judge(self, step: Step, anywhere: Anywhere) -> Verdict:
        """Judge a step; see ``Task.judge``."""
        memory, move = step.memory, step.move
        stops = self.motion.stops(step.action).unsqueeze(1)
        place, before = self._place(move.state), self._place(step.before)
        far = self.geodesics.distance(place, memory["goal_row"].squeeze(1)).unsqueeze(1)
        blocked = ((move.free_fraction < 1) | ~move.inside).unsqueeze(1)
        success = stops & (far < self.success_distance)
        rewards = self.rewards
        reward = rewards.slack + rewards.progress * (memory["distance_to_goal"] - far) + rewards.success * success
        outcome = torch.where(blocked, Outcome.COLLISION, torch.full_like(memory["goal_row"], Outcome.RUNNING))
        outcome = torch.where(stops, torch.where(success, Outcome.GOAL, Outcome.STOPPED), outcome)
        measured = {
            "distance_to_goal": far,
            "path_length": memory["path_length"] + (place - before).norm(dim=1, keepdim=True),
            "collisions": memory["collisions"] + blocked,
        }
        return Verdict(reward, stops, outcome, {**memory, **measured})

    def teach(self, state: Tensor, memory: Memory) -> Tensor:
        """What one does who knows the shortest way; see ``lead``."""
        return self.motion.toward(*self._led(state, memory))

    def _led(self, state: Tensor, memory: Memory) -> tuple[Tensor, Tensor]:
        """Angle from the heading to the shortest way, radians, and whether the goal is near enough: [B] each."""
        row, motion = memory["goal_row"].squeeze(1), self.motion
        turn, arrived = lead(self.geodesics, motion.planar(state).float(), row, motion.reach, motion.angle_between)
        far = self.geodesics.distance(self._place(state), row)
        return turn, (far < self.success_distance) & (arrived | (far < 0.5 * self.success_distance))

    def beeline(self, state: Tensor, memory: Memory) -> Tensor:
        """What one does who knows distance and direction of the goal and nothing else; see ``teach``."""
        away = memory["goal"][:, :2] - self._place(state)
        turn = wrapped(torch.atan2(away[:, 1], away[:, 0]) - self.motion.planar(state)[:, 2].float())
        return self.motion.toward(turn, away.norm(dim=1) < self.success_distance)

    def marks(self, memory: Memory | None = None) -> list[Mark]:
        """The goal of an episode; see ``Task.marks``."""
        return [] if memory is None else [Mark("goal", memory["goal"].double())]

    def _place(self, state: Tensor) -> Tensor:
        return self.motion.planar(state)[:, :2].float()


class PointNav(NavigationTask):
    """Point-goal navigation (Anderson et al. 2018): the goal is told by its distance and direction.

    Observation: ``pointgoal_with_gps_compass`` [B, 2] float32, rho in metres and phi in radians, and what else
        ``sensors`` gives. A stop within 0.2 m is a success, as in the Habitat Challenge of 2019.
    Everything else: see ``NavigationTask``.

    Example:
        >>> import splatrl
        >>> env = splatrl.make_env(["task=pointnav"], batch_size=[4])
        >>> env.rollout(3, break_when_any_done=False)["pointgoal_with_gps_compass"].shape
        torch.Size([4, 3, 2])
    """


class ImageNav(NavigationTask):
    """Image-goal navigation (Zhu et al. 2017): the goal is told by what the camera sees there.

    Observation: ``imagegoal`` [B, H, W, 3] uint8, ``pixels``, and what else ``sensors`` gives. A stop within 1 m is a
        success, as in Mezghani et al. 2022.
    Memory: also ``unseen`` [B, 1] int64, steps since the robot last looked the way that the goal's camera looks.
    Everything else: see ``NavigationTask``.

    Example:
        >>> import splatrl
        >>> env = splatrl.make_env(["task=imagenav"], batch_size=[4])
        >>> env.reset()["imagegoal"].shape
        torch.Size([4, 64, 64, 3])
    """

    @property
    def memory_spec(self) -> Mapping[str, TensorSpec]:
        """See the class."""
        return {**super().memory_spec, "unseen": Unbounded(shape=(1,), dtype=torch.int64)}

    def episode(self, state: Tensor, row: Tensor, yaw: Tensor) -> dict[str, Tensor]:
        """What is remembered where episodes with given goals begin; see ``NavigationTask.episode``."""
        begun = super().episode(state, row, yaw)
        return begun | {"unseen": self._unseen(state, begun, torch.full_like(begun["goal_row"], LOST))}

    def judge(self, step: Step, anywhere: Anywhere) -> Verdict:
        """Judge a step; see ``Task.judge``."""
        verdict = super().judge(step, anywhere)
        unseen = self._unseen(step.move.state, step.memory, step.memory["unseen"])
        return verdict._replace(memory={**verdict.memory, "unseen": unseen})

    def teach(self, state: Tensor, memory: Memory) -> Tensor:
        """What one does who has to see where the goal is: only what a policy can tell from images is worth imitating.

        A robot that has not looked the way of the goal's image for ``LOST`` steps turns left until it does, as it can
        then compare the two. From there it takes the shortest way, and before it stops it looks that way once more.
        """
        turn, near = self._led(state, memory)
        aside, lost = self._aside(state, memory), memory["unseen"].squeeze(1) >= LOST
        turn = torch.where(lost, self.motion.angle_between, torch.where(near, aside, turn))
        return self.motion.toward(turn, near & ~lost & self._alike(aside))

    def _unseen(self, state: Tensor, memory: Memory, before: Tensor) -> Tensor:
        """Steps since robots looked the way of their goal's image, from those before: [B, 1] int64."""
        return torch.where(self._alike(self._aside(state, memory)).unsqueeze(1), 0, before + 1)

    def _aside(self, state: Tensor, memory: Memory) -> Tensor:
        """Angle from robots' headings to those of their goals: [B] float32 radians in [-π, π]."""
        return wrapped(memory["goal"][:, 2] - self.motion.planar(state)[:, 2].float())

    def _alike(self, aside: Tensor) -> Tensor:
        """Whether headings at an angle to the goal's are as close to it as turns allow: [B] -> [B] bool."""
        return aside.abs() <= 0.5 * self.motion.angle_between + ROUNDING
