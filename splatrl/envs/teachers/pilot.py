"""A scripted quadrotor pilot that knows the state, and so demonstrates that gates can be flown through."""

from typing import NamedTuple

import torch
from torch import Tensor

from splatrl.geometry import azimuths, quats_to_rotations, wrapped

GRAVITY = 9.81
SPEED = 1.5
"""Maximum speed, metres per second."""
CARROT = 0.6
"""Distance along the gate's axis by which the target point is ahead of the quadrotor, metres."""
APPROACH = 0.7
"""Distance before a gate at which a quadrotor off the gate's axis waits until it is on the axis, metres."""
FUNNEL = (0.1, 0.5)
"""Distance from the axis up to which a quadrotor counts as on it: metres at the gate, and more per metre before it."""
ACCELERATION = 6.0
"""Maximum acceleration apart from gravity, metres per second squared."""
GAINS = {"place": 2.5, "velocity": 3.5, "tilt": 9.0, "yaw": 4.0}
"""Control gains, per second: distance to speed, speed to acceleration, tilt to body rate, heading to yaw rate."""


class Flying(NamedTuple):
    """Poses and velocities of B quadrotors.

    Attributes:
        place: [B, 3] world, metres.
        turn: [B, 4] unit quaternion wxyz, body to world.
        velocity: [B, 3] world, metres per second.
    """

    place: Tensor
    turn: Tensor
    velocity: Tensor


def fly_through(flying: Flying, gate: Tensor, limits: Tensor) -> Tensor:
    """Return the thrust and body rates that fly quadrotors through a gate while they face it.

    Each flies to a target point ahead of it on the gate's axis; the acceleration towards this point determines the
    thrust and the direction of the rotors, as in geometric tracking control (Lee, Leok and McClamroch 2010).

    Args:
        flying: poses and velocities of the quadrotors.
        gate: [B, 4] centre and yaw of each quadrotor's gate, which is passed along its yaw; world, metres and radians.
        limits: [2, 4] lowest and highest actions.

    Returns:
        [B, 4] float32: thrust in multiples of the quadrotor's weight, and rates about its own x, y and z axes, radians
        per second.
    """
    place, turn, velocity = (part.double() for part in flying)
    gate = gate.double()
    level = torch.zeros_like(gate[:, 3])
    axis = torch.stack([gate[:, 3].cos(), gate[:, 3].sin(), level], 1)
    offset = place - gate[:, :3]
    along = (offset * axis).sum(1, keepdim=True)
    aside = (offset - along * axis).norm(dim=1, keepdim=True)
    on_axis = aside <= FUNNEL[0] + FUNNEL[1] * (-along).clamp_min(0.0)
    carrot = gate[:, :3] + torch.where(on_axis, along + CARROT, -torch.full_like(along, APPROACH)) * axis
    way = carrot - place
    far = way.norm(dim=1, keepdim=True).clamp_min(1e-6)
    wanted = way / far * (GAINS["place"] * far).clamp_max(SPEED)
    force = GAINS["velocity"] * (wanted - velocity)
    force = force * (ACCELERATION / force.norm(dim=1, keepdim=True).clamp_min(1e-6)).clamp_max(1.0)
    force = force + torch.tensor([0.0, 0.0, GRAVITY], dtype=force.dtype, device=force.device)
    body_to_world = quats_to_rotations(turn)
    up = body_to_world[:, :, 2]
    thrust = (force * up).sum(1) / GRAVITY
    tilt = torch.linalg.cross(up, force / force.norm(dim=1, keepdim=True))
    rates = GAINS["tilt"] * (body_to_world * tilt.unsqueeze(2)).sum(1)  # in the body's own axes
    look = gate[:, :3] + 0.5 * axis - place
    nose = body_to_world[:, :, 0]
    off = wrapped(azimuths(look) - azimuths(nose))
    action = torch.cat([thrust.unsqueeze(1), rates[:, :2], (GAINS["yaw"] * off).unsqueeze(1)], 1)
    low, high = limits.to(action)
    return action.clamp(low, high).float()
