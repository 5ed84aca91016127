"""The walk task: a robot on legs walks to a mark that its camera sees."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor
from torchrl.data import TensorSpec, Unbounded

from splatrl.envs.sensors.odometry import wrapped
from splatrl.envs.tasks.base import Anywhere, Mark, Memory, Outcome, Step, TaskModule, Verdict
from splatrl.envs.tasks.rewards import FiniteRewards
from splatrl.geometry import rigid
from splatrl.motions.legs import WalkMotion
from splatrl.physics.courses import draw_courses
from splatrl.physics.gaussians import Models
from splatrl.physics.marks import ball
from splatrl.physics.routes import RouteSettings
from splatrl.renderers.parts import Parts
from splatrl.scenes.gaussians import Gaussians
from splatrl.values import require_number

SEEN = math.radians(40.0)
"""Angle to the mark, from ahead, within which the teacher relies on its being seen; beyond it turns to the left."""
SPEED = 0.75
"""Share of the highest speed at which the teacher walks straight ahead."""
BEND = 2.0
"""Radians per second for each radian by which the teacher is off."""


@dataclass(frozen=True)
class WalkRewards(FiniteRewards):
    """The reward of a step, which adds up.

    Attributes:
        progress: for each metre by which the robot came nearer to the mark.
        success: for reaching it.
        touch: of a step in which the robot touches something else than the ground.
        fall: for a fall, or leaving the bounds.
        slack: of every step.

    Raises:
        ValueError: for a reward that is not a finite number.
    """

    progress: float = 1.0
    success: float = 3.0
    touch: float = -0.1
    fall: float = -3.0
    slack: float = -0.01


class Walk(TaskModule):
    """Walk to a ball that hovers in the scene, wherever it is in the beginning, on legs that know how to walk.

    Observation: ``pixels`` [B, H, W, 3] uint8, the ego view, which sways as the robot walks.
    Action: [B, 2] float32, metres per second ahead and radians per second to the left, see ``WalkMotion``.
    Reward: [B, 1] float32, see ``WalkRewards``.
    Termination: where the torso's centre is within ``reach`` of the mark, which is a success; a fall; where the robot
        leaves the bounds by more than ``leeway``. A robot that touches something goes on.
    Truncation: after ``max_steps`` steps.
    State: [B, n] float64, see ``LegsMotion``. Memory: ``goal`` [B, 3] float32, x and y of the mark, world, metres, and
        the yaw of the way to it, for sensors such as ``pointgoal`` and for those who train a critic on it.

    Ways, each with a start and a mark, are drawn in the scene by ``seed``, where a robot can go straight. Training
    walks the first ``courses``, tests those after them.

    Example:
        >>> import splatrl
        >>> env = splatrl.make_env(["task=walk", "task.courses=1", "task.test_courses=1"], batch_size=[2])
        >>> env.rollout(3, break_when_any_done=False)["goal"].shape
        torch.Size([2, 3, 3])

    Args:
        motion: how the robot walks.
        rewards: see ``WalkRewards``.
        course: what ways are like: ``distance`` and ``clearance`` of ``RouteSettings``, with one waypoint.
        courses: number of ways of training.
        test_courses: number of ways of tests.
        seed: of the ways.
        ahead_deg: in the beginning the mark is within this angle of where the robot looks, degrees.
        reach: distance from the mark at which it is reached, metres.
        mark_height: of the mark's centre above the ground, metres.
        mark_radius: metres.
        mark_rgb: its colour.
        leeway: see above, metres.
        max_steps: an episode is truncated after this many steps.

    Raises:
        ValueError: for a motion that does not walk, or a number out of range.
    """

    chooses_episodes = True
    motion: WalkMotion
    places: Tensor  # [N, 2, 3] float64, start and mark of each way: x, y and yaw

    def __init__(
        self,
        motion: WalkMotion,
        rewards: WalkRewards | None = None,
        course: RouteSettings | None = None,
        courses: int = 256,
        test_courses: int = 64,
        seed: int = 0,
        ahead_deg: float = 180.0,
        reach: float = 0.5,
        mark_height: float = 0.3,
        mark_radius: float = 0.15,
        mark_rgb: Sequence[float] = (0.85, 0.1, 0.75),
        leeway: float = 0.3,
        max_steps: int = 100,
    ):
        if not isinstance(motion, WalkMotion):
            raise ValueError(f"task.motion: expected legs that walk, got {type(motion).__name__}")
        super().__init__(motion, max_steps)
        self.rewards, self.course = rewards or WalkRewards(), course or RouteSettings((1.0, 2.5), 0.0, 0.4, waypoints=1)
        for name, count in (("courses", courses), ("test_courses", test_courses)):
            require_number(f"task.{name}", count, 1, 4096, whole=True)
        for name, value in (("reach", reach), ("mark_radius", mark_radius)):
            require_number(f"task.{name}", value, 1e-3, 1e3)
        for name, value in (("leeway", leeway), ("mark_height", mark_height)):
            require_number(f"task.{name}", value, 0.0, 1e3)
        require_number("task.ahead_deg", ahead_deg, 0.0, 180.0)
        require_number("task.seed", seed, 0, 2**63 - 1, whole=True)
        self.courses, self.test_courses, self.seed, self.leeway = courses, test_courses, seed, leeway
        self.ahead, self.reach, self.mark_height = math.radians(ahead_deg), reach, mark_height
        self.drawn = Models([ball(mark_radius, mark_rgb)])
        self.register_buffer("places", torch.zeros(0, 2, 3, dtype=torch.float64), persistent=False)

    def settle(self) -> None:
        """Draw the ways, after the motion was put into a scene.

        Raises:
            ValueError: where there is no room for a way.
        """
        terrain, many = self.motion.terrain, self.courses + self.test_courses
        where = self.motion.twin.lower.tolist(), self.motion.twin.upper.tolist()
        places = draw_courses(terrain, *where, self.course, many, self.seed)
        self.places = torch.from_numpy(places[:, :2, [0, 1, 3]]).to(self.places.device)

    @property
    def models(self) -> list[Gaussians]:
        """The robot's links and the mark."""
        return [*self.motion.models, *self.drawn]

    @property
    def memory_spec(self) -> Mapping[str, TensorSpec]:
        """See the class."""
        return {"goal": Unbounded(shape=(3,), dtype=torch.float32)}

    def start(self, state: Tensor, anywhere: Anywhere) -> Tensor:
        """Stand where ways of training begin; see ``Task.start``."""
        rows = torch.randint(self.courses, (len(state),), generator=anywhere.generator, device=state.device)
        return self._begun(rows, anywhere.generator)

    def begin(self, state: Tensor, anywhere: Anywhere) -> Memory:
        """The mark of the way that begins where each robot stands; see ``Task.begin``."""
        begins = self.places[:, 0, :2]
        rows = (self.motion.planar(state)[:, None, :2] - begins).square().sum(2).argmin(1)
        return {"goal": self.places[rows, 1].float()}

    def episodes(self, starts: Tensor, count: int, seed: int) -> dict[str, Tensor]:
        """Starts of the ways of tests, in turn; see ``ChoosingTask``."""
        generator = torch.Generator().manual_seed(seed)
        state = self._begun(self.courses + torch.arange(count) % self.test_courses, generator)
        return {"state": state, **self.begin(state, Anywhere(lambda: state, generator))}

    def judge(self, step: Step, anywhere: Anywhere) -> Verdict:
        """Judge a step; see ``Task.judge``."""
        rewards, after, goal = self.rewards, step.move.state, step.memory["goal"]
        far = [(self.motion.planar(state)[:, :2] - goal[:, :2]).norm(dim=1) for state in (step.before, after)]
        fallen = self.motion.fallen(after)
        outside = ~fallen & self._outside(after)
        lost = fallen | outside
        reached = (far[1] <= self.reach) & ~lost
        reward = rewards.progress * (far[0] - far[1]) + rewards.success * reached + rewards.fall * lost
        reward = (reward + rewards.touch * (step.move.free_fraction < 1) + rewards.slack).nan_to_num()
        outcome = torch.where(reached, Outcome.GOAL, Outcome.RUNNING)
        outcome = torch.where(outside, Outcome.OUT_OF_BOUNDS, torch.where(fallen, Outcome.COLLISION, outcome))
        return Verdict(reward.float().unsqueeze(1), (reached | lost).unsqueeze(1), outcome.unsqueeze(1), {"goal": goal})

    def teach(self, state: Tensor, memory: Memory) -> Tensor:
        """What one does who knows where the mark is, [B, n] -> [B, 2]: turn to it, to the left while it is not seen."""
        robot, goal = self.motion.planar(state), memory["goal"].double()
        away = goal[:, :2] - robot[:, :2]
        off = wrapped(torch.atan2(away[:, 1], away[:, 0]) - robot[:, 2])
        seen = off.abs() < SEEN
        high = self.motion.limits[1].to(state)
        speed = torch.where(seen, SPEED * high[0] * off.cos() ** 4, 0.0)
        turn = torch.where(seen, (BEND * off).clamp(-high[1], high[1]), high[1])
        return torch.stack([speed, turn], 1).float()

    def parts(self, state: Tensor, memory: Memory) -> Parts:
        """The scene, the robot and the mark; see ``Task.parts``."""
        moving, goal = self.motion.parts(state), memory["goal"].double()
        z = self.motion.terrain.height(goal[:, :2]) + self.mark_height
        place = torch.cat([goal[:, :2], z.unsqueeze(1)], 1).float()
        pose = rigid(torch.eye(3, device=place.device).expand(len(place), 3, 3), place).unsqueeze(1)
        number = torch.full_like(moving.model[:, :1], len(self.motion.models) + 1)
        return Parts(torch.cat([moving.model, number], 1), torch.cat([moving.model_to_world, pose], 1))

    def marks(self, memory: Memory | None = None) -> list[Mark]:
        """The mark of an episode; see ``Task.marks``."""
        if memory is None:
            return []
        x, y, _ = memory["goal"].double().cpu()
        return [Mark("mark", torch.stack([x, y, torch.full_like(x, math.nan)]))]

    def _begun(self, rows: Tensor, generator: torch.Generator) -> Tensor:
        """States at rest where some ways begin, turned: [B] -> [B, n]."""
        start = self.places[rows, 0].clone()
        share = torch.rand(len(rows), generator=generator, device=start.device, dtype=torch.float64)
        start[:, 2] += self.ahead * (2.0 * share - 1.0)
        return self.motion.varied(self.motion.placed(start), generator)

    def _outside(self, state: Tensor) -> Tensor:
        lower, upper = self.motion.twin.lower - self.leeway, self.motion.twin.upper + self.leeway
        place = self.motion.planar(state)[:, :2]
        return ((place < lower) | (place > upper)).any(1)
