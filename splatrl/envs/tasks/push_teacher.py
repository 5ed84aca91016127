"""A teacher for the push task: where robot, ball and mark are, it knows how to drive.

It goes round the ball to the side away from the mark, on the side on which there is more room, drives at the ball until
it rests in the bumper, and steers it to the mark. What is solid repels it (Khatib 1986), so it can come to a halt
between things. A teacher is asked for actions in states that a policy visits (DAgger), so it remembers nothing.
"""

import math
from collections.abc import Callable

import torch
from torch import Tensor

from splatrl.envs.sensors.odometry import wrapped

RING = 0.48
"""Radius of the way round the ball, metres."""
NEAR, BLEND = 0.6, 0.3
"""Beyond this distance from the ball a robot drives straight to the place behind it; metres over which that begins."""
BEHIND = 0.5
"""Angle at the ball within which a robot counts as behind it, radians."""
HELD = (0.1, 0.31, 0.08)
"""Where a ball rests in the bumper: nearest and farthest ahead of the robot, and aside, metres."""
SIDEWAYS = 1.4
"""Angle between the robot and the way to the mark from which it lets the ball go to drive round it, radians."""
SPEED, PUSHING, BACKWARDS = 0.45, 0.3, -0.2
"""Metres per second."""
ROOM, AHEAD = 0.3, 0.12
"""Distance from what is solid within which it repels, measured a little ahead of the robot, metres."""
PROBES = 8

Room = Callable[[Tensor], Tensor]


def pushing(robot: Tensor, ball: Tensor, mark: Tensor, room: Room) -> Tensor:
    """Velocities with which robots push balls to marks.

    Args:
        robot: [B, 3] float64, x and y in metres and yaw in radians.
        ball: [B, 2] float64, metres.
        mark: [B, 2] float64, metres.
        room: [N, 2] -> [N], distance of places from what is solid and from the bounds, metres.

    Returns:
        [B, 2] float32, metres per second ahead and radians per second to the left.
    """
    place, yaw = robot[:, :2], robot[:, 2]
    facing = torch.stack([yaw.cos(), yaw.sin()], 1)
    away = place - ball
    far = away.norm(dim=1)
    ahead = -(away * facing).sum(1)
    aside = -(facing[:, 0] * away[:, 1] - facing[:, 1] * away[:, 0])
    along = torch.nn.functional.normalize(mark - ball, dim=1)
    off = wrapped(_angle(along) - yaw)  # of the way to the mark from where the robot looks
    held = (ahead > HELD[0]) & (ahead < HELD[1]) & (aside.abs() < HELD[2])

    way = _way(place, ball, away / far.clamp_min(1e-9).unsqueeze(1), far, along, room)
    clear, uphill = _repelled(place + AHEAD * facing, room)
    way = way + (2.0 * ((ROOM - clear) / 0.15).clamp(0.0, 1.0)).unsqueeze(1) * uphill
    turn = wrapped(_angle(way) - yaw)
    near = (far < 0.4) & (ahead > 0) & (torch.atan2(aside, ahead).abs() < 1.0) | (clear < 0.12)
    speed = torch.where(near & (turn.abs() > 0.9), BACKWARDS, SPEED * turn.cos().clamp_min(0.0) ** 2)
    free = torch.stack([speed, 3.0 * turn], 1)

    steered = torch.stack([torch.full_like(off, PUSHING), (3.0 * off).clamp(-0.9, 0.9)], 1)
    left = torch.stack([torch.full_like(off, BACKWARDS), torch.zeros_like(off)], 1)
    pushed = torch.where((off.abs() < SIDEWAYS).unsqueeze(1), steered, left)
    return torch.where(held.unsqueeze(1), pushed, free).float()


def _way(place: Tensor, ball: Tensor, radial: Tensor, far: Tensor, along: Tensor, room: Room) -> Tensor:
    """The direction in which to go while the ball is not held: [B, 2] unit vectors."""
    sign = _side(ball, radial, along, room)
    tangent = torch.stack([-radial[:, 1], radial[:, 0]], 1)
    ring = torch.nn.functional.normalize(sign.unsqueeze(1) * tangent + 4.0 * (RING - far).unsqueeze(1) * radial, dim=1)
    straight = torch.nn.functional.normalize(ball - 0.45 * along - place, dim=1)
    share = ((far - NEAR) / BLEND).clamp(0.0, 1.0).unsqueeze(1)
    way = torch.nn.functional.normalize((1.0 - share) * ring + share * straight, dim=1)
    behind = wrapped(_angle(radial) - _angle(-along)).abs() < BEHIND
    return torch.where(behind.unsqueeze(1), -radial, way)


def _side(ball: Tensor, radial: Tensor, along: Tensor, room: Room) -> Tensor:
    """Which way round: 1 counter-clockwise, −1 clockwise; the shorter one, unless there is less room on it; [B]."""
    begin = _angle(radial)
    left = (_angle(-along) - begin) % math.tau
    share = torch.linspace(0.08, 0.92, PROBES, dtype=ball.dtype, device=ball.device)
    worth = []
    for angle in (left, left - math.tau):
        turn = begin[:, None] + angle[:, None] * share
        places = ball[:, None] + RING * torch.stack([turn.cos(), turn.sin()], 2)
        least = room(places.reshape(-1, 2)).reshape(len(ball), -1).amin(1).clamp_max(0.25)
        worth.append(8.0 * least - angle.abs())
    return torch.where(worth[0] > worth[1], 1.0, -1.0).to(ball)


def _repelled(places: Tensor, room: Room, step: float = 0.05) -> tuple[Tensor, Tensor]:
    """Room at places, and the direction in which it grows: [B], [B, 2]."""
    x, y = torch.eye(2, dtype=places.dtype, device=places.device) * step
    slope = [(room(places + axis) - room(places - axis)) / (2 * step) for axis in (x, y)]
    return room(places), torch.stack(slope, 1)


def _angle(vectors: Tensor) -> Tensor:
    return torch.atan2(vectors[:, 1], vectors[:, 0])
