"""The push task: a robot with physics pushes a ball to a marked place."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor
from torchrl.data import TensorSpec, Unbounded

from splatrl.envs.tasks.base import Anywhere, Mark, Memory, Outcome, Step, Verdict
from splatrl.envs.tasks.fitting import require_part
from splatrl.envs.tasks.module import TaskModule
from splatrl.envs.tasks.push_places import PushPlaces, Ranges
from splatrl.envs.tasks.rewards import FiniteRewards
from splatrl.envs.teachers.pusher import pushing
from splatrl.geometry import rigid
from splatrl.motions.physics import PhysicsMotion
from splatrl.motions.site import Fits, Site, narrowed
from splatrl.physics.gaussians import Models
from splatrl.physics.kinematics import matrices
from splatrl.physics.marks import beacon
from splatrl.renderers.parts import Parts
from splatrl.scenes.gaussians import Gaussians
from splatrl.values import require_number, require_rgb

NEAR = 0.35
"""Distance to the ball below which coming nearer is not rewarded, so that there is room to go round it, metres."""
AROUND = 0.25
"""Metres of approach that a quarter turn round the ball, towards the side away from the mark, is worth."""
ROUNDING = 1e-6
"""Tolerance for the rounding of headings in ``settle``, which sees poses in single precision, radians."""
LIFT = 0.02
"""Height of a mark above the ground, metres, since the ground may be grass."""


@dataclass(frozen=True)
class PushRewards(FiniteRewards):
    """Terms of the reward, which are summed in each step.

    Attributes:
        progress: per metre by which the ball came nearer to the mark.
        approach: per metre by which the robot came nearer to where it can push the ball towards the mark.
        touch: for a step in which the robot touches anything that it is not meant to push.
        slack: added in every step.
        success: for the ball reaching the mark.
        lost: if the robot or the ball leaves the area, or the robot falls over.

    Raises:
        ValueError: for a reward that is not a finite number.
    """

    progress: float = 2.0
    approach: float = 1.0
    touch: float = -0.02
    slack: float = -0.01
    success: float = 3.0
    lost: float = -1.0


class Push(TaskModule):
    """Push a ball onto a mark on the ground, like NeRF2Real's humanoid (Byravan et al. 2023), but on wheels.

    Observation: ``pixels`` [B, H, W, 3] uint8, the ego view, with ball and mark in it, occluded by nearer surfaces.
    Action: the motion's; for ``wheels`` linear and angular velocity, [B, 2] float32, metres and radians per second.
    Reward: [B, 1] float32, see ``PushRewards``. The approach is measured by the distance to the ball in excess of
        0.35 m, and by how far round the ball the robot is from the side away from the mark.
    Termination: when the ball's centre is within ``success_distance`` of the mark's, which is a success; or when robot
        or ball leave the bounds by more than ``leeway``, or the robot falls over. A robot that touches something
        continues.
    Truncation: after ``max_steps`` steps.
    State: [B, n] float64, the physics' (``PhysicsMotion``). Memory: ``mark`` [B, 3] float32, world, metres; ``ball``
        [B, 3] float32, position of the ball, for sensors and for training a critic on it.

    A mark is a disc with a hovering ball above it, which can be seen from afar and over the ball being pushed; neither
    collides with anything. Ball and mark are placed at random in each episode, on the ground, where the robot can go
    round them.

    Example:
        >>> import splatrl
        >>> env = splatrl.make_env(["task=push"], batch_size=[4])
        >>> env.rollout(3, break_when_any_done=False)["mark"].shape
        torch.Size([4, 3, 3])

    Args:
        motion: how the robot moves; its things must include the ball.
        ball: name of the thing that is pushed.
        rewards: see ``PushRewards``.
        success_distance: distance between the centres of ball and mark that counts as success, metres.
        nearest: minimum initial distance between ball and mark, metres.
        farthest: maximum initial distance between ball and mark, metres.
        apart: minimum initial distance between robot and ball, metres.
        ahead_deg: maximum initial angle between the robot's heading and the ball, in either direction, degrees.
        turn_deg: maximum angle at the ball between straight on from the robot and the direction to the mark, degrees;
            180 allows marks anywhere, even behind the robot, which then has to drive round the ball.
        clearance: minimum distance between a ball or mark and obstacles, metres.
        mark_radius: radius of the drawn mark, metres.
        mark_rgb: colour of the mark, red, green and blue in [0, 1].
        mark_height: height of the ball that hovers above the mark, metres.
        leeway: distance beyond the bounds at which robot or ball count as lost, metres.
        max_steps: an episode is truncated after this many steps.

    Raises:
        ValueError: for a motion without physics or without the ball, rewards of another kind, or a number out of range.
    """

    chooses_episodes = True
    motion: PhysicsMotion

    def __init__(
        self,
        motion: PhysicsMotion,
        ball: str = "ball",
        rewards: PushRewards | None = None,
        success_distance: float = 0.15,
        nearest: float = 0.5,
        farthest: float = 1.5,
        apart: float = 0.4,
        ahead_deg: float = 40.0,
        turn_deg: float = 180.0,
        clearance: float = 0.4,
        mark_radius: float = 0.15,
        mark_rgb: Sequence[float] = (0.85, 0.1, 0.75),
        mark_height: float = 0.45,
        leeway: float = 0.5,
        max_steps: int = 150,
    ):
        require_part("motion", motion, PhysicsMotion, "a motion with physics", "physics")
        super().__init__(motion, max_steps)
        numbers = {"success_distance": success_distance, "mark_radius": mark_radius, "farthest": farthest}
        for name, value in numbers.items():
            require_number(f"task.{name}", value, high=1e6, above=0.0)
        least = {"apart": apart, "clearance": clearance, "leeway": leeway, "nearest": nearest}
        for name, value in {**least, "mark_height": mark_height}.items():
            require_number(f"task.{name}", value, 0.0, 1e6)
        require_number("task.ahead_deg", ahead_deg, 0.0, 180.0)
        require_number("task.turn_deg", turn_deg, 0.0, 180.0)
        if not success_distance < nearest < farthest:
            raise ValueError(
                f"task.nearest: expected success_distance < nearest < farthest, got {success_distance}, {nearest} and "
                f"{farthest}"
            )
        self.ball, self.rewards = motion.thing(ball), rewards or PushRewards()
        require_part("rewards", self.rewards, PushRewards, "the rewards of pushing", "push")
        self.success_distance = success_distance
        require_rgb("task.mark_rgb", mark_rgb)
        self.leeway, self.drawn = leeway, Models([beacon(mark_radius, mark_rgb, mark_height)])
        self.rest = float(motion.home[self.ball][2])  # height of the ball's centre above the ground
        ahead, turn = math.radians(ahead_deg) + ROUNDING, math.cos(math.radians(turn_deg)) - 1e-9
        ranges = Ranges(nearest, farthest, apart, ahead, turn)
        self.places = PushPlaces(motion.twin.lower, motion.twin.upper, ranges, clearance, leeway)
        self.places.find(motion.terrain)

    def settle(self, site: Site, fits: Fits) -> Fits:
        """Find the possible places of balls and marks; episodes begin where both fit ahead. See ``Task.settle``."""
        fits = super().settle(site, fits)
        self.places.find(self.motion.terrain)
        return narrowed(fits, lambda poses: self.places.suit(self.motion.planar_of(poses)))

    @property
    def models(self) -> list[Gaussians]:
        """Models of the robot's links, its things (the ball among them) and the mark."""
        return [*self.motion.models, *self.drawn]

    def start(self, state: Tensor, anywhere: Anywhere) -> Tensor:
        """Place the ball at random; see ``Task.start``."""
        state = self.motion.varied(state, anywhere.generator).clone()
        place = self.places.balls(self.motion.planar(state), anywhere.generator)
        state[:, self.ball][:, :3] = self._on_ground(place, self.rest)
        return state

    @property
    def memory_spec(self) -> Mapping[str, TensorSpec]:
        """Specs of the memory; see the class."""
        place = Unbounded(shape=(3,), dtype=torch.float32)
        return {"mark": place, "ball": place.clone()}

    def begin(self, state: Tensor, anywhere: Anywhere) -> Memory:
        """Draw a mark for the ball of each state; see ``Task.begin``."""
        ball = self._ball(state)
        place = self.places.marks(self.motion.planar(state), ball[:, :2], anywhere.generator)
        return {"mark": self._on_ground(place, LIFT).float(), "ball": ball.float()}

    def episodes(self, starts: Tensor, count: int, seed: int) -> dict[str, Tensor]:
        """Draw starts, balls and marks for tests; see ``ChoosingTask``."""
        generator = torch.Generator().manual_seed(seed)
        state = starts[torch.randint(len(starts), (count,), generator=generator)]
        anywhere = Anywhere(lambda: state, generator)
        state = self.start(state, anywhere)
        return {"state": state, **self.begin(state, anywhere)}

    def judge(self, step: Step, anywhere: Anywhere) -> Verdict:
        """Judge a step; see ``Task.judge``."""
        rewards, mark = self.rewards, step.memory["mark"].double()
        before, after = step.before, step.move.state
        was, ball = self._ball(before), self._ball(after)
        far_before, far = (_apart(one, mark) for one in (was, ball))
        approach = self._to_go(before, was, mark) - self._to_go(after, ball, mark)
        reached = far < self.success_distance
        lost = ~reached & (self._outside(ball) | self._outside(self.motion.planar(after)))
        lost |= ~reached & (step.move.failed | self.motion.fallen(after))
        reward = rewards.progress * (far_before - far) + rewards.approach * approach + rewards.slack
        reward += rewards.touch * (step.move.free_fraction < 1) + rewards.success * reached + rewards.lost * lost
        outcome = torch.where(reached, Outcome.GOAL, torch.where(lost, Outcome.OUT_OF_BOUNDS, Outcome.RUNNING))
        memory = {"mark": step.memory["mark"], "ball": ball.float()}
        return Verdict(reward.float().unsqueeze(1), (reached | lost).unsqueeze(1), outcome.unsqueeze(1), memory)

    @property
    def teaches(self) -> bool:
        """Whether the robot is driven by velocities."""
        return bool(self.motion.driven)

    def teach(self, state: Tensor, memory: Memory) -> Tensor | None:
        """Return the actions of a teacher that knows where everything is; None for a robot not driven by velocities.

        See ``pushing``.
        """
        if not self.teaches:
            return None
        mark = memory["mark"][:, :2].to(state)
        action = pushing(self.motion.planar(state), self._ball(state)[:, :2], mark, self.places.room)
        low, high = self.motion.limits
        return action.clamp(low, high)

    def parts(self, state: Tensor, memory: Memory) -> Parts:
        """Place the scene, the robot, the ball and the mark; see ``Task.parts``."""
        moving = self.motion.parts(state)
        mark = memory["mark"]
        tilt = matrices(self.motion.terrain.upright.to(mark.device))
        pose = rigid(tilt.float().expand(len(mark), 3, 3), mark).unsqueeze(1)
        number = torch.full_like(moving.model[:, :1], len(self.motion.models) + 1)
        return Parts(torch.cat([moving.model, number], 1), torch.cat([moving.model_to_world, pose], 1))

    def marks(self, memory: Memory | None = None) -> list[Mark]:
        """Return marks at an episode's ball and mark; see ``Task.marks``."""
        if memory is None:
            return []
        return [Mark(name, _placeless(memory[name])) for name in ("mark", "ball")]

    def _ball(self, state: Tensor) -> Tensor:
        return state[:, self.ball][:, :3]

    def _to_go(self, state: Tensor, ball: Tensor, mark: Tensor) -> Tensor:
        """Return how far robots are from where they can push, metres, including the way round the ball: [B] float64."""
        robot = self.motion.planar(state)[:, :2]
        away, along = robot - ball[:, :2], mark[:, :2] - ball[:, :2]
        far = away.norm(dim=1)
        cosine = (away * along).sum(1) / (far * along.norm(dim=1)).clamp_min(1e-9)
        return (far - NEAR).clamp_min(0.0) + AROUND * (1.0 + cosine)

    def _outside(self, places: Tensor) -> Tensor:
        lower, upper = self.motion.twin.lower - self.leeway, self.motion.twin.upper + self.leeway
        return ((places[:, :2] < lower) | (places[:, :2] > upper)).any(1)

    def _on_ground(self, places: Tensor, lift: float) -> Tensor:
        """Lift places [B, 2] to a height above the ground: [B, 3] float64."""
        z = self.motion.terrain.height(places) + lift / self.motion.terrain.plane[2].item()
        return torch.cat([places, z.unsqueeze(1)], 1)


def _apart(ball: Tensor, mark: Tensor) -> Tensor:
    """Return the horizontal distance between ball and mark: [B, 3], [B, 3] -> [B] metres."""
    return (ball[:, :2] - mark[:, :2]).norm(dim=1)


def _placeless(place: Tensor) -> Tensor:
    """Return x and y of a place, and NaN for the direction: [3] -> [3] float64."""
    return torch.cat([place[:2].double().cpu(), torch.tensor([math.nan], dtype=torch.float64)])
