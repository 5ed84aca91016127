"""A scripted pusher that knows the positions of robot, ball and mark, and so demonstrates the push task.

It drives to the side of the ball away from the mark along the cheapest of several paths of two straight legs; legs cost
more where they pass close to the ball or to obstacles. From there it drives at the ball until the ball rests in the
bumper, and steers it to the mark. It is queried in states that a policy visits (DAgger), so it has no memory.
If the camera shows neither ball nor mark and a turn is needed, it turns left even where a right turn is shorter, since
a policy that relies on the camera could not learn which way is shorter.
"""

import math
from collections.abc import Callable

import torch
from torch import Tensor

from splatrl.geometry import along_heading, atan2, azimuths, wrapped

BACK = 0.45
"""Distance from the ball at which the robot begins to push, metres."""
BEHIND = 0.5
"""Maximum angle at the ball, from straight behind it, at which a robot counts as behind it, radians."""
HELD = (0.1, 0.31, 0.08)
"""Region in which a ball rests in the bumper: minimum and maximum distance ahead of the robot, and aside, metres."""
SIDEWAYS = 1.4
"""Angle from the heading to the ball-to-mark direction beyond which it backs off to drive round the ball, radians."""
EYE, SEEN = -0.06, (1.4, 1.15)
"""Camera position ahead of the robot's centre, metres; maximum angles at which it sees ball and mark, radians."""
TURN = 0.7
"""Angle between heading and desired direction beyond which the robot has to turn, radians."""
SPEED, PUSHING, BACKWARDS = 0.45, 0.3, -0.2
"""Speeds when driving freely, pushing and backing up, metres per second."""
ROOM, BALL_ROOM = 0.3, 0.34
"""Distances from obstacles and from the ball below which a path costs more, metres."""
DEAR = 30.0
"""Additional cost per metre of path where there is no room at all, metres."""
RINGS = (0.5, 0.3, 0.6, 1.0)
"""Radii of the circles on which paths may bend, the first around the ball and the others around the robot, metres."""
BENDS, SAMPLES = 16, 8
"""Candidate bends on each circle, and sample points on each leg."""

Room = Callable[[Tensor], Tensor]


def pushing(robot: Tensor, ball: Tensor, mark: Tensor, room: Room) -> Tensor:
    """Return the velocities with which robots push balls to marks.

    Args:
        robot: [B, 3] float64, x and y in metres and yaw in radians.
        ball: [B, 2] float64, metres.
        mark: [B, 2] float64, metres.
        room: [N, 2] -> [N], distance from places to obstacles and to the bounds, metres.

    Returns:
        [B, 2] float32, metres per second ahead and radians per second to the left.
    """
    place, yaw = robot[:, :2], robot[:, 2]
    facing = torch.stack([yaw.cos(), yaw.sin()], 1)
    away = place - ball
    far = away.norm(dim=1)
    ahead, aside = along_heading(-away, yaw).unbind(1)
    along = torch.nn.functional.normalize(mark - ball, dim=1)
    off = wrapped(azimuths(along) - yaw)  # angle from the heading to the ball-to-mark direction
    held = (ahead > HELD[0]) & (ahead < HELD[1]) & (aside.abs() < HELD[2])

    behind = wrapped(azimuths(-away) - azimuths(along)).abs() < BEHIND
    bend = _bend(place, ball, ball - BACK * along, room)
    way = torch.where(behind.unsqueeze(1), -away, bend - place)
    clear = room(place)
    turn = wrapped(azimuths(way) - yaw)
    eye = place + EYE * facing
    off_sight = [wrapped(azimuths(one - eye) - yaw).abs() for one in (ball, mark)]
    blind = (off_sight[0] > SEEN[0]) & (off_sight[1] > SEEN[1]) & (turn.abs() > TURN)
    turn = torch.where(blind, 0.5 * math.pi, turn)
    near = (far < 0.4) & (ahead > 0) & (atan2(aside, ahead).abs() < 1.0) | (clear < 0.12)
    speed = torch.where(near & (turn.abs() > 0.9), BACKWARDS, SPEED * turn.cos().clamp_min(0.0) ** 2)
    free = torch.stack([speed, 3.0 * turn], 1)

    steered = torch.stack([torch.full_like(off, PUSHING), (3.0 * off).clamp(-0.9, 0.9)], 1)
    left = torch.stack([torch.full_like(off, BACKWARDS), torch.zeros_like(off)], 1)
    pushed = torch.where((off.abs() < SIDEWAYS).unsqueeze(1), steered, left)
    return torch.where(held.unsqueeze(1), pushed, free).float()


def _bend(place: Tensor, ball: Tensor, goal: Tensor, room: Room) -> Tensor:
    """Return the bend of the cheapest two-leg path from places to goals, all [B, 2] metres."""
    angle = torch.arange(BENDS, dtype=place.dtype, device=place.device) * (math.tau / BENDS)
    circle = torch.stack([angle.cos(), angle.sin()], 1)
    rings = [(ball if number == 0 else place)[:, None] + radius * circle for number, radius in enumerate(RINGS)]
    bends = torch.cat([goal[:, None], *rings], 1)
    cost = _cost(place[:, None].expand_as(bends), bends, ball, room)
    cost = cost + _cost(bends, goal[:, None].expand_as(bends), ball, room)
    return bends[torch.arange(len(bends), device=bends.device), cost.argmin(1)]


def _cost(start: Tensor, end: Tensor, ball: Tensor, room: Room) -> Tensor:
    """Return the cost of straight legs, in metres: [B, K, 2], [B, K, 2] -> [B, K]."""
    share = (torch.arange(SAMPLES, dtype=start.dtype, device=start.device) + 0.75) / SAMPLES
    points = start.unsqueeze(2) + share[:, None] * (end - start).unsqueeze(2)
    clear = room(points.reshape(-1, 2)).reshape(points.shape[:3])
    near = (points - ball[:, None, None]).norm(dim=3)
    tight = ((ROOM - clear) / ROOM).clamp(0.0, 1.0).square() + ((BALL_ROOM - near) / BALL_ROOM).clamp_min(0.0)
    return (end - start).norm(dim=2) * (1.0 + DEAR * tight.mean(2))
