"""The route task: a car drives from waypoint to waypoint without touching anything."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace

import torch
from torch import Tensor
from torchrl.data import TensorSpec, Unbounded

from splatrl.envs.tasks.base import Anywhere, Mark, Memory, Outcome, Step, TaskModule, Verdict
from splatrl.envs.tasks.rewards import FiniteRewards
from splatrl.geometry import rigid
from splatrl.motions.physics import PhysicsMotion
from splatrl.physics.bank import bank
from splatrl.physics.chauffeur import drive_to
from splatrl.physics.gaussians import Models
from splatrl.physics.marks import ball
from splatrl.physics.room import drawn_once
from splatrl.physics.routes import RouteSettings, draw_routes
from splatrl.physics.stepping import Physics
from splatrl.renderers.parts import Parts
from splatrl.scenes.gaussians import Gaussians
from splatrl.values import require_number

LIFT = 0.15
"""How far the middle of a mark is above the ground, metres: ground is grass, too."""
JITTER = (0.05, 0.05, 0.2)
"""Largest distance of a start from that of its route along x and y, metres, and of its heading, radians."""


@dataclass(frozen=True)
class RouteRewards(FiniteRewards):
    """The reward of a step, which adds up.

    Attributes:
        progress: for each metre by which the car came nearer to the next waypoint.
        waypoint: for a waypoint that was reached.
        crash: for touching anything, or leaving the bounds.
        slack: of every step.

    Raises:
        ValueError: for a reward that is not a finite number.
    """

    progress: float = 1.0
    waypoint: float = 1.0
    crash: float = -3.0
    slack: float = -0.01


class Route(TaskModule):
    """Drive along a route of waypoints in order without touching anything, as in DriveEnvNeRF, seen by a camera.

    A ball of one colour hovers above the next waypoint, one of another colour above the one after it. Cars drive
    through them.

    Observation: ``pixels`` [B, H, W, 3] uint8, the ego view.
    Action: the motion's: of ``car`` [B, 2] float32, speed in metres per second and mean steering angle in radians.
    Reward: [B, 1] float32, see ``RouteRewards``.
    Termination: at the last waypoint, which is a success; where anything but the ground is touched; where the car
        leaves the bounds by more than ``leeway``.
    Truncation: after ``max_steps`` steps.
    State: [B, n] float64, the physics' (``PhysicsMotion``), whose first number is that of the route. Memory: ``passed``
        [B, 1] int64, how many waypoints were reached; ``waypoint`` [B, 3] float32, the next one, world, metres, for
        sensors and for those who train a critic on it.

    Routes are drawn in the scene by ``seed``. Training drives the first ``routes``, tests those after them.

    Example:
        >>> import splatrl
        >>> env = splatrl.make_env(["task=route", "task.routes=1", "task.test_routes=1"], batch_size=[2])
        >>> env.rollout(3, break_when_any_done=False)["passed"].flatten().tolist()
        [0, 0, 0, 0, 0, 0]

    Args:
        motion: how the robot moves; its actions are a speed and a steering angle.
        rewards: see ``RouteRewards``.
        route: what routes are like.
        routes: number of routes of training.
        test_routes: number of routes of tests.
        seed: of the routes.
        reach: distance of the car from a waypoint at which it is reached, metres.
        wheelbase: of the car, for its teacher, metres.
        mark_radius: of the balls, metres.
        mark_rgb: colour of the next waypoint.
        later_rgb: colour of the one after it.
        leeway: see above, metres.
        max_steps: an episode is truncated after this many steps.

    Raises:
        ValueError: for a motion without physics or with other actions, or a number out of range.
    """

    chooses_episodes = True
    motion: PhysicsMotion
    places: Tensor  # [N, 1 + W, 3] float64, start and waypoints of each route: x, y and yaw

    def __init__(
        self,
        motion: PhysicsMotion,
        rewards: RouteRewards | None = None,
        route: RouteSettings | None = None,
        routes: int = 64,
        test_routes: int = 32,
        seed: int = 0,
        reach: float = 0.2,
        wheelbase: float = 0.22,
        mark_radius: float = 0.12,
        mark_rgb: Sequence[float] = (1.0, 0.45, 0.05),
        later_rgb: Sequence[float] = (0.2, 0.45, 0.9),
        leeway: float = 0.1,
        max_steps: int = 200,
    ):
        if not isinstance(motion, PhysicsMotion):
            raise ValueError(f"task.motion: expected one with physics, got {type(motion).__name__}")
        super().__init__(motion, max_steps)
        self.rewards, self.route = rewards or RouteRewards(), route or RouteSettings()
        for name, count in (("routes", routes), ("test_routes", test_routes)):
            require_number(f"task.{name}", count, 1, 4096, whole=True)
        for name, value in (("reach", reach), ("wheelbase", wheelbase), ("mark_radius", mark_radius)):
            require_number(f"task.{name}", value, 1e-3, 1e3)
        require_number("task.leeway", leeway, 0.0, 1e3)
        require_number("task.seed", seed, 0, 2**63 - 1, whole=True)
        if motion.limits.shape[1] != 2:
            raise ValueError(
                f"task.motion: expected a speed and a steering angle, got {motion.limits.shape[1]} actions"
            )
        self.routes, self.test_routes, self.seed, self.leeway = routes, test_routes, seed, leeway
        self.reach, self.wheelbase = reach, wheelbase
        self.balls = Models((ball(mark_radius, mark_rgb), ball(mark_radius, later_rgb)))
        self.goals_for_success = self.route.waypoints
        self.register_buffer("places", torch.zeros(0, 0, 3, dtype=torch.float64), persistent=False)

    def settle(self) -> None:
        """Draw the routes, after the motion was put into a scene, and give each a model of its own.

        Raises:
            ValueError: where there is no room for a route.
        """
        terrain, many = self.motion.terrain, self.routes + self.test_routes
        where = self.motion.twin.lower.tolist(), self.motion.twin.upper.tolist()
        places = drawn_once(
            "routes",
            terrain,
            [*where, asdict(self.route), many, self.seed],
            lambda: draw_routes(terrain, *where, self.route, many, self.seed),
        )
        self.places = torch.from_numpy(places).to(self.places.device)
        physics, variation = self.motion.physics, replace(self.motion.variation, models=many)
        self.motion.physics = Physics(bank(physics.models[0], variation), physics.substeps, self.motion.threads)

    @property
    def models(self) -> list[Gaussians]:
        """The robot's links and two balls."""
        return [*self.motion.models, *self.balls]

    @property
    def memory_spec(self) -> Mapping[str, TensorSpec]:
        """See the class."""
        return {
            "passed": Unbounded(shape=(1,), dtype=torch.int64),
            "waypoint": Unbounded(shape=(3,), dtype=torch.float32),
        }

    def start(self, state: Tensor, anywhere: Anywhere) -> Tensor:
        """Begin routes of training; see ``Task.start``."""
        rows = torch.randint(self.routes, (len(state),), generator=anywhere.generator, device=state.device)
        return self._begun(rows, anywhere.generator)

    def begin(self, state: Tensor, anywhere: Anywhere) -> Memory:
        """No waypoint was reached; see ``Task.begin``."""
        return self._memory(state, torch.zeros(len(state), dtype=torch.int64, device=state.device))

    def episodes(self, starts: Tensor, count: int, seed: int) -> dict[str, Tensor]:
        """Starts of the routes of tests, in turn; see ``ChoosingTask``."""
        generator = torch.Generator().manual_seed(seed)
        state = self._begun(self.routes + torch.arange(count) % self.test_routes, generator)
        return {"state": state, **self.begin(state, Anywhere(lambda: state, generator))}

    def judge(self, step: Step, anywhere: Anywhere) -> Verdict:
        """Judge a step; see ``Task.judge``."""
        rewards, after = self.rewards, step.move.state
        passed = step.memory["passed"].squeeze(1)
        goal = self._waypoint(after, passed)
        far = [(self.motion.planar(state)[:, :2] - goal).norm(dim=1) for state in (step.before, after)]
        crashed = step.move.free_fraction < 1
        outside = ~crashed & (self._outside(after) | ~after.isfinite().all(1))
        reached = (far[1] <= self.reach) & ~crashed & ~outside
        passed = passed + reached
        reward = rewards.progress * (far[0] - far[1]) + rewards.waypoint * reached + rewards.crash * (crashed | outside)
        outcome = torch.where(reached, Outcome.GOAL, Outcome.RUNNING)
        outcome = torch.where(outside, Outcome.OUT_OF_BOUNDS, torch.where(crashed, Outcome.COLLISION, outcome))
        terminated = (passed >= self.route.waypoints) | crashed | outside
        reward = (reward + rewards.slack).float().unsqueeze(1)
        return Verdict(reward, terminated.unsqueeze(1), outcome.unsqueeze(1), self._memory(after, passed))

    def teach(self, state: Tensor, memory: Memory) -> Tensor:
        """What a driver that knows the state would do: [B, n] -> [B, 2]; see ``drive_to``."""
        passed = memory["passed"].squeeze(1)
        last, goal = self._waypoint(state, passed - 1), self._waypoint(state, passed)
        return drive_to(self.motion.planar(state), last, goal, self.wheelbase, self.motion.limits)

    def parts(self, state: Tensor, memory: Memory) -> Parts:
        """The scene, the car, the next waypoint and the one after it; see ``Task.parts``."""
        moving, own = self.motion.parts(state), len(self.motion.models)
        passed = memory["passed"].squeeze(1)
        poses, models = [], []
        for later in range(2):
            place = self._on_ground(self._waypoint(state, passed + later))
            poses.append(rigid(torch.eye(3, device=place.device).expand(len(place), 3, 3), place.float()))
            shown = passed + later < self.route.waypoints
            models.append(torch.where(shown, own + 1 + later, -1))
        return Parts(
            torch.cat([moving.model, torch.stack(models, 1)], 1),
            torch.cat([moving.model_to_world, torch.stack(poses, 1)], 1),
        )

    def marks(self, memory: Memory | None = None) -> list[Mark]:
        """The next waypoint; see ``Task.marks``."""
        if memory is None:
            return []
        x, y, _ = memory["waypoint"].double().cpu()
        return [Mark("waypoint", torch.stack([x, y, torch.full_like(x, math.nan)]))]

    def _begun(self, rows: Tensor, generator: torch.Generator) -> Tensor:
        """States at rest near the starts of some routes: [B] -> [B, n]."""
        start = self.places[rows, 0]
        off = 2.0 * torch.rand(len(rows), 3, generator=generator, device=start.device, dtype=torch.float64) - 1.0
        state = self.motion.placed(start + off * off.new_tensor(JITTER))
        return self.motion.with_model(state, rows)

    def _waypoint(self, state: Tensor, passed: Tensor) -> Tensor:
        """The next waypoint of each state, the last one after it was reached; -1 is the start: [B, 2] float64."""
        return self.places[self.motion.model_of(state), 1 + passed.clamp(-1, self.route.waypoints - 1), :2]

    def _on_ground(self, places: Tensor) -> Tensor:
        """Places [B, 2] where balls hover: [B, 3] float64."""
        return torch.cat([places, (self.motion.terrain.height(places) + LIFT).unsqueeze(1)], 1)

    def _memory(self, state: Tensor, passed: Tensor) -> Memory:
        place = self._on_ground(self._waypoint(state, passed)).float()
        return {"passed": passed.unsqueeze(1), "waypoint": place}

    def _outside(self, state: Tensor) -> Tensor:
        lower, upper = self.motion.twin.lower - self.leeway, self.motion.twin.upper + self.leeway
        place = self.motion.planar(state)[:, :2]
        return ((place < lower) | (place > upper)).any(1)
