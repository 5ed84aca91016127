"""Robots whose camera is defined in their MJCF."""

import math
from pathlib import Path

import torch

from splatrl.bodies import Body
from splatrl.envs.robot import Robot
from splatrl.geometry import quats_to_rotations, rigid
from splatrl.physics import read_mjcf
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
        ValueError: for MJCF that is refused, a camera that it does not have, or a body that reaches into the ground.
    """
    place = mjcf_path(str(path))
    model = read_mjcf(place).compile()
    names = [model.camera(number).name for number in range(model.ncam)]
    if camera not in names:
        raise ValueError(
            f"{place}: robot.camera: expected {' or '.join(names) or 'a file with a camera'}, got {camera}"
        )
    number = names.index(camera)
    turn = quats_to_rotations(torch.from_numpy(model.cam_quat[number].copy())) @ TO_OPENCV
    mount = rigid(turn, torch.from_numpy(model.cam_pos[number].copy()))
    stands = float(at_home(model).xpos[int(model.cam_bodyid[number]), 2])
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
