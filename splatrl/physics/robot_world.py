"""An MJCF robot and things on a terrain, as one MuJoCo model, and what a motion reads from that model."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from splatrl.physics.compose import ROBOT, compose
from splatrl.physics.mjcf import read_mjcf
from splatrl.physics.optional import needed
from splatrl.physics.standing import radius_of, reach_of, top_of
from splatrl.physics.terrain import Terrain


class RobotWorld:
    """A compiled world in which a robot with a free joint stands among things.

    Attributes:
        model: the ``MjModel``.
        things: for each thing's name, the name of its first body.
        top: upper bound on how high the robot and the things reach where their files place them, metres.
        reach: how far the robot reaches from the vertical line through its first body when it stands, metres.
        radius: upper bound on how far it then reaches from the origin of that body, metres.
        qpos: [nq] float64, positions in the robot's first keyframe, or in the default pose without one.
        act: [na] float64, activations there, 0 without a keyframe.
        ctrl: [nu] float64, controls there, 0 without a keyframe.

    Args:
        path: the robot's MJCF file, with one body at the top that has a free joint.
        things: MJCF files of the things, by name.
        terrain: ground and boxes.
        substep: time step of the physics, seconds; None takes the robot's own.

    Raises:
        ImportError: without the extra ``physics``.
        ValueError: for MJCF that is refused, or lacks the free joint; names the file.
    """

    def __init__(self, path: Path, things: Mapping[str, Path], terrain: Terrain, substep: float | None = None):
        robot = read_mjcf(path)
        if substep is not None:
            robot.option.timestep = substep
        alone, specs = robot.copy().compile(), {name: read_mjcf(place) for name, place in things.items()}
        self.path, self.reach, self.radius = path, reach_of(alone), radius_of(alone)
        self.top = max(top_of(each) for each in (alone, *(spec.copy().compile() for spec in specs.values())))
        try:
            self.model, first, self.things = compose(robot, terrain, specs)
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from error
        if self._free_joint(first) != 0:
            body = first.removeprefix(ROBOT)
            raise ValueError(f"{path}: body {body!r}: expected a <freejoint/> that lets it move, found none")
        self.qpos, self.act, self.ctrl = self.model.qpos0.copy(), np.zeros(self.model.na), np.zeros(self.model.nu)
        self.qpos[: alone.nq] = alone.qpos0
        if alone.nkey:
            self.qpos[: alone.nq], self.act[: alone.na] = alone.key_qpos[0], alone.key_act[0]
            self.ctrl[: alone.nu] = alone.key_ctrl[0]

    def body_of_camera(self, camera: str) -> str:
        """Return the name of the body that carries one of the robot's cameras.

        Raises:
            ValueError: for an unknown camera; names those that the robot has.
        """
        mujoco, model = needed(), self.model
        number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA, f"{ROBOT}{camera}")
        if number < 0:
            known = [model.camera(each).name.removeprefix(ROBOT) for each in range(model.ncam)]
            raise ValueError(f"{self.path}: expected a camera called {camera!r}, got {', '.join(known) or 'none'}")
        return str(model.body(int(model.cam_bodyid[number])).name)

    def actuators(self) -> list[str]:
        """Return the names of the robot's actuators, or their numbers where they have none."""
        names = (self.model.actuator(number).name.removeprefix(ROBOT) for number in range(self.model.nu))
        return [name or str(number) for number, name in enumerate(names)]

    def control_limits(self) -> Tensor:
        """Return the lowest and highest controls: [2, nu] float32.

        Raises:
            ValueError: for a robot without actuators, or one whose actuator has no ``ctrlrange``.
        """
        for name, limited in zip(self.actuators(), self.model.actuator_ctrllimited, strict=True):
            if not limited:
                raise ValueError(f"{self.path}: actuator {name!r}: expected a ctrlrange, found none")
        if not self.model.nu:
            raise ValueError(f"{self.path}: expected at least one <actuator>, found none")
        return torch.from_numpy(self.model.actuator_ctrlrange.T.copy()).float()

    def velocity_servos(self) -> list[str]:
        """Return the names of the robot's actuators if all are servos of their joints' velocities, else nothing.

        Such a servo's force is in proportion to how much its velocity falls short of its control.
        """
        mujoco, model = needed(), self.model
        offset, position, velocity = model.actuator_biasprm[:, :3].T
        servo = (model.actuator_biastype == mujoco.mjtBias.mjBIAS_AFFINE) & (velocity < 0.0)
        servo &= (model.actuator_gaintype == mujoco.mjtGain.mjGAIN_FIXED) & (offset == 0.0) & (position == 0.0)
        servo &= np.isclose(model.actuator_gainprm[:, 0], -velocity, atol=0.0)
        servo &= (np.sort(model.actuator_gear) == [0.0, 0.0, 0.0, 0.0, 0.0, 1.0]).all(1)  # one axis, not geared
        return self.actuators() if servo.all() else []

    def robot_joints(self) -> list[str]:
        """Return the names of the robot's joints behind its free joint, in the order of their positions."""
        names = (self.model.joint(number).name for number in range(1, self.model.njnt))
        return [name.removeprefix(ROBOT) for name in names if name.startswith(ROBOT)]

    def position_servos(self) -> list[str | None]:
        """Return, for each of the robot's actuators, the name of the hinge whose angle it holds; None for any other.

        Such a servo's force is in proportion to how much the hinge's angle falls short of its control, less damping.
        """
        mujoco, model = needed(), self.model
        offset, position, _ = model.actuator_biasprm[:, :3].T
        servo = (model.actuator_biastype == mujoco.mjtBias.mjBIAS_AFFINE) & (position < 0.0) & (offset == 0.0)
        servo &= model.actuator_gaintype == mujoco.mjtGain.mjGAIN_FIXED
        servo &= np.isclose(model.actuator_gainprm[:, 0], -position, atol=0.0) & (model.actuator_gear[:, 0] == 1.0)
        servo &= model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT
        joint = np.where(servo, model.actuator_trnid[:, 0], 0)  # the robot's free joint is no hinge
        servo &= model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE
        names = [model.joint(int(number)).name.removeprefix(ROBOT) for number in joint]
        return [name if held else None for name, held in zip(names, servo, strict=True)]

    def free_joint(self, thing: str) -> int | None:
        """Return where the free joint of a thing begins in ``qpos``; None if there is no such thing or joint."""
        return self._free_joint(self.things[thing]) if thing in self.things else None

    def _free_joint(self, body: str) -> int | None:
        joint = int(self.model.body_jntadr[self.model.body(body).id])
        if joint < 0 or self.model.jnt_type[joint] != needed().mjtJoint.mjJNT_FREE:
            return None
        return int(self.model.jnt_qposadr[joint])
