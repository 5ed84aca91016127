"""Robots whose camera is defined in their MJCF."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import torch

from splatrl.bodies import Body
from splatrl.envs.robot import Robot
from splatrl.geometry import quats_to_rotations, rigid
from splatrl.physics import read_mjcf
from splatrl.physics.optional import needed
from splatrl.physics.robots import mjcf_path
from splatrl.physics.standing import at_home

TO_OPENCV = torch.diag(torch.tensor([1.0, -1.0, -1.0], dtype=torch.float64))
"""Conversion between MuJoCo's camera axes (looking along −z, y up) and OpenCV's."""


def mjcf_robot(
    path: str | Path,
    camera: str,
    body: Body,
    image_width: int = 64,
    image_height: int = 64,
    height: float | None = None,
) -> Robot:
    """Build a robot from an MJCF file and one of its cameras.

    Field of view and mount are those of the MJCF camera; the height is that of the body that carries it, with the robot
    in its home pose.

    Args:
        path: path of the MJCF, or the name of one of splatrl's own robots.
        camera: name of the camera.
        body: shape that must be free where an episode begins, centred at the origin of the body carrying the camera.
        image_width: width of the image, pixels.
        image_height: height of the image, pixels.
        height: ignored; scenes propose it for robots without legs or wheels.

    Raises:
        FileNotFoundError: if the MJCF does not exist.
        ImportError: if the extra ``physics`` is not installed.
        ValueError: for MJCF that is refused; a camera that it does not have, or one that is not fixed to its body, not
            a perspective one, or without square pixels and a centred principal point; or a robot or its body that reach
            into the ground.
    """
    place = mjcf_path(str(path))
    model = read_mjcf(place).compile()
    names = [model.camera(number).name for number in range(model.ncam)]
    if camera not in names:
        raise ValueError(
            f"{place}: robot.camera: expected {' or '.join(names) or 'a file with a camera'}, got {camera}"
        )
    number = names.index(camera)
    _check_camera(model, number, f"{place}: camera {camera!r}")
    turn = quats_to_rotations(torch.from_numpy(model.cam_quat[number].copy())) @ TO_OPENCV
    mount = rigid(turn, torch.from_numpy(model.cam_pos[number].copy()))
    stands = float(at_home(model).xpos[int(model.cam_bodyid[number]), 2])
    if not stands > 0.0:
        raise ValueError(
            f"{place}: expected a robot that stands above z = 0, the ground, got one with the camera's body at "
            f"z = {stands:.3g} m; raise the pos of its first body, or that in its first keyframe"
        )
    if not stands > body.half_height:
        raise ValueError(
            f"robot.body: expected a height below {2 * stands:.3g} m, so that the shape around the camera's body in "
            f"{place} stays above the ground, got {2 * body.half_height:.3g} m"
        )
    wide = math.tan(0.5 * math.radians(float(model.cam_fovy[number]))) * image_width / image_height
    return Robot(
        body=body,
        height=stands,
        fov_deg=2.0 * math.degrees(math.atan(wide)),
        image_width=image_width,
        image_height=image_height,
        mount=tuple(tuple(row) for row in mount.tolist()),
    )


def _check_camera(model: Any, number: int, where: str) -> None:
    """Refuse a camera of an ``MjModel`` with a mode, projection or intrinsics that a ``Robot`` cannot have."""
    mode = needed().mjtCamLight(int(model.cam_mode[number])).name.removeprefix("mjCAMLIGHT_").lower()
    if mode != "fixed":
        raise ValueError(f"{where}: mode: expected fixed, got {mode}")
    orthographic = model.cam_projection if hasattr(model, "cam_projection") else model.cam_orthographic  # older MuJoCo
    if orthographic[number]:
        raise ValueError(f"{where}: projection: expected perspective, got orthographic")
    if not model.cam_sensorsize[number].any():  # its view follows from fovy
        return
    pixel = np.tile(model.cam_sensorsize[number] / model.cam_resolution[number], 2)
    fx, fy, right, up = (model.cam_intrinsic[number] / pixel).tolist()
    if max(abs(right), abs(up)) > 1e-3:
        raise ValueError(f"{where}: principalpixel: expected 0 0, the middle of the image, got {right:.4g} {up:.4g}")
    if not math.isclose(fx, fy, rel_tol=1e-3):
        raise ValueError(f"{where}: focalpixel: expected square pixels, so twice the same, got {fx:.4g} {fy:.4g}")
