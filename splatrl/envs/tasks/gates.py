"""The gates task: a quadrotor flies through a track of gates."""

import math
from typing import Any

import torch
from torch import Tensor

from splatrl.envs.tasks.base import Memory
from splatrl.envs.tasks.course import Course, CourseRewards
from splatrl.envs.teachers.pilot import Flying, fly_through
from splatrl.geometry import yaw_quat
from splatrl.motions.physics import PhysicsMotion
from splatrl.physics.tracks import TrackSettings
from splatrl.renderers.parts import Parts
from splatrl.scenes.gaussians import Gaussians
from splatrl.spherical_harmonics import C0
from splatrl.values import require_rgb

LOW = 0.08
"""Height above the ground below which a quadrotor counts as crashed, metres."""


class Gates(Course):
    """Fly through all gates of a track in order, guided by the on-board camera, like FalconGym's quadrotor.

    The gates stand in the scene: they appear in the image and are obstacles for collision. The next gate is lit. It is
    passed when the straight line that the quadrotor's centre moves along in a step crosses its opening in the direction
    of its yaw; crossing other gates has no effect. The ceiling is one of the bounds. ``Course`` describes the rest.

    Observation: ``pixels`` [B, H, W, 3] uint8, the ego view.
    Action: the motion's; for ``quadrotor`` [B, 4] float32, thrust in units of its weight and three body rates, rad/s.

    Example:
        >>> import splatrl
        >>> env = splatrl.make_env(["task=gates", "task.courses=1", "task.test_courses=1"], batch_size=[2])
        >>> env.rollout(3, break_when_any_done=False)["passed"].flatten().tolist()
        [0, 0, 0, 0, 0, 0]

    Args:
        motion: how the robot moves; its only thing is a gate, which is repeated for every gate of a track.
        rewards: see ``CourseRewards``.
        course: settings from which tracks are generated.
        courses: number of training tracks.
        test_courses: number of test tracks.
        seed: seed of the tracks.
        lit: colour of the next gate, red, green and blue in [0, 1].
        max_steps: an episode is truncated after this many steps.

    Raises:
        ValueError: for a motion without physics, without a ceiling, or with anything other than one thing, or a number
            out of range.
    """

    name = "gate"
    jitter = (0.1, 0.1, 0.1, 0.2)
    course: TrackSettings

    def __init__(
        self,
        motion: PhysicsMotion,
        rewards: CourseRewards | None = None,
        course: TrackSettings | None = None,
        courses: int = 48,
        test_courses: int = 32,
        seed: int = 0,
        lit: tuple[float, float, float] = (1.0, 0.45, 0.05),
        max_steps: int = 400,
    ):
        super().__init__(motion, course or TrackSettings(), rewards, courses, test_courses, seed, max_steps)
        if motion.ceiling is None:
            raise ValueError("task.motion.ceiling: expected a height in metres, got None")
        if len(motion.things.paths) != 1:
            raise ValueError(
                f"task.motion.things: expected only the gate of a track, got {', '.join(motion.things.paths) or 'none'}"
            )
        require_rgb("task.lit", lit)
        motion.repeat(self.course.gates)
        self.lit = tuple(map(float, lit))

    @property
    def models(self) -> list[Gaussians]:
        """Models of the robot's links, a gate, and a lit gate."""
        own, gate = self.motion.models[: -self.course.gates], self.motion.models[-1]
        lit = gate.clone()
        shade = (gate.sh[:, :1] * C0 + 0.5).mean(2, keepdim=True)
        lit.sh = ((torch.tensor(self.lit) * shade / shade.amax() - 0.5) / C0).float()
        return [*own, gate, lit]

    def teach(self, state: Tensor, memory: Memory) -> Tensor:
        """Return the actions of a pilot that knows the state: [B, n] -> [B, 4]; see ``fly_through``."""
        layout = self.motion.layout
        flying = Flying(state[:, layout.position], state[:, layout.orientation], state[:, layout.velocity])
        return fly_through(flying, self._place(state, memory["passed"].squeeze(1)), self.motion.limits)

    def parts(self, state: Tensor, memory: Memory) -> Parts:
        """Place the scene, the robot and the gates of its track, the next one lit; see ``Task.parts``."""
        moving, gates, own = self.motion.parts(state), self.course.gates, len(self.motion.models) - self.course.gates
        next_one = torch.arange(gates, device=state.device) == memory["passed"]
        model = torch.where(next_one, own + 2, own + 1)
        return Parts(torch.cat([moving.model[:, : 1 + own], model], 1), moving.model_to_world)

    def _furnish(self, model: Any, places: Tensor) -> None:
        for name, (x, y, z, yaw) in zip(self.motion.things.paths, places.tolist(), strict=True):
            body = model.body(self.motion.world.things[name]).id
            model.body_pos[body] = x, y, z
            model.body_quat[body] = yaw_quat(yaw)

    def _crashed(self, state: Tensor) -> Tensor:
        return (self.motion.above_ground(state) < LOW) | self.motion.fallen(state)

    def _outside(self, state: Tensor) -> Tensor:
        return ~self.motion.inside(state) | (self.motion.above_ground(state) > (self.motion.ceiling or math.inf))

    def _position(self, state: Tensor) -> Tensor:
        return state[:, self.motion.layout.position]

    def _passes(self, was: Tensor, now: Tensor, place: Tensor) -> Tensor:
        cos, sin = place[:, 3].cos(), place[:, 3].sin()
        a, b = was - place[:, :3], now - place[:, :3]
        before, after = (cos * p[:, 0] + sin * p[:, 1] for p in (a, b))
        crosses = (before < 0.0) & (after >= 0.0)
        share = before / torch.where(crosses, before - after, 1.0)
        at = a + share.unsqueeze(1) * (b - a)
        half = 0.5 * self.course.opening
        return crosses & ((cos * at[:, 1] - sin * at[:, 0]).abs() < half) & (at[:, 2].abs() < half)

    def _placed(self, start: Tensor) -> Tensor:
        state = super()._placed(start)
        state[:, self.motion.layout.position][:, 2] = start[:, 2]
        return state
