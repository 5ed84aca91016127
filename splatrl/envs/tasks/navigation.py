"""The base of Habitat-style navigation tasks: reach the goal of the episode and signal arrival by stopping."""

import copy
import math
import warnings
from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor
from torchrl.data import Bounded, TensorSpec, Unbounded

from splatrl.collision.base import Checker
from splatrl.curriculum.geodesics import Geodesics
from splatrl.curriculum.ground import ground
from splatrl.envs.tasks.base import Anywhere, Mark, Memory, Outcome, Step, Verdict
from splatrl.envs.tasks.fitting import misfit, require_part
from splatrl.envs.tasks.module import TaskModule
from splatrl.envs.tasks.rewards import FiniteRewards
from splatrl.envs.teachers.pathfinder import lead
from splatrl.motions.base import PlannedMotion, Steering
from splatrl.motions.site import Fits, Site, narrowed
from splatrl.values import require_number

WHO_STOPS = "a robot with physics can by two <velocity> servos, forward and turn"
TRIES = 50
"""Rounds in which ``episodes`` looks for pairs of a start and a goal."""


@dataclass(frozen=True)
class NavigationRewards(FiniteRewards):
    """Terms of the reward, as in habitat-baselines' ``NavRLEnv`` (Savva et al. 2019): progress + slack + success.

    Attributes:
        progress: per metre by which the geodesic distance to the goal decreased.
        slack: added in every step.
        success: for stopping at the goal.

    Raises:
        ValueError: for a reward that is not a finite number.
    """

    progress: float = 1.0
    slack: float = -0.01
    success: float = 2.5


class NavigationTask(TaskModule):
    """Go to a goal that is drawn with each start, and stop there.

    Action: the motion's, some of which mean stop: the first action of ``NavigateMotion``; with ``DriveMotion`` and
        robots with physics that take its actions, both velocities within a tenth of their limits, as in Habitat's
        ``VelocityAction``.
    Reward: [B, 1] float32; the decrease in geodesic distance to the goal, metres, minus a slack penalty, plus a bonus
        for stopping at the goal (``NavigationRewards``).
    Termination: at a stop, which is a success if the geodesic distance to the goal after it is below
        ``success_distance``. A robot that touches something, or would leave the bounds, stays, slides or is pushed back
        as its motion defines, and the episode continues. It ends where a robot with physics falls over, which counts
        as a collision, leaves the bounds by more than ``leeway``, or its physics fails.
    Truncation: after ``max_steps`` steps.
    State: the motion's. Memory: ``goal`` [B, 3] float32, x and y in metres and yaw in radians; ``goal_row`` [B, 1]
        int64, the goal's number; ``distance_to_goal``, ``start_distance`` and ``path_length`` [B, 1] float32, metres;
        ``collisions`` [B, 1] int64.

    Distances are geodesic: lengths of the shortest path on which the body fits (``Geodesics``). The goals of a scene
    are a seeded set of mutually connected places, some for training and others for tests; any start may be paired with
    any of them that is neither too near nor too far. Episodes begin only where a training goal is at such a distance.

    Args:
        motion: how the robots move.
        rewards: see ``NavigationRewards``.
        success_distance: geodesic distance to the goal below which a stop succeeds, metres.
        nearest: minimum geodesic distance from a start to its goal, metres.
        farthest: maximum geodesic distance from a start to its goal, metres.
        goals: number of training goals in each scene.
        test_goals: number of test goals in each scene.
        cell: cell size of the grid on which paths are found, metres.
        seed: seed of the goals.
        leeway: distance beyond the bounds at which a robot whose moves are not reverted counts as outside, metres.
        max_steps: an episode is truncated after this many steps.

    Raises:
        ValueError: for a motion without ``steering``, rewards of another kind, or a number out of range.
    """

    chooses_episodes = True
    ways_out = "try other values of task.nearest, task.farthest and robot.height, or a smaller robot.body"
    given_together = ("goal", "goal_row", "start_distance", "distance_to_goal")

    def __init__(
        self,
        motion: PlannedMotion,
        rewards: NavigationRewards | None = None,
        success_distance: float = 0.2,
        nearest: float = 1.0,
        farthest: float = 30.0,
        goals: int = 64,
        test_goals: int = 32,
        cell: float = 0.05,
        seed: int = 0,
        leeway: float = 0.3,
        max_steps: int = 500,
    ):
        if motion.steering is None:
            raise misfit("motion", motion, f"a motion that can stop ({WHO_STOPS})", "navigate", "drive")
        super().__init__(motion, max_steps)
        require_number("task.success_distance", success_distance, high=1e6, above=0.0)
        require_number("task.nearest", nearest, 0.0, 1e6)
        require_number("task.farthest", farthest, nearest, 1e6)
        require_number("task.goals", goals, 1, 10**5, whole=True)
        require_number("task.test_goals", test_goals, 1, 10**5, whole=True)
        require_number("task.cell", cell, 1e-3, 1e3)
        require_number("task.leeway", leeway, 0.0, 1e3)
        require_number("task.seed", seed, 0, 2**63 - 1, whole=True)
        self.rewards = rewards or NavigationRewards()
        require_part("rewards", self.rewards, NavigationRewards, "the rewards of navigation", "navigation")
        self.success_distance, self.nearest, self.farthest = success_distance, nearest, farthest
        self.goal_counts, self.cell, self.seed = (goals, test_goals), cell, seed
        self.leeway = leeway if motion.leaves else 0.0
        self.geodesics: Geodesics

    @property
    def steering(self) -> Steering:
        """Knows which actions stop or lead in a direction."""
        steering = self.motion.steering
        assert steering is not None
        return steering

    @property
    def goal_radius(self) -> float:
        """Geodesic distance to the goal below which a stop succeeds, metres."""
        return self.success_distance

    def settle(self, site: Site, fits: Fits) -> Fits:
        """Choose the goals of a scene; episodes begin where one of them is in range. See ``Task.settle``."""
        fits = super().settle(site, fits)
        if self.motion.action_names and site.repeats * self.motion.step >= 2 * self.success_distance:
            times = f"{site.repeats} × " if site.repeats > 1 else ""
            warnings.warn(
                f"task.motion.step: robots may step over a goal unless an action moves them less than twice "
                f"task.success_distance={self.success_distance:g}, got {times}{self.motion.step:g}",
                stacklevel=2,
            )
        two_nodes = site.body.half_width + 0.5 * site.occupancy.resolution  # in the way of any wall, so each has a side
        if self.cell > two_nodes + 1e-9:
            warnings.warn(
                f"task.cell: distances beside a wall one voxel thick may be those behind it, unless a cell is at most "
                f"half the body's width plus half a voxel, {two_nodes:g} m, got {self.cell:g}",
                stacklevel=2,
            )
        self.choose_goals(site.checker, fits)
        connected, within = self.geodesics.grounds[0].connected, self.geodesics.within

        def suit(poses: Tensor) -> Tensor:
            place = self.motion.planar_of(poses)[:, :2].float()
            return connected(place) & within(place, self.nearest, self.farthest)

        return narrowed(fits, suit)

    def choose_goals(self, checker: Checker, fits: Fits | None = None) -> None:
        """Choose goals and compute distances to them; the task cannot be used before.

        Args:
            checker: finds where the robot fits.
            fits: body_to_world [N, 4, 4] -> [N] bool, an additional condition on robot poses; None allows all.

        Raises:
            ValueError: if the robot fits nowhere, or every path to a goal is shorter than ``nearest``.
        """
        self.geodesics = Geodesics.drawn(ground(self.motion, checker, self.cell, fits), *self.goal_counts, self.seed)
        longest = self.geodesics.longest
        if longest < self.nearest:
            raise ValueError(
                f"task.nearest: expected at most {longest:.2f} m, the length of the longest path to a goal, "
                f"got {self.nearest:g}"
            )

    @property
    def memory_spec(self) -> Mapping[str, TensorSpec]:
        """Specs of the memory; see the class."""
        number = Unbounded(shape=(1,), dtype=torch.float32)
        count = Unbounded(shape=(1,), dtype=torch.int64)
        measures = {key: number.clone() for key in ("distance_to_goal", "start_distance", "path_length")}
        goal = Unbounded(shape=(3,), dtype=torch.float32)
        row = Bounded(0, len(self.geodesics.goals) - 1, shape=(1,), dtype=torch.int64)
        return {"goal": goal, "goal_row": row, **measures, "collisions": count}

    def begin(self, state: Tensor, anywhere: Anywhere) -> Memory:
        """Draw a goal for each start; see ``Task.begin``."""
        place, generator = self._place(state), anywhere.generator
        row = self.geodesics.draw(place, self.nearest, self.farthest, generator)
        yaw = math.tau * torch.rand(len(state), 1, generator=generator, device=state.device)
        return self.episode(state, row, yaw)

    def episode(self, state: Tensor, row: Tensor, yaw: Tensor) -> dict[str, Tensor]:
        """Return what is remembered at the start of episodes with given goals.

        Args:
            state: [B, ...] start states.
            row: [B] int64, rows of the goals in ``geodesics``.
            yaw: [B, 1] float32, yaw of the goals, radians.
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
        """Draw test starts and goals in one scene from a seed; with several scenes, select one with ``at``.

        Args:
            starts: [S, ...] states in which episodes may begin.
            count: number of episodes, N.
            seed: seed of everything that is drawn.

        Returns:
            ``state`` [N, ...], and the result of ``episode`` for each.

        Raises:
            ValueError: if too few starts and goals are found whose distance is in the requested range.
        """
        generator = torch.Generator().manual_seed(seed)
        found: list[dict[str, Tensor]] = []
        left = count
        for _ in range(TRIES):
            state = starts[torch.randint(len(starts), (count,), generator=generator)]
            state = self.motion.varied(state, generator)
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
            f"task.nearest, task.farthest: expected {count} pairs of a start and a goal {self.nearest} to "
            f"{self.farthest} m apart, found only {count - left}"
        )

    def in_scene(self, episodes: Mapping[str, Tensor], scene: int) -> dict[str, Tensor]:
        """Renumber the goals, which are counted over all scenes; see ``ChoosingTask``."""
        return {**episodes, "goal_row": episodes["goal_row"] + self.geodesics.begins[scene].cpu()}

    def with_goals(self, state: Tensor, goal: Tensor, scene: Tensor) -> "tuple[NavigationTask, Memory]":
        """Return a copy that knows the shortest paths to further goals, and its memory; see ``GoalTask``.

        Goals stay where they are, while distances lead to the nearest node.
        """
        task = copy.copy(self)
        task._modules = dict(self._modules)
        task.geodesics, rows = self.geodesics.with_goals(goal[:, :2].double().numpy(), scene.numpy())
        place = self._place(state)
        if cut_off := (~task.geodesics.reachable(place, rows)).nonzero().flatten().tolist():
            got = [round(value, 3) for value in place[cut_off[0]].tolist()]
            raise ValueError(f"episode {cut_off[0]}: expected a start from which its goal can be reached, got {got}")
        return task, task.episode(state, rows, goal[:, 2:]) | {"goal": goal}

    def judge(self, step: Step, anywhere: Anywhere) -> Verdict:
        """Judge a step; see ``Task.judge``."""
        memory, move = step.memory, step.move
        stops = self.steering.stops(step.action).unsqueeze(1)
        lost = (move.failed | self.motion.outside(move.state, self.leeway)).unsqueeze(1)
        place, before = self._place(move.state), self._place(step.before)
        far = self.geodesics.distance(place, memory["goal_row"].squeeze(1)).unsqueeze(1)
        fallen = self.motion.fallen(move.state)
        blocked = (move.free_fraction < 1) | fallen
        if not self.motion.leaves:
            blocked |= ~move.inside
        blocked, ends = blocked.unsqueeze(1), lost | fallen.unsqueeze(1)
        success = stops & ~ends & (far < self.success_distance)
        rewards = self.rewards
        reward = rewards.slack + rewards.progress * (memory["distance_to_goal"] - far) + rewards.success * success
        outcome = torch.where(blocked, Outcome.COLLISION, torch.full_like(memory["goal_row"], Outcome.RUNNING))
        outcome = torch.where(stops & ~ends, torch.where(success, Outcome.GOAL, Outcome.STOPPED), outcome)
        outcome = torch.where(lost, Outcome.OUT_OF_BOUNDS, outcome)
        measured = {
            "distance_to_goal": far,
            "path_length": memory["path_length"] + (place - before).norm(dim=1, keepdim=True),
            "collisions": memory["collisions"] + blocked,
        }
        return Verdict(reward, stops | ends, outcome, {**memory, **measured})

    def teach(self, state: Tensor, memory: Memory) -> Tensor:
        """Return the actions of a teacher that knows the shortest path; see ``lead``."""
        return self.steering.toward(*self.led(state, memory))

    def led(self, state: Tensor, memory: Memory) -> tuple[Tensor, Tensor]:
        """Return the angle from the heading to the shortest path, radians, and whether to stop here: [B] each."""
        robot, row = self.motion.planar(state).float(), memory["goal_row"].squeeze(1)
        turn, arrived = lead(self.geodesics, self.steering, robot, row)
        far = self.geodesics.distance(robot[:, :2], row)
        return turn, (far < self.success_distance) & (arrived | (far < 0.5 * self.success_distance))

    def marks(self, memory: Memory | None = None) -> list[Mark]:
        """Return a mark at the episode's goal; see ``Task.marks``."""
        return [] if memory is None else [Mark("goal", memory["goal"].double())]

    def _place(self, state: Tensor) -> Tensor:
        return self.motion.planar(state)[:, :2].float()
