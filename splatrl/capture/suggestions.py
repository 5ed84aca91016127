"""Where a robot could be sent in a captured place: poses that see something, and a free place for a thing to find."""

import math
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy import ndimage

from splatrl.bodies import Sphere
from splatrl.capture.area import GRID, Area
from splatrl.capture.world import Placed
from splatrl.collision import NativeChecker

Floats = NDArray[np.float64]
Goal = tuple[float, float, float]
"""x and y in metres and yaw in degrees."""

ROOM = (0.35, 0.3, 0.2, 0.1, 0.05)
"""Metres of free space around a robot, the first that leaves enough places."""
ENOUGH = 6
NEAR = (0.4, 2.5)
"""Metres to what a goal sees."""
HALF_VIEW = math.radians(35.0)
HEADINGS = 16
COUNT = 4
"""Goals to choose from."""
APART = 0.7
"""Metres between them, or an eighth of a turn."""


@dataclass(frozen=True)
class Suggestions:
    """What a robot could look for.

    Attributes:
        goals: the best first; empty where nothing is free.
        thing: x, y, z of a free place with room around it; None where nothing is free.
    """

    goals: list[Goal]
    thing: tuple[float, float, float] | None


NOTHING = Suggestions([], None)


def suggest(placed: Placed, area: Area) -> Suggestions:
    """Find goals in the largest connected free part of the place where people walked, at the robot's height.

    A goal stands on the robot's lattice near the path and faces near points of many colours: there is something to
    recognise. The thing stands where the room around it is widest.
    """
    places, clearance = _free_places(area)
    if len(places) == 0:
        return NOTHING
    path = placed.reconstruction.camera_to_world[:, :2, 3].numpy()
    away = np.linalg.norm(places[:, None] - path, axis=2).min(1)
    candidates = np.flatnonzero(away <= max(0.4, float(np.sort(away)[min(ENOUGH, len(away) - 1)])))
    scores = np.stack([_scores(placed, places[row], area.robot_height) for row in candidates])  # [C, headings]
    goals: list[Goal] = []
    for best in np.argsort(-scores, axis=None, kind="stable").tolist():
        row, heading = divmod(best, HEADINGS)
        x, y = places[candidates[row]].tolist()
        goal = (round(x, 3), round(y, 3), heading * 360.0 / HEADINGS)
        if scores[row, heading] > 0 and all(_differ(goal, other) for other in goals):
            goals.append(goal)
        if len(goals) == COUNT:
            break
    middle = 0.5 * np.add(*area.walk)
    wide = np.minimum(clearance, 1.0) - 0.15 * np.linalg.norm(places - middle, axis=1)
    x, y = places[int(wide.argmax())].tolist()
    return Suggestions(goals, (round(x, 3), round(y, 3), area.robot_height))


def _free_places(area: Area) -> tuple[Floats, Floats]:
    """Places [F, 2] of the robot's lattice that are free and connected, and the room around each, metres."""
    edge = area.step or GRID
    lower, upper = np.array(area.walk)
    axes = [low + edge * np.arange(round((high - low) / edge) + 1) for low, high in zip(lower, upper, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), -1)
    places = np.concatenate([grid, np.full((*grid.shape[:2], 1), area.robot_height)], -1).reshape(-1, 3)
    checker = NativeChecker(area.occupancy, Sphere(0.05))
    clearance = checker.clearance(torch.from_numpy(places).float()).double().numpy().reshape(grid.shape[:2])
    bounded = np.minimum(clearance, 10.0)
    part = np.zeros(grid.shape[:2], bool)
    for room in ROOM:
        labels, count = ndimage.label(clearance >= room)
        if count:
            part = labels == 1 + int(np.bincount(labels.reshape(-1))[1:].argmax())
        if part.sum() >= ENOUGH:
            break
    return grid[part], bounded[part]


def _scores(placed: Placed, place: Floats, height: float) -> Floats:
    """How much there is to recognise from a place in each heading: [HEADINGS]."""
    points, colors = placed.reconstruction.points.numpy(), placed.reconstruction.colors.numpy() / 255.0
    offsets = points - [*place, height]
    apart = np.linalg.norm(offsets[:, :2], axis=1)
    near = (apart > NEAR[0]) & (apart < NEAR[1]) & (np.abs(offsets[:, 2]) < math.tan(HALF_VIEW) * apart)
    bearing, apart, colors = np.arctan2(offsets[near, 1], offsets[near, 0]), apart[near], colors[near]
    scores = np.zeros(HEADINGS)
    for heading in range(HEADINGS):
        turn = (bearing - heading * math.tau / HEADINGS + math.pi) % math.tau - math.pi
        seen = np.abs(turn) < HALF_VIEW
        if seen.sum() >= 10:
            variety = float(colors[seen].std(0).sum() + colors[seen].std(1).mean())
            scores[heading] = variety * math.sqrt(float((1.0 / apart[seen]).sum()))
    return scores


def _differ(goal: Goal, other: Goal) -> bool:
    turn = abs((goal[2] - other[2] + 180.0) % 360.0 - 180.0)
    return math.dist(goal[:2], other[:2]) >= APART or turn >= 45.0
