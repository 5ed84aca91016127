"""The route task: a car drives from waypoint to waypoint without touching anything."""

from collections.abc import Sequence

import torch
from torch import Tensor

from splatrl.envs.tasks.base import Memory
from splatrl.envs.tasks.course import Course, CourseRewards
from splatrl.envs.teachers.chauffeur import drive_to
from splatrl.geometry import rigid
from splatrl.motions.physics import PhysicsMotion
from splatrl.physics.gaussians import Models
from splatrl.physics.marks import ball
from splatrl.physics.routes import RouteSettings
from splatrl.renderers.parts import Parts
from splatrl.scenes.gaussians import Gaussians
from splatrl.values import require_number, require_rgb

LIFT = 0.15
"""Height of a mark's centre above the ground, metres, since the ground may be grass."""


class Route(Course):
    """Drive along a route of waypoints in order without touching anything, using a camera, as in DriveEnvNeRF.

    A ball of one colour hovers above the next waypoint, and one of another colour above the waypoint after it. Cars
    drive through the balls. A waypoint is passed within ``reach``; a car that is more than ``leeway`` beyond the bounds
    has left them. A robot that falls over has crashed. ``Course`` describes the rest.

    Observation: ``pixels`` [B, H, W, 3] uint8, the ego view.
    Action: the motion's; for ``car`` [B, 2] float32, speed in metres per second and mean steering angle in radians.

    Example:
        >>> import splatrl
        >>> env = splatrl.make_env(["task=route", "task.courses=1", "task.test_courses=1"], batch_size=[2])
        >>> env.rollout(3, break_when_any_done=False)["passed"].flatten().tolist()
        [0, 0, 0, 0, 0, 0]

    Args:
        motion: how the robot moves; its actions are a speed and a steering angle, or those of the actuators forward
            and turn, which take velocities.
        rewards: see ``CourseRewards``.
        course: settings from which routes are generated.
        courses: number of training routes.
        test_courses: number of test routes.
        seed: seed of the routes.
        reach: distance between car and waypoint at which the waypoint is passed, metres.
        wheelbase: wheelbase of the car, used by the teacher, metres; of no use for robots that turn on the spot.
        mark_radius: radius of the balls, metres.
        mark_rgb: colour of the next waypoint's ball, red, green and blue in [0, 1].
        later_rgb: colour of the ball at the waypoint after it.
        leeway: distance beyond the bounds at which the car counts as outside, metres.
        max_steps: an episode is truncated after this many steps.

    Raises:
        ValueError: for a motion without physics or with other actions, or a number out of range.
    """

    name = "waypoint"
    jitter = (0.05, 0.05, 0.0, 0.2)
    course: RouteSettings

    def __init__(
        self,
        motion: PhysicsMotion,
        rewards: CourseRewards | None = None,
        course: RouteSettings | None = None,
        courses: int = 64,
        test_courses: int = 32,
        seed: int = 0,
        reach: float = 0.2,
        wheelbase: float = 0.22,
        mark_radius: float = 0.12,
        mark_rgb: Sequence[float] = (1.0, 0.45, 0.05),
        later_rgb: Sequence[float] = (0.2, 0.45, 0.9),
        leeway: float = 0.1,
        max_steps: int = 200,
    ):
        super().__init__(motion, course or RouteSettings(), rewards, courses, test_courses, seed, max_steps)
        for name, value in (("reach", reach), ("wheelbase", wheelbase), ("mark_radius", mark_radius)):
            require_number(f"task.{name}", value, 1e-3, 1e3)
        require_number("task.leeway", leeway, 0.0, 1e3)
        for name, rgb in (("mark_rgb", mark_rgb), ("later_rgb", later_rgb)):
            require_rgb(f"task.{name}", rgb)
        if motion.limits.shape[1] != 2:
            raise ValueError(
                "task.motion: expected two actions, speed and steering angle or turn rate, "
                f"got {motion.limits.shape[1]} actions"
            )
        self.reach, self.wheelbase, self.leeway = reach, wheelbase, leeway
        self.balls = Models((ball(mark_radius, mark_rgb), ball(mark_radius, later_rgb)))

    @property
    def models(self) -> list[Gaussians]:
        """Models of the robot's links and the two balls."""
        return [*self.motion.models, *self.balls]

    def teach(self, state: Tensor, memory: Memory) -> Tensor:
        """Return the actions of a driver that knows the state: [B, n] -> [B, 2]; see ``drive_to``."""
        passed = memory["passed"].squeeze(1)
        last, goal = (self._place(state, passed + later)[:, :2] for later in (-1, 0))
        wheelbase = None if self.motion.driven else self.wheelbase
        return drive_to(self.motion.planar(state), last, goal, wheelbase, self.motion.limits)

    def parts(self, state: Tensor, memory: Memory) -> Parts:
        """Place the scene, the car, and the balls of the next two waypoints; see ``Task.parts``."""
        moving, own = self.motion.parts(state), len(self.motion.models)
        passed = memory["passed"].squeeze(1)
        poses, models = [], []
        for later in range(2):
            place = self._place(state, passed + later)[:, :3] + state.new_tensor([0.0, 0.0, LIFT])
            poses.append(rigid(torch.eye(3, device=place.device).expand(len(place), 3, 3), place.float()))
            shown = passed + later < self.course.waypoints
            models.append(torch.where(shown, own + 1 + later, -1))
        return Parts(
            torch.cat([moving.model, torch.stack(models, 1)], 1),
            torch.cat([moving.model_to_world, torch.stack(poses, 1)], 1),
        )

    def _crashed(self, state: Tensor) -> Tensor:
        return self.motion.fallen(state)

    def _outside(self, state: Tensor) -> Tensor:
        return self.motion.outside(state, self.leeway)

    def _position(self, state: Tensor) -> Tensor:
        return self.motion.planar(state)[:, :2]

    def _passes(self, was: Tensor, now: Tensor, place: Tensor) -> Tensor:
        return (now - place[:, :2]).norm(dim=1) <= self.reach
