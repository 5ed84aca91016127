"""The columns of a physics state, by name."""

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor


@dataclass(frozen=True)
class StateLayout:
    """Columns of a state [n] float64: the number of its model, then MuJoCo's ``mjSTATE_FULLPHYSICS``.

    The latter consists of the time, all positions, all velocities and all activations. The robot comes first among
    positions and velocities: its free joint, then its own joints, and after them the things.

    Attributes:
        nq: number of positions in the model.
        nv: number of velocities in the model.
        hinges: number of hinges, right behind the robot's free joint, that ``joints`` and ``joint_rates`` name.
        model: column of the number of the model, in the bank, that the state obeys.
        clock: column of the time, seconds.
        mujoco: all columns but that of the model.
    """

    nq: int
    nv: int
    hinges: int = 0
    model: ClassVar[int] = 0
    clock: ClassVar[int] = 1
    mujoco: ClassVar[slice] = slice(1, None)

    @property
    def positions(self) -> slice:
        """All positions, ``qpos``."""
        return slice(2, 2 + self.nq)

    @property
    def velocities(self) -> slice:
        """All velocities, ``qvel``."""
        return slice(2 + self.nq, 2 + self.nq + self.nv)

    @property
    def position(self) -> slice:
        """Position of the robot's first body: x, y and z in the world frame, metres."""
        return slice(2, 5)

    @property
    def orientation(self) -> slice:
        """Orientation of the robot's first body: a unit quaternion wxyz."""
        return slice(5, 9)

    @property
    def pose(self) -> slice:
        """Position and orientation of the robot's first body."""
        return self.free_joint(0)

    @property
    def joints(self) -> slice:
        """Angles of the robot's hinges, radians."""
        return slice(9, 9 + self.hinges)

    @property
    def velocity(self) -> slice:
        """Velocity of the robot's first body, in the world frame, metres per second."""
        return slice(2 + self.nq, 5 + self.nq)

    @property
    def angular_velocity(self) -> slice:
        """Angular velocity of the robot's first body, in its own frame, radians per second."""
        return slice(5 + self.nq, 8 + self.nq)

    @property
    def joint_rates(self) -> slice:
        """Angular velocities of the robot's hinges, radians per second."""
        return slice(8 + self.nq, 8 + self.nq + self.hinges)

    @property
    def robot_velocities(self) -> slice:
        """All velocities of the robot: of its first body, then of its hinges."""
        return slice(self.velocity.start, self.joint_rates.stop)

    def free_joint(self, address: int) -> slice:
        """Return the position and orientation of a body with a free joint, given where this begins in ``positions``."""
        return slice(2 + address, 9 + address)

    def model_of(self, state: Tensor, models: int) -> Tensor:
        """Return the number of the model that each state obeys, valid even if a state is NaN: [B, n] -> [B] int64."""
        return state[:, self.model].nan_to_num().long().clamp(0, models - 1)

    def with_model(self, state: Tensor, number: Tensor) -> Tensor:
        """Replace the numbers of the models that states obey: [B, n], [B] -> [B, n]."""
        return torch.cat([number.unsqueeze(1).to(state), state[:, self.mujoco]], 1)
