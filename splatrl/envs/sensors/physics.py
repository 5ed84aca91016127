"""What a robot with physics senses of its own body."""

from collections.abc import Mapping, Sequence
from typing import Any

import torch
from torch import Tensor
from torchrl.data import TensorSpec, Unbounded

from splatrl.envs.robot import Robot
from splatrl.envs.sensors.base import Moment, PlainSensor
from splatrl.geometry import quats_to_rotations
from splatrl.motions.legs import FELT, LegsMotion
from splatrl.motions.physics import FIRST, PhysicsMotion
from splatrl.physics import read_mjcf
from splatrl.physics.compose import ROBOT
from splatrl.physics.optional import needed
from splatrl.physics.robots import mjcf_path


class Measured(PlainSensor):
    """What sensors of the robot's own MJCF say, one after the other: [B, n] float32, in MuJoCo's units.

    An accelerometer and a gyro are an IMU; touch sensors in feet are contacts. What is said is the mean over the
    substeps of the last move; where an episode begins, what is sensed with actuators at rest. It is remembered under
    its key, so that a reset to a state with it gives it again.

    Args:
        key: by which it stands in the config.
        path: of the robot's MJCF, or the name of one of splatrl's own.
        names: of sensors, in their order.
        scale: factor on all numbers.

    Raises:
        ValueError: for a sensor that the robot lacks; names those that it has.
    """

    def __init__(self, key: str, path: str, names: Sequence[str], scale: float = 1.0):
        self.key, self.names, self.scale = key, tuple(names), float(scale)
        model = read_mjcf(mjcf_path(path)).compile()
        known = [model.sensor(number).name for number in range(model.nsensor)]
        if missing := [name for name in self.names if name not in known]:
            raise ValueError(
                f"{path}: sensors.{key}: expected some of {', '.join(known) or 'none'}, got {missing[0]!r}"
            )
        self.size = sum(int(model.sensor(name).dim[0]) for name in self.names)

    def spec(self, robot: Robot) -> TensorSpec:
        """Some numbers."""
        return Unbounded(shape=(self.size,), dtype=torch.float32)

    def memory_spec(self, robot: Robot) -> Mapping[str, TensorSpec]:
        """What was said last."""
        return {self.key: self.spec(robot)}

    def begin(self, moment: Moment) -> Mapping[str, Tensor]:
        """What is said at rest."""
        motion = with_physics(moment)
        return {self.key: self._said(motion, motion.sensed(moment.state).unsqueeze(1))}

    def read(self, moment: Moment) -> Tensor:
        """What the sensors say."""
        if moment.sensed is None:
            return moment.memory[self.key].clone()
        return self._said(with_physics(moment), moment.sensed)

    def _said(self, motion: PhysicsMotion, sensed: Tensor) -> Tensor:
        columns = [motion.physics.sensor(f"{ROBOT}{name}") for name in self.names]
        each = torch.cat([sensed[..., one] for one in columns if one is not None], 2)
        total = each[:, 0]
        for substep in range(1, each.shape[1]):  # in this order whatever the batch
            total = total + each[:, substep]
        return (self.scale * total / each.shape[1]).float()


class Joints(PlainSensor):
    """Positions and then velocities of the robot's hinges and slides: [B, 2 J] float32, radians or metres, per second.

    Positions are those from where the robot stands at first.

    Args:
        path: of the robot's MJCF, or the name of one of splatrl's own.
        rate: factor on velocities, which are larger than positions.
    """

    def __init__(self, path: str, rate: float = 0.05):
        model, mujoco = read_mjcf(mjcf_path(path)).compile(), needed()
        kinds = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)
        self.rate, chosen = rate, [joint for joint in range(model.njnt) if int(model.jnt_type[joint]) in kinds]
        self.places = torch.tensor([int(model.jnt_qposadr[joint]) for joint in chosen], dtype=torch.int64)
        self.rates = torch.tensor([int(model.jnt_dofadr[joint]) for joint in chosen], dtype=torch.int64)

    def spec(self, robot: Robot) -> TensorSpec:
        """Two numbers a joint."""
        return Unbounded(shape=(2 * len(self.places),), dtype=torch.float32)

    def read(self, moment: Moment) -> Tensor:
        """Positions and velocities."""
        motion, state = with_physics(moment), moment.state
        places = FIRST + self.places.to(state.device)
        rates = FIRST + motion.physics.model.nq + self.rates.to(state.device)
        return torch.cat([state[:, places] - motion.home[places].to(state), self.rate * state[:, rates]], 1).float()


class Velocity(PlainSensor):
    """How fast the body moves, which a robot cannot feel; for critics: [B, 6] float32, metres and radians per second.

    Of the robot's first body, in its own frame: ahead, left and up, then about these axes.
    """

    def spec(self, robot: Robot) -> TensorSpec:
        """Six numbers."""
        return Unbounded(shape=(6,), dtype=torch.float32)

    def read(self, moment: Moment) -> Tensor:
        """The velocity."""
        return with_physics(moment).velocity(moment.state).float()


class EgoMotion(PlainSensor):
    """How the body moves and tilts, as an inertial unit and visual odometry estimate it: [B, 9] float32.

    What ``Velocity`` says, and then the direction that is up in the world, both in the body's own frame. Where it is
    and where it heads are not among them.
    """

    def spec(self, robot: Robot) -> TensorSpec:
        """Nine numbers."""
        return Unbounded(shape=(9,), dtype=torch.float32)

    def read(self, moment: Moment) -> Tensor:
        """The velocity, and what is up."""
        motion, turn = with_physics(moment), moment.state[:, FIRST + 3 : FIRST + 7]
        up = quats_to_rotations(turn)[:, 2]
        return torch.cat([motion.velocity(moment.state), up], 1).float()


class Felt(PlainSensor):
    """What a robot on legs feels without looking: [B, 46] float32, see ``LegsMotion.felt``."""

    def spec(self, robot: Robot) -> TensorSpec:
        """46 numbers."""
        return Unbounded(shape=(FELT,), dtype=torch.float32)

    def read(self, moment: Moment) -> Tensor:
        """What is felt."""
        motion: Any = moment.motion
        if not isinstance(motion, LegsMotion):
            raise ValueError(f"sensors: expected a robot on legs, got {type(motion).__name__}")
        return motion.felt(moment.state)


def with_physics(moment: Moment) -> PhysicsMotion:
    """The motion of robots with physics.

    Raises:
        ValueError: for others.
    """
    if not isinstance(moment.motion, PhysicsMotion):
        raise ValueError(
            f"sensors: expected a robot with physics, such as robot=wheels motion@task.motion=physics, "
            f"got {type(moment.motion).__name__}"
        )
    return moment.motion
