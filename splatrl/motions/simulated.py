"""What robots do once they stand in a MuJoCo world: how their states step, and what they say."""

import math
from collections.abc import Sequence

import torch
from torch import Tensor
from torchrl.data import Bounded

from splatrl.collision.base import Checker
from splatrl.geometry import planar_of, quat_yaws
from splatrl.motions.base import Move
from splatrl.motions.twin import TwinMotion
from splatrl.physics import Physics, StateLayout, Stepped, Terrain
from splatrl.physics.body_poses import BodyPoses
from splatrl.physics.kinematics import rotated, turned_back
from splatrl.physics.robot_world import RobotWorld
from splatrl.physics.standing import on_ground
from splatrl.renderers.parts import Parts

FAR = 1e9
"""Bound on the magnitude of every number in a state."""
TILTED = 0.5
"""Cosine of the first body's tilt from how it stands at or below which a robot has fallen."""


class SimulatedMotion(TwinMotion):
    """A motion that steps physics, for robots that a subclass puts into a world.

    Attributes:
        world: the robot among its things.
        terrain: what they stand on.
        physics: steps their states.
        layout: names the columns of states.
        bodies: places the bodies of states.
        hits: columns of the sensors that report contacts with what robots must not touch.
        limits: [2, nu] float32, lowest and highest controls.
        home: [n] float64, the state at rest at the origin.
        still: [nu] float64, controls at rest.
    """

    action_names: tuple[str, ...] = ()
    steps_on_host = True
    stacks = False
    world: RobotWorld
    terrain: Terrain
    physics: Physics
    layout: StateLayout
    bodies: BodyPoses
    hits: list[int]
    limits: Tensor
    home: Tensor
    still: Tensor

    @property
    def controls(self) -> Sequence[str]:
        """Names of the numbers of an action: those of the twin if the robot takes its actions, or of the actuators."""
        return self.twin.controls if self.driven else self.world.actuators()

    @property
    def action_spec(self) -> Bounded:
        """Spec of one robot's action: the control of each actuator, [nu] float32; no batch."""
        return Bounded(low=self.limits[0], high=self.limits[1], shape=(self.limits.shape[1],), dtype=torch.float32)

    @property
    def state_spec(self) -> Bounded:
        """Spec of one robot's state: finite numbers, [n] float64; no batch."""
        return Bounded(low=-FAR, high=FAR, shape=(len(self.home),), dtype=torch.float64)

    def move(self, state: Tensor, action: Tensor, checker: Checker) -> Move:
        """Step the physics; see ``Motion``. A robot whose physics fails keeps its state and counts as out of bounds."""
        ctrl = action.clamp(self.limits[0], self.limits[1])
        after, sensed, sound = self.physics.step(self.of_physics(state), ctrl)
        return self.moved(after, sensed, sound)

    def touched(self, sensed: Tensor) -> Tensor:
        """Return in which substeps robots touch what they must not touch: [B, S, s] -> [B, S] bool."""
        return (sensed[..., self.hits] > 0).any(2)

    def moved(self, after: Tensor, sensed: Tensor, sound: Tensor) -> Move:
        """Return the result of an action, given states after it [B, n], readings [B, S, s] and sound physics [B]."""
        touched = self.touched(sensed)
        first = touched.int().argmax(1)  # the first substep that touches
        free = torch.where(touched.any(1), first / touched.shape[1], 1.0).float()
        return Move(after, self.body_to_world(after), free, self.inside(after) & sound, sensed, sound)

    def clear(self, state: Tensor) -> Tensor:
        """Return whether robots touch nothing but the ground and what they may push: [N, n] -> [N] bool."""
        _, sensed, sound = self._at_rest(state)
        return sound & ~self.touched(sensed).squeeze(1)

    def sensed(self, state: Tensor) -> Tensor:
        """Return the readings of MuJoCo's sensors at starts, with actuators at rest: [B, n] -> [B, s] float64."""
        return self._at_rest(state).sensed.squeeze(1)

    def of_physics(self, state: Tensor) -> Tensor:
        """Return the columns that the physics steps, to which subclasses may append others: [B, n] -> [B, size]."""
        return state[:, : self.physics.size]

    def _at_rest(self, state: Tensor) -> Stepped:
        """Take one substep with the controls of the robot's first keyframe, or zeros without one."""
        return self.physics.once.step(self.of_physics(state), self.still.to(state).expand(len(state), -1))

    def velocity(self, state: Tensor) -> Tensor:
        """Return linear and angular velocity of the robot's first body: [B, n] -> [B, 6] float64.

        Both are in the body's own frame, metres per second and radians per second.
        """
        ahead = rotated(turned_back(state[:, self.layout.orientation]), state[:, self.layout.velocity])
        return torch.cat([ahead, state[:, self.layout.angular_velocity]], 1)

    def planar(self, state: Tensor) -> Tensor:
        """Return x, y and yaw of the robot's first body: [B, n] -> [B, 3] float64, metres, and radians in [0, τ).

        The yaw is that of the body's x axis, which points ahead.
        """
        x, y, _ = state[:, self.layout.position].unbind(1)
        return torch.stack([x, y, quat_yaws(state[:, self.layout.orientation]) % math.tau], 1)

    def planar_of(self, body_to_world: Tensor) -> Tensor:
        """Return x, y and yaw of the first body of robots at rest in poses: [N, 4, 4] -> [N, 3]; see ``Motion``."""
        return planar_of(body_to_world @ self.bodies.first_to_carrier(self.home.unsqueeze(0)))

    def body_to_world(self, state: Tensor) -> Tensor:
        """Return the poses of the body that carries the camera: [B, n] -> [B, 4, 4] float32."""
        return self.bodies.carrier(state)

    def upright(self, state: Tensor) -> Tensor:
        """Return the cosine of the angle by which first bodies are tilted from how they stand: [B, n] -> [B]."""
        skyward = state.new_tensor([0.0, 0.0, 1.0])
        top = rotated(turned_back(self.home[self.layout.orientation].to(state)), skyward)
        return rotated(state[:, self.layout.orientation], top)[:, 2]

    def fallen(self, state: Tensor) -> Tensor:
        """Return whether robots lie on their side or back: [B, n] -> [B] bool.

        They are tilted by more than 60°. Those that take other actions than a speed and a turn rate may fly, at any
        tilt: they lie only where they are so low that they can touch the ground.
        """
        low = ~(self.above_ground(state) > self.world.radius)
        return ~(self.upright(state) > TILTED) & (low | self.driven)

    def above_ground(self, state: Tensor) -> Tensor:
        """Return the height of first bodies above the ground: [B, n] -> [B] float64, metres."""
        x_y, z = state[:, self.layout.position].split([2, 1], 1)
        return z.squeeze(1) - self.terrain.height(x_y)

    def placed(self, planar: Tensor) -> Tensor:
        """Return states in which robots stand at rest on the ground, and things on it where their files place them.

        Args:
            planar: [N, 3] positions and headings: x and y in metres, yaw in radians.

        Returns:
            [N, n] float64.
        """
        state = self.home.repeat(len(planar), 1)
        state[:, self.layout.pose] = on_ground(planar.to(self.home), self.home[self.layout.pose], self.terrain)
        return state

    def model_of(self, state: Tensor) -> Tensor:
        """Return the number of the bank's model that states obey, valid even if a state is NaN: [B, n] -> [B] int64."""
        return self.layout.model_of(state, len(self.physics.models))

    def varied(self, state: Tensor, generator: torch.Generator) -> Tensor:
        """Replace the models that states obey by ones drawn uniformly from the bank: [B, n] -> [B, n]."""
        count = len(self.physics.models)
        if count == 1:
            return state
        drawn = torch.randint(count, (len(state), 1), generator=generator, device=state.device)
        return self.layout.with_model(state, drawn.squeeze(1))

    def thing(self, name: str) -> slice:
        """Return the columns of a state that hold the position and orientation of a thing with a free joint, [7].

        Raises:
            ValueError: for an unknown thing, or one that cannot move freely.
        """
        if (address := self.world.free_joint(name)) is None:
            raise ValueError(f"task.motion.things: expected {name!r} to have a free joint, found none")
        return self.layout.free_joint(address)

    def parts(self, state: Tensor, first: int = 1) -> Parts:
        """Return the parts to draw, the scene and the moving bodies where they are: [B, n] -> [B, 1 + M] parts.

        Args:
            state: [B, n] states.
            first: index of the first of ``models`` among the renderer's models.
        """
        return self.bodies.parts(state, first)

    def ranges(self, state: Tensor, body_to_world: Tensor, beams: Tensor, reach: float) -> Tensor:
        """Return how far beams go before they enter a thing's solid geoms; see ``Motion``."""
        return self.bodies.ranges(state, body_to_world, beams, reach)
