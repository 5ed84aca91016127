"""The walk task: a legged robot walks to a mark that it sees with its camera."""

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from splatrl.envs.tasks.base import Memory
from splatrl.envs.tasks.course import CourseRewards
from splatrl.envs.tasks.fitting import require_part
from splatrl.envs.tasks.route import Route
from splatrl.envs.teachers.walker import walk_to
from splatrl.motions.legs import WalkMotion
from splatrl.physics.routes import RouteSettings
from splatrl.values import require_number


class Walk(Route):
    """Walk to a ball that hovers in the scene, from any initial heading, on legs that already know how to walk.

    A course is a route of one waypoint, the mark, or of several. A fall ends an episode, as does touching anything but
    the ground. ``Route`` and ``Course`` describe the rest.

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
        course: settings from which routes are generated.
        courses: number of training routes.
        test_courses: number of test routes.
        seed: seed of the routes.
        ahead_deg: maximum initial angle between the robot's heading and the mark, degrees.
        reach: horizontal distance between torso and mark at which the mark is reached, metres.
        mark_radius: radius of the ball, metres.
        mark_rgb: colour of the mark, red, green and blue in [0, 1].
        later_rgb: colour of the mark after it, on routes with several.
        leeway: distance beyond the bounds at which the robot counts as outside, metres.
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
        require_part("motion", motion, WalkMotion, "a legged robot that walks", "walk")
        require_number("task.ahead_deg", ahead_deg, 0.0, 180.0)
        course = course or RouteSettings(distance=(1.0, 2.5), clearance=0.4, waypoints=1)
        super().__init__(
            motion, rewards, course, courses, test_courses, seed, reach=reach, mark_radius=mark_radius,
            mark_rgb=mark_rgb, later_rgb=later_rgb, leeway=leeway, max_steps=max_steps,
        )  # fmt: skip
        self.ahead = math.radians(ahead_deg)

    def teach(self, state: Tensor, memory: Memory) -> Tensor:
        """Return the actions of a walker that knows the state: [B, n] -> [B, 2]; see ``walk_to``."""
        mark = self._place(state, memory["passed"].squeeze(1))[:, :2]
        return walk_to(self.motion.planar(state), mark, self.motion.limits)

    def _begun(self, rows: Tensor, generator: torch.Generator) -> Tensor:
        start = self.places[rows, 0].clone()
        share = torch.rand(len(rows), generator=generator, device=start.device, dtype=torch.float64)
        start[:, 3] += self.ahead * (2.0 * share - 1.0)
        return self.motion.layout.with_model(self._placed(start), rows)
