"""Sensors of the robot's own body and motion, for robots with physics."""

from collections.abc import Mapping, Sequence

import torch
from torch import Tensor
from torchrl.data import TensorSpec, Unbounded

from splatrl.envs.robot import Robot
from splatrl.envs.sensors.base import Moment, PlainSensor
from splatrl.envs.tasks.base import Task
from splatrl.geometry import quats_to_rotations
from splatrl.motions.base import Motion
from splatrl.motions.legs import FELT, LegsMotion
from splatrl.motions.physics import PhysicsMotion
from splatrl.physics import read_mjcf
from splatrl.physics.compose import ROBOT
from splatrl.physics.optional import needed
from splatrl.physics.robots import mjcf_path


class BodySensor(PlainSensor):
    """A sensor of robots with physics."""

    def check(self, task: Task) -> None:
        """Refuse robots without physics."""
        with_physics(task.motion)


class Measured(BodySensor):
    """Concatenated readings of sensors in the robot's own MJCF: [B, n] float32, in MuJoCo's units.

    For example, an accelerometer and a gyro form an IMU, and touch sensors in the feet report contacts. A reading is
    the mean over the substeps of the last move; at the start of an episode it is what is measured with the actuators at
    rest. It is remembered under the sensor's key, so a reset to a state given with it reproduces the reading.

    Args:
        key: the sensor's key in the config.
        path: path of the robot's MJCF, or the name of one of splatrl's own robots.
        names: names of the MJCF sensors, in order.
        scale: factor applied to all values.

    Raises:
        ValueError: for a sensor that the robot does not have; names those that it has.
    """

    def __init__(self, key: str, path: str, names: Sequence[str], scale: float = 1.0):
        self.key, self.names, self.scale = key, tuple(names), float(scale)
        model = read_mjcf(mjcf_path(path)).compile()
        known = [model.sensor(number).name for number in range(model.nsensor)]
        if missing := [name for name in self.names if name not in known]:
            raise ValueError(
                f"sensors.{key}: expected a robot with the sensor {missing[0]} in its MJCF, got {path}, which has "
                f"{', '.join(known) or 'no sensors'}"
            )
        self.size = sum(int(model.sensor(name).dim[0]) for name in self.names)

    def spec(self, robot: Robot) -> TensorSpec:
        """Return the spec of one number for each component of the sensors."""
        return Unbounded(shape=(self.size,), dtype=torch.float32)

    def memory_spec(self, robot: Robot) -> Mapping[str, TensorSpec]:
        """Return the spec of the last reading."""
        return {self.key: self.spec(robot)}

    def begin(self, moment: Moment) -> Mapping[str, Tensor]:
        """Return the reading with the actuators at rest: [B, n] float32."""
        motion = with_physics(moment.motion)
        return {self.key: self._said(motion, motion.sensed(moment.state).unsqueeze(1))}

    def read(self, moment: Moment) -> Tensor:
        """Return the mean over the last move, or the remembered reading where an episode begins: [B, n] float32."""
        if moment.sensed is None:
            return moment.memory[self.key].clone()
        return self._said(with_physics(moment.motion), moment.sensed)

    def _said(self, motion: PhysicsMotion, sensed: Tensor) -> Tensor:
        columns = [motion.physics.sensor(f"{ROBOT}{name}") for name in self.names]
        each = torch.cat([sensed[..., one] for one in columns if one is not None], 2)
        total = each[:, 0]
        for substep in range(1, each.shape[1]):  # fixed order, independent of the batch
            total = total + each[:, substep]
        return (self.scale * total / each.shape[1]).float()


class Joints(BodySensor):
    """Positions, then velocities, of the hinge and slide joints: [B, 2 J] float32, radians or metres, and per second.

    Positions are relative to the robot's home pose.

    Args:
        path: path of the robot's MJCF, or the name of one of splatrl's own robots.
        rate: factor applied to velocities, whose values are larger than those of positions.
    """

    def __init__(self, path: str, rate: float = 0.05):
        model, mujoco = read_mjcf(mjcf_path(path)).compile(), needed()
        kinds = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)
        self.rate, chosen = rate, [joint for joint in range(model.njnt) if int(model.jnt_type[joint]) in kinds]
        self.places = torch.tensor([int(model.jnt_qposadr[joint]) for joint in chosen], dtype=torch.int64)
        self.rates = torch.tensor([int(model.jnt_dofadr[joint]) for joint in chosen], dtype=torch.int64)

    def spec(self, robot: Robot) -> TensorSpec:
        """Return the spec of two numbers per joint."""
        return Unbounded(shape=(2 * len(self.places),), dtype=torch.float32)

    def read(self, moment: Moment) -> Tensor:
        """Return positions relative to the home pose, then scaled velocities: [B, 2 J] float32."""
        motion, state = with_physics(moment.motion), moment.state
        layout, places, rates = motion.layout, self.places.to(state.device), self.rates.to(state.device)
        angles = state[:, layout.positions][:, places] - motion.home[layout.positions][places].to(state)
        return torch.cat([angles, self.rate * state[:, layout.velocities][:, rates]], 1).float()


class Velocity(BodySensor):
    """Linear and angular velocity of the body, for critics: [B, 6] float32, metres and radians per second.

    A real robot cannot measure it directly. It is the velocity of the robot's first body in its own frame: ahead, left
    and up, then about these axes.
    """

    def spec(self, robot: Robot) -> TensorSpec:
        """Return the spec of six numbers."""
        return Unbounded(shape=(6,), dtype=torch.float32)

    def read(self, moment: Moment) -> Tensor:
        """Return the linear and the angular velocity in the body's frame: [B, 6] float32."""
        return with_physics(moment.motion).velocity(moment.state).float()


class EgoMotion(BodySensor):
    """Velocity and tilt of the body, as an IMU with visual odometry would estimate them: [B, 9] float32.

    The six values of ``Velocity`` are followed by the world's up direction, all in the body's own frame. Position and
    heading are not included.
    """

    def spec(self, robot: Robot) -> TensorSpec:
        """Return the spec of nine numbers."""
        return Unbounded(shape=(9,), dtype=torch.float32)

    def read(self, moment: Moment) -> Tensor:
        """Return the velocity and the world's up direction in the body's frame: [B, 9] float32."""
        motion = with_physics(moment.motion)
        up = quats_to_rotations(moment.state[:, motion.layout.orientation])[:, 2]
        return torch.cat([motion.velocity(moment.state), up], 1).float()


class Felt(BodySensor):
    """Proprioception of a legged robot: [B, 46] float32, see ``LegsMotion.felt``."""

    def check(self, task: Task) -> None:
        """Refuse robots without legs."""
        with_legs(task.motion)

    def spec(self, robot: Robot) -> TensorSpec:
        """Return the spec of 46 numbers."""
        return Unbounded(shape=(FELT,), dtype=torch.float32)

    def read(self, moment: Moment) -> Tensor:
        """Return the proprioception: [B, 46] float32."""
        return with_legs(moment.motion).felt(moment.state)


def with_physics(motion: Motion) -> PhysicsMotion:
    """Return the motion of robots with physics.

    Raises:
        ValueError: for any other motion.
    """
    if not isinstance(motion, PhysicsMotion):
        raise ValueError(
            "expected a robot with physics, such as robot=wheels motion@task.motion=physics, "
            f"got {type(motion).__name__}"
        )
    return motion


def with_legs(motion: Motion) -> LegsMotion:
    """Return the motion of robots with legs.

    Raises:
        ValueError: for any other motion.
    """
    if not isinstance(motion, LegsMotion):
        raise ValueError(f"expected a legged robot, such as that of task=walk, got {type(motion).__name__}")
    return motion
