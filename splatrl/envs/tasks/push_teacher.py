"""A teacher for the push task: where robot, ball and mark are, it knows how to drive.

It drives to the side of the ball away from the mark, by the cheapest of some ways of two straight legs, which cost more
where they come near to the ball or to what is solid. There it drives at the ball until it rests in the bumper, and
steers it to the mark. A teacher is asked for actions in states that a policy visits (DAgger), so it remembers nothing.
Where a camera ahead shows neither ball nor mark and it has to turn, it turns to the left, although it knows better:
nobody who has to look could learn which way is shorter.
"""

import math
from collections.abc import Callable

import torch
from torch import Tensor

from splatrl.envs.sensors.odometry import wrapped

BACK = 0.45
"""Distance from the ball at which the robot begins to push, metres."""
BEHIND = 0.5
"""Angle at the ball within which a robot counts as behind it, radians."""
HELD = (0.1, 0.31, 0.08)
"""Where a ball rests in the bumper: nearest and farthest ahead of the robot, and aside, metres."""
SIDEWAYS = 1.4
"""Angle between the robot and the way to the mark from which it lets the ball go to drive round it, radians."""
EYE, SEEN = -0.06, (1.4, 1.15)
"""Metres by which the camera is ahead of the robot; angles from where it looks within which it sees ball and mark."""
TURN = 0.7
"""Angle to its way beyond which it has to turn, radians."""
SPEED, PUSHING, BACKWARDS = 0.45, 0.3, -0.2
"""Metres per second."""
ROOM, BALL_ROOM = 0.3, 0.34
"""Distances from what is solid and from the ball within which a way costs more, metres."""
DEAR = 30.0
"""Metres that a metre costs where there is no room at all."""
RINGS = (0.5, 0.3, 0.6, 1.0)
"""Radii of the circles on which ways may bend, the first about the ball and the others about the robot, metres."""
BENDS, SAMPLES = 16, 8
"""Bends on each circle, and points of a leg that are looked up."""

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

    behind = wrapped(_angle(-away) - _angle(along)).abs() < BEHIND
    bend = _bend(place, ball, ball - BACK * along, room)
    way = torch.where(behind.unsqueeze(1), -away, bend - place)
    clear = room(place)
    turn = wrapped(_angle(way) - yaw)
    eye = place + EYE * facing
    off_sight = [wrapped(_angle(one - eye) - yaw).abs() for one in (ball, mark)]
    blind = (off_sight[0] > SEEN[0]) & (off_sight[1] > SEEN[1]) & (turn.abs() > TURN)
    turn = torch.where(blind, 0.5 * math.pi, turn)
    near = (far < 0.4) & (ahead > 0) & (torch.atan2(aside, ahead).abs() < 1.0) | (clear < 0.12)
    speed = torch.where(near & (turn.abs() > 0.9), BACKWARDS, SPEED * turn.cos().clamp_min(0.0) ** 2)
    free = torch.stack([speed, 3.0 * turn], 1)

    steered = torch.stack([torch.full_like(off, PUSHING), (3.0 * off).clamp(-0.9, 0.9)], 1)
    left = torch.stack([torch.full_like(off, BACKWARDS), torch.zeros_like(off)], 1)
    pushed = torch.where((off.abs() < SIDEWAYS).unsqueeze(1), steered, left)
    return torch.where(held.unsqueeze(1), pushed, free).float()


def _bend(place: Tensor, ball: Tensor, goal: Tensor, room: Room) -> Tensor:
    """Where the cheapest way of two legs from places to goals bends, all [B, 2] metres."""
    angle = torch.arange(BENDS, dtype=place.dtype, device=place.device) * (math.tau / BENDS)
    circle = torch.stack([angle.cos(), angle.sin()], 1)
    rings = [(ball if number == 0 else place)[:, None] + radius * circle for number, radius in enumerate(RINGS)]
    bends = torch.cat([goal[:, None], *rings], 1)
    cost = _cost(place[:, None].expand_as(bends), bends, ball, room)
    cost = cost + _cost(bends, goal[:, None].expand_as(bends), ball, room)
    return bends[torch.arange(len(bends), device=bends.device), cost.argmin(1)]


def _cost(start: Tensor, end: Tensor, ball: Tensor, room: Room) -> Tensor:
    """What straight legs cost, as metres: [B, K, 2], [B, K, 2] -> [B, K]."""
    share = (torch.arange(SAMPLES, dtype=start.dtype, device=start.device) + 0.75) / SAMPLES
    points = start.unsqueeze(2) + share[:, None] * (end - start).unsqueeze(2)
    clear = room(points.reshape(-1, 2)).reshape(points.shape[:3])
    near = (points - ball[:, None, None]).norm(dim=3)
    tight = ((ROOM - clear) / ROOM).clamp(0.0, 1.0).square() + ((BALL_ROOM - near) / BALL_ROOM).clamp_min(0.0)
    return (end - start).norm(dim=2) * (1.0 + DEAR * tight.mean(2))


def _angle(vectors: Tensor) -> Tensor:
    return torch.atan2(vectors[:, 1], vectors[:, 0])
