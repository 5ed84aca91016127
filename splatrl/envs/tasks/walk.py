"""The walk task: a robot on legs walks to a mark that its camera sees."""

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from splatrl.envs.sensors.odometry import wrapped
from splatrl.envs.tasks.base import Memory
from splatrl.envs.tasks.course import CourseRewards
from splatrl.envs.tasks.route import Route
from splatrl.motions.legs import WalkMotion
from splatrl.physics.routes import RouteSettings
from splatrl.values import require_number

SEEN = math.radians(40.0)
"""Angle to the mark, from ahead, within which the teacher relies on its being seen; beyond it turns to the left."""
SPEED = 0.75
"""Share of the highest speed at which the teacher walks straight ahead."""
BEND = 2.0
"""Radians per second for each radian by which the teacher is off."""


class Walk(Route):
    """Walk to a ball that hovers in the scene, wherever the robot looks at first, on legs that know how to walk.

    A way is a route of one waypoint, the mark, or of several. A fall ends an episode as touching anything but the
    ground does. ``Route`` and ``Course`` say the rest.

    Observation: ``pixels`` [B, H, W, 3] uint8, the ego view, which sways as the robot walks.
    Action: [B, 2] float32, metres per second ahead and radians per second to the left, see ``WalkMotion``.
    State: [B, n] float64, see ``LegsMotion``.

    Example:
        >>> import splatrl
        >>> env = splatrl.make_env(["task=walk", "task.courses=1", "task.test_courses=1"], batch_size=[2])
        >>> env.rollout(3, break_when_any_done=False)["next_place"].shape
        torch.Size([2, 3, 4])

    Args:
        motion: how the robot walks.
        rewards: see ``CourseRewards``.
        course: what ways are like.
        courses: number of ways of training.
        test_courses: number of ways of tests.
        seed: of the ways.
        ahead_deg: in the beginning the mark is within this angle of where the robot looks, degrees.
        reach: distance of the torso's centre from the mark at which it is reached, metres.
        mark_radius: metres.
        mark_rgb: its colour.
        later_rgb: colour of the one after it, on ways of several.
        leeway: metres beyond the bounds after which the robot is lost.
        max_steps: an episode is truncated after this many steps.

    Raises:
        ValueError: for a motion that does not walk, or a number out of range.
    """

    name = "mark"
    motion: WalkMotion

    def __init__(
        self,
        motion: WalkMotion,
        rewards: CourseRewards | None = None,
        course: RouteSettings | None = None,
        courses: int = 256,
        test_courses: int = 64,
        seed: int = 0,
        ahead_deg: float = 180.0,
        reach: float = 0.5,
        mark_radius: float = 0.15,
        mark_rgb: Sequence[float] = (0.85, 0.1, 0.75),
        later_rgb: Sequence[float] = (0.2, 0.45, 0.9),
        leeway: float = 0.3,
        max_steps: int = 100,
    ):
        if not isinstance(motion, WalkMotion):
            raise ValueError(f"task.motion: expected legs that walk, got {type(motion).__name__}")
        require_number("task.ahead_deg", ahead_deg, 0.0, 180.0)
        course = course or RouteSettings(distance=(1.0, 2.5), clearance=0.4, waypoints=1)
        super().__init__(
            motion, rewards, course, courses, test_courses, seed, reach=reach, mark_radius=mark_radius,
            mark_rgb=mark_rgb, later_rgb=later_rgb, leeway=leeway, max_steps=max_steps,
        )  # fmt: skip
        self.ahead = math.radians(ahead_deg)

    def teach(self, state: Tensor, memory: Memory) -> Tensor:
        """What one does who knows where the mark is, [B, n] -> [B, 2]: turn to it, to the left while it is not seen."""
        robot, place = self.motion.planar(state), self._place(state, memory["passed"].squeeze(1))
        away = place[:, :2] - robot[:, :2]
        off = wrapped(torch.atan2(away[:, 1], away[:, 0]) - robot[:, 2])
        seen, high = off.abs() < SEEN, self.motion.limits[1].to(state)
        speed = torch.where(seen, SPEED * high[0] * off.cos() ** 4, 0.0)
        turn = torch.where(seen, (BEND * off).clamp(-high[1], high[1]), high[1])
        return torch.stack([speed, turn], 1).float()

    def _crashed(self, state: Tensor) -> Tensor:
        return self.motion.fallen(state)

    def _begun(self, rows: Tensor, generator: torch.Generator) -> Tensor:
        start = self.places[rows, 0].clone()
        share = torch.rand(len(rows), generator=generator, device=start.device, dtype=torch.float64)
        start[:, 3] += self.ahead * (2.0 * share - 1.0)
        return self.motion.with_model(self._placed(start), rows)
