"""How MJCF models stand before anything moves: as their files say, and on the ground of a scene."""

import itertools
from typing import Any

import numpy as np
import torch
from torch import Tensor

from splatrl.geometry import multiply_quats, quat_yaws
from splatrl.physics.kinematics import normalised
from splatrl.physics.optional import needed
from splatrl.physics.terrain import Terrain


def at_home(model: Any) -> Any:
    """Return the ``MjData`` of a model at its first keyframe, or else in its default pose, with poses computed."""
    mujoco = needed()
    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_kinematics(model, data)
    return data


def top_of(model: Any) -> float:
    """Return an upper bound on how high a standing model reaches, metres: the top of its geoms' bounding spheres."""
    data = at_home(model)
    return max((float(data.geom_xpos[geom, 2] + model.geom_rbound[geom]) for geom in range(model.ngeom)), default=0.0)


def reach_of(model: Any) -> float:
    """Return how far a standing model reaches from the vertical line through its first body, metres.

    Only geoms that make contact count, each with the box around it.
    """
    data = at_home(model)
    solid = np.flatnonzero(model.geom_contype | model.geom_conaffinity)
    middle, half = np.split(model.geom_aabb[solid, None], 2, axis=2)
    corners = middle + half * np.array(list(itertools.product((-1.0, 1.0), repeat=3)))  # [G, 8, 3], geoms' frames
    turned = np.einsum("gij,gkj->gki", data.geom_xmat[solid].reshape(-1, 3, 3), corners)
    away = turned[..., :2] + (data.geom_xpos[solid] - data.xpos[1])[:, None, :2]
    return float(np.linalg.norm(away, axis=2).max(initial=0.0))


def radius_of(model: Any) -> float:
    """Return an upper bound on how far a standing model reaches from the origin of its first body, metres.

    Only geoms that make contact count, each with the sphere around it.
    """
    data = at_home(model)
    solid = np.flatnonzero(model.geom_contype | model.geom_conaffinity)
    away = np.linalg.norm(data.geom_xpos[solid] - data.xpos[1], axis=1)
    return float((away + model.geom_rbound[solid]).max(initial=0.0))


def on_ground(planar: Tensor, home: Tensor, terrain: Terrain) -> Tensor:
    """Return the poses of a robot's first body that stands on the ground, upright with respect to it.

    Args:
        planar: [N, 3] float64 positions and headings: x and y in metres, and the yaw of its x axis in radians.
        home: [7] float64, its pose on level ground at height 0, anywhere and with any heading: position, and quaternion
            wxyz.
        terrain: the ground.

    Returns:
        [N, 7] float64, positions and unit quaternions.
    """
    x, y, yaw = planar.unbind(1)
    half = 0.5 * (yaw - quat_yaws(home[3:]))
    about = torch.stack([half.cos(), torch.zeros_like(half), torch.zeros_like(half), half.sin()], 1)
    turn = normalised(multiply_quats(multiply_quats(terrain.upright.to(home), about), home[3:]))
    z = terrain.height(torch.stack([x, y], 1)) + home[2] / terrain.plane[2].to(home)
    return torch.cat([torch.stack([x, y, z], 1), turn], 1)
