"""Planning with a kinematic twin: the base of motions whose states are more than a place and a heading."""

from abc import ABC, abstractmethod

from torch import Tensor

from splatrl.motions.base import Taps
from splatrl.motions.drive import DriveMotion
from splatrl.motions.module import MotionModule


class TwinMotion(MotionModule, ABC):
    """A motion whose starts and shortest paths are those of a ``DriveMotion``, with the robot at rest in every state.

    Attributes:
        twin: the ``DriveMotion``, with the robot's speeds and bounds.
        driven: whether the robot takes the twin's actions.
    """

    leaves = True
    twin: DriveMotion
    driven: bool

    @property
    def steering(self) -> DriveMotion | None:
        """The twin, if the robot takes its actions."""
        return self.twin if self.driven else None

    @abstractmethod
    def planar(self, state: Tensor) -> Tensor:
        """Return position and heading of states; see ``Motion``."""

    @abstractmethod
    def placed(self, planar: Tensor) -> Tensor:
        """Return states of robots at rest: [N, 3] x and y in metres and yaw in radians -> [N, n]."""

    def states(self) -> Tensor:
        """Return the twin's starts, with the robot at rest: [S, n]."""
        return self.placed(self.twin.states())

    def actions(self) -> Tensor:
        """Return the twin's actions: [A, 2] float32."""
        return self.twin.actions()

    def advance(self, state: Tensor, action: Tensor) -> Tensor:
        """Return where an unobstructed action leads the twin: [B, n], [B, 2] -> [B, n]."""
        return self.placed(self.twin.advance(self.planar(state).float(), action))

    def inside(self, state: Tensor) -> Tensor:
        """Return whether robots are within the bounds, which are inclusive: [B, n] -> [B] bool."""
        return self.twin.inside(self.planar(state).float())

    def outside(self, state: Tensor, leeway: float) -> Tensor:
        """Return whether robots have left the bounds by more than ``leeway``, metres: [B, n] -> [B] bool."""
        place = self.planar(state)[:, :2]
        return ((place < self.twin.lower - leeway) | (place > self.twin.upper + leeway)).any(1)

    def nodes(self) -> Tensor:
        """Return the twin's nodes, with the robot at rest: [C, n]."""
        return self.placed(self.twin.nodes())

    def taps(self, state: Tensor) -> Taps:
        """Return the twin's nodes around the robots."""
        return self.twin.taps(self.planar(state).float())

    def nearest(self, planar: Tensor) -> Tensor:
        """Return states of robots at rest at positions and headings: [N, 3] -> [N, n]."""
        return self.placed(planar)
