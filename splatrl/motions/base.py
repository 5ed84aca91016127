"""The interface of all motions, which define how actions change a robot's state."""

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import torch
from torch import Tensor
from torchrl.data import TensorSpec

from splatrl.collision.base import Checker
from splatrl.collision.occupancy import Occupancy
from splatrl.motions.site import Fits, Site
from splatrl.renderers.parts import Parts
from splatrl.scenes.gaussians import Gaussians
from splatrl.scenes.scene import Scene


class Move(NamedTuple):
    """The result of carrying out one action of each robot.

    Attributes:
        state: [B, ...] states after the action.
        body_to_world: [B, 4, 4] float32, poses of ``state``, metres.
        free_fraction: [B] float32 in [0, 1], fraction of the action that was free before the body touched something; 1
            where it touched nothing.
        inside: [B] bool, whether the action stayed within the motion's bounds.
        sensed: [B, S, s] float64, readings of the physics' sensors in each substep; None without physics.
        sound: [B] bool, whether the physics could carry out the action; where it could not, the robot keeps its state,
            and ``inside`` is False. None without physics.
    """

    state: Tensor
    body_to_world: Tensor
    free_fraction: Tensor
    inside: Tensor
    sensed: Tensor | None = None
    sound: Tensor | None = None

    @property
    def failed(self) -> Tensor:
        """Whether the physics could not carry out the action, [B] bool."""
        return torch.zeros_like(self.inside) if self.sound is None else ~self.sound


class Taps(NamedTuple):
    """The nodes between which states lie, and the weights that interpolate between them.

    Attributes:
        node: [N, K] int64, indices of nodes.
        weight: [N, K] float32; each row sums to 1.
    """

    node: Tensor
    weight: Tensor


class Motion(Protocol):
    """Defines how actions change a robot's state; states are [B, ...] tensors of any dtype.

    ``MotionModule`` has defaults for everything that only a robot with physics needs.

    Attributes:
        action_names: a name for each discrete action, in order; empty if actions are continuous.
        step: longest distance that an action moves the robot, metres.
        angle_step: largest angle that an action turns the robot, radians.
        steps_on_host: whether ``move`` leaves the device, so that a step cannot be captured in a CUDA graph.
        stacks: whether the robots of a batch may stand in different scenes; see ``splatrl.per_scene``.
        leaves: whether a move may end beyond the bounds, instead of being reverted.
    """

    action_names: tuple[str, ...]
    step: float
    angle_step: float
    steps_on_host: bool
    stacks: bool
    leaves: bool

    @property
    def height(self) -> float | None:
        """z of every pose, metres; None if the height varies or poses are tilted."""
        ...

    @property
    def seconds_per_step(self) -> float | None:
        """Duration of an action, seconds; None if an action is a single move."""
        ...

    @property
    def controls(self) -> Sequence[str]:
        """A name for each number of a continuous action, with its unit where that is known; empty if there are none."""
        ...

    @property
    def action_spec(self) -> TensorSpec:
        """Spec of one robot's action."""
        ...

    @property
    def state_spec(self) -> TensorSpec:
        """Spec of one robot's state."""
        ...

    def move(self, state: Tensor, action: Tensor, checker: Checker) -> Move:
        """Carry out one action of each robot.

        Args:
            state: [B, ...] states before the action.
            action: [B, ...] actions.
            checker: tells what the body touches; a motion that resolves contacts itself need not use it.
        """
        ...

    def planar(self, state: Tensor) -> Tensor:
        """Return position and heading of states: [B, ...] -> [B, 3] float64, x and y in metres, yaw in radians."""
        ...

    def body_to_world(self, state: Tensor) -> Tensor:
        """Return the poses of states: [B, ...] -> [B, 4, 4] float32."""
        ...

    def planar_of(self, body_to_world: Tensor) -> Tensor:
        """Return position and heading of robots at rest in poses: [N, 4, 4] -> [N, 3] float64; see ``planar``."""
        ...

    def obstacles(self, scene: Scene, occupancy: Occupancy, antialiased: bool) -> Occupancy:
        """Return the solid voxels of a scene that a robot's body must not touch where it begins and on its paths.

        Args:
            scene: the scene.
            occupancy: all of its solid voxels.
            antialiased: whether the scene is rendered with antialiasing.
        """
        ...

    def settle(self, site: Site, fits: Fits) -> Fits:
        """Put robots into a scene, once, before paths are planned there, and return where episodes may begin.

        Args:
            site: the scene.
            fits: where episodes may otherwise begin.

        Raises:
            ValueError: for a scene in which robots cannot move.
        """
        ...

    def varied(self, state: Tensor, generator: torch.Generator) -> Tensor:
        """Replace whatever differs at random between episodes in the states in which they begin: [B, ...] -> same."""
        ...

    @property
    def models(self) -> Sequence[Gaussians]:
        """Models of the robot's links and of things, which the renderer draws besides the scene."""
        ...

    def parts(self, state: Tensor) -> Parts | None:
        """Return the scene and ``models`` where they are, [B, M] parts; None stands for the scene alone."""
        ...

    def ranges(self, state: Tensor, body_to_world: Tensor, beams: Tensor, reach: float) -> Tensor | None:
        """Return how far a lidar's beams go before they enter a thing that is no part of the scene's solid voxels.

        The robot's own links do not stop beams.

        Args:
            state: [B, ...] states, which say where things are.
            body_to_world: [B, 4, 4] float32, poses from whose origin the beams start, metres.
            beams: [R, 3] float32 unit vectors, body frame.
            reach: maximum range, metres.

        Returns:
            [B, R] float32, metres: 0 where a beam begins inside a thing, ``reach`` where it enters none. None if there
            are no things.
        """
        ...


class PlannedMotion(Motion, Protocol):
    """A motion for which shortest paths can be found: where an action leads does not depend on what it touches.

    Costs are stored at nodes and interpolated between them. A motion with finitely many states has one node per state.
    """

    def states(self) -> Tensor:
        """Return the states in which episodes may begin: [S, ...]."""
        ...

    def region(self) -> Tensor:
        """Return the lower and upper corner of the box that robots' positions stay in: [2, 3] float32, metres."""
        ...

    def actions(self) -> Tensor:
        """Return the actions from which paths are made: [A, ...]."""
        ...

    def advance(self, state: Tensor, action: Tensor) -> Tensor:
        """Return where an unobstructed action leads, possibly out of bounds: [B, ...], [B, ...] -> [B, ...]."""
        ...

    def inside(self, state: Tensor) -> Tensor:
        """Return whether states are within the bounds, which are inclusive: [B, ...] -> [B] bool."""
        ...

    def outside(self, state: Tensor, leeway: float) -> Tensor:
        """Return whether robots have left the bounds by more than ``leeway``, metres: [B, ...] -> [B] bool."""
        ...

    def fallen(self, state: Tensor) -> Tensor:
        """Return whether robots have fallen over, so that they cannot go on: [B, ...] -> [B] bool."""
        ...

    def nodes(self) -> Tensor:
        """Return the states at which costs are stored: [C, ...]."""
        ...

    def taps(self, state: Tensor) -> Taps:
        """Return the nodes between which states inside the bounds lie."""
        ...

    def nearest(self, planar: Tensor) -> Tensor:
        """Return the states nearest to positions and headings: [N, 3] float64 x, y and yaw -> [N, ...]."""
        ...

    @property
    def steering(self) -> "Steering | None":
        """Knows which of the same actions stop or lead in a direction; None where no action stops."""
        ...


class Steering(PlannedMotion, Protocol):
    """A motion in which some action declares that the robot has arrived.

    Attributes:
        reach: look-ahead distance for choosing a direction, metres.
        angle_between: angle between the directions from which to choose, radians; must divide a full turn.
    """

    reach: float
    angle_between: float

    def stops(self, action: Tensor) -> Tensor:
        """Return whether actions declare arrival: [B, ...] -> [B] bool."""
        ...

    def toward(self, turn: Tensor, stop: Tensor) -> Tensor:
        """Return actions that lead in a direction, or that stop.

        Args:
            turn: [B] float32, angle from the heading to the direction, radians in [-π, π].
            stop: [B] bool, whether to stop instead.

        Returns:
            [B, ...] actions that match ``action_spec``.
        """
        ...
