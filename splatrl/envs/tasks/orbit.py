"""The circle, polar plane and hemisphere tasks: move around an object to a given viewpoint."""

import math
from collections.abc import Mapping, Sequence

import torch
from torch import Tensor

from splatrl.envs.tasks.base import Mark, Memory
from splatrl.envs.tasks.fitting import require_part
from splatrl.envs.tasks.pose_goal import SLACK
from splatrl.envs.tasks.rewards import OutcomeTask, Rewards
from splatrl.motions import OrbitMotion
from splatrl.motions.size import FARTHEST
from splatrl.values import require_number

UNIT = Rewards(step=0.0, goal=1.0, collision=-1.0, out_of_bounds=-1.0)


class Orbit(OutcomeTask):
    """Reach a given azimuth, distance and elevation around an origin that the camera always looks at.

    The motion's ranges yield the three tasks of the published code: on a circle only the azimuth varies, on a polar
    plane also the distance, and on a hemisphere the elevation as well.

    Observation: ``pixels`` [B, H, W, 3] uint8, the ego view.
    Action: [B] int64, + or − one step of azimuth, elevation or distance, for those that vary (``OrbitMotion``).
    Reward: [B, 1] float32; 0 per step, replaced by +1 at the goal, −1 on a collision, −1 out of range.
    Termination: collision, out of range or goal, in this order of precedence. The goal is reached if azimuth, distance
        and elevation are each at most one step away from it.
    Truncation: after ``max_steps`` steps.
    State: [B, 3] int64, lattice indices of azimuth, distance and elevation.

    The published code requires less than one step, gives −0.2 per step (``rewards.step``), and clamps the elevation to
    its limits, whereas here such a step ends the episode.

    Example:
        >>> import splatrl
        >>> env = splatrl.make_env(["task=circle"], batch_size=[2])
        >>> env.task.motion.action_names
        ('+azimuth', '-azimuth')

    Args:
        motion: how the camera moves.
        azimuth_deg: azimuth of the goal, degrees.
        distance: distance of the goal, metres.
        elevation_deg: elevation of the goal, degrees.
        rewards: reward of each outcome; out of bounds means outside the range of distances or elevations.
        max_steps: an episode is truncated after this many steps.

    Raises:
        ValueError: for any other kind of motion or rewards, or a goal that is not finite or out of the motion's range.
    """

    motion: OrbitMotion
    goal: Tensor  # [3] float64: x, y and yaw of the goal pose
    goal_sphere: Tensor  # [3] float64: azimuth, distance and elevation of the goal
    of_scene = ("goal",)
    ways_out = "try another task.azimuth_deg, task.distance or landmarks.object, or a smaller robot.body"

    def __init__(
        self,
        motion: OrbitMotion,
        azimuth_deg: float = 220.0,
        distance: float = 0.8,
        elevation_deg: float = 0.0,
        rewards: Rewards = UNIT,
        max_steps: int = 200,
    ):
        require_part("motion", motion, OrbitMotion, "a motion around an object", "orbit")
        super().__init__(motion, rewards, max_steps)
        given = {"azimuth_deg": azimuth_deg, "distance": distance, "elevation_deg": elevation_deg}
        for name, value in given.items():
            require_number(f"task.{name}", value, -FARTHEST, FARTHEST)
        values: Sequence[float] = (math.radians(azimuth_deg), distance, math.radians(elevation_deg))
        sphere = torch.tensor(values, dtype=torch.float64)
        _require_within(motion, sphere, given)
        reach = distance * math.cos(values[2])
        x, y = (float(motion.origin[i]) + reach * turn(values[0]) for i, turn in enumerate((math.cos, math.sin)))
        goal = torch.tensor([x, y, values[0] + math.pi], dtype=torch.float64)
        self.register_buffer("goal_sphere", sphere, persistent=False)
        self.register_buffer("goal", goal, persistent=False)

    def reached(self, state: Tensor) -> Tensor:
        """Return whether azimuth, distance and elevation are each within one step of the goal: [B, 3] -> [B] bool."""
        offset = (self.motion.sphere(state) - self.goal_sphere).abs()
        turn = offset[:, 0] % math.tau
        offset[:, 0] = torch.minimum(turn, math.tau - turn)
        return (offset <= self.motion.steps * (1 + SLACK)).all(1)

    def marks(self, memory: Memory | None = None) -> list[Mark]:
        """Return a mark at the goal pose, seen from above; see ``Task.marks``."""
        return [Mark("goal pose", self.goal)]


def _require_within(motion: OrbitMotion, sphere: Tensor, given: Mapping[str, float]) -> None:
    """Refuse a goal that no state of a motion reaches: more than a step beyond its distances or elevations.

    Args:
        motion: how the camera moves.
        sphere: [3] float64, azimuth, distance and elevation of the goal, radians and metres.
        given: the same as they were given, by name.
    """
    low, high = motion.sphere(torch.tensor([[0, 0, 0], [count - 1 for count in motion.shape]]))
    beyond = torch.maximum(low - sphere, sphere - high) > motion.steps * (1 + SLACK)
    for axis, unit in ((1, 1.0), (2, math.radians(1.0))):
        if beyond[axis]:
            name, value = list(given.items())[axis]
            ends = f"{float(low[axis]) / unit:g} to {float(high[axis]) / unit:g}"
            raise ValueError(f"task.{name}: expected at most a step beyond task.motion.{name}, {ends}, got {value}")
