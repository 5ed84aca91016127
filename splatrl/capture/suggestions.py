"""Suggest where to send a robot in a captured place: poses with a view, and a free place for an object to find."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from splatrl.capture.area import GRID, Area
from splatrl.capture.world import Placed
from splatrl.collision.columns import cells_across
from splatrl.scenes.gaussians import Gaussians
from splatrl.scenes.scene import OPAQUE
from splatrl.spherical_harmonics import C0

Floats = NDArray[np.float64]
Goal = tuple[float, float, float]
"""x and y in metres, and yaw in degrees."""

ROOM = (0.35, 0.3, 0.2, 0.1, 0.05)
"""Free space around a robot, metres; the first value that leaves enough places is taken."""
ENOUGH = 6
FARTHEST = 1.0
"""Largest clearance, metres, that is told from a larger one."""
NEAR = (0.4, 2.5)
"""Range of distances to what a goal sees, metres, where steps are ``GRID``; longer steps scale it up."""
HALF_VIEW = math.radians(35.0)
HEADINGS = 16
COUNT = 4
"""Number of goals to choose from."""
MOST = 200
"""Maximum number of places that are examined where no path is known."""
SAMPLE = 20_000
THING = 1.6
"""Width of an object in steps: that of an apple of 0.16 m with steps of 0.1 m."""
APART = 0.7
"""Minimum distance between goals, metres, unless they differ by an eighth of a turn."""


@dataclass(frozen=True)
class Suggestions:
    """What a robot could look for.

    Attributes:
        goals: goals, the best first; empty where nothing is free.
        thing: x, y, z of a free place with room around it, for an object; None where nothing is free.
    """

    goals: list[Goal]
    thing: tuple[float, float, float] | None


NOTHING = Suggestions([], None)


@dataclass(frozen=True, eq=False)
class Seen:
    """What there is to see in a place.

    Attributes:
        points: [P, 3] float64, world, metres.
        colors: [P, 3] float64 in [0, 1].
        path: [N, 2] float64, where people walked, x and y in metres; None where unknown.
    """

    points: Floats
    colors: Floats
    path: Floats | None = None


def seen_by_cameras(placed: Placed) -> Seen:
    """Return the points of a reconstruction, and the path of its cameras."""
    reconstruction = placed.reconstruction
    path = reconstruction.camera_to_world[:, :2, 3].numpy()
    return Seen(reconstruction.points.numpy(), reconstruction.colors.numpy() / 255.0, path)


def seen_in_splat(gaussians: Gaussians) -> Seen:
    """Return opaque Gaussians as points, evenly thinned out to fewer than twice ``SAMPLE``."""
    chosen = gaussians[gaussians.opacities >= OPAQUE]
    chosen = chosen[:: max(1, len(chosen.means) // SAMPLE)]
    colors = (0.5 + C0 * chosen.sh[:, 0]).clamp(0, 1)
    return Seen(chosen.means.double().cpu().numpy(), colors.double().cpu().numpy())


def suggest(seen: Seen, area: Area) -> Suggestions:
    """Find goals in the largest connected free part of the place where people walked, at the robot's height.

    A goal stands on the robot's lattice near the path, where one is known, and faces near points of many colours, so
    that there is something to recognise. The object stands where there is most room around it, preferably near the
    middle.
    """
    places, clearance = _free_places(area)
    if len(places) == 0:
        return NOTHING
    candidates = np.unique(np.linspace(0, len(places) - 1, MOST).astype(np.int64))
    if seen.path is not None:
        away = np.linalg.norm(places[:, None] - seen.path, axis=2).min(1)
        candidates = np.flatnonzero(away <= max(0.4, float(np.sort(away)[min(ENOUGH, len(away) - 1)])))
    wider = max(1.0, area.spacing / GRID)
    varied = seen.colors.std(1)
    scores = np.stack([_scores(seen, varied, places[row], area.robot_height, wider) for row in candidates])
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
    wide = clearance - 0.15 * np.linalg.norm(places - middle, axis=1)
    x, y = places[int(wide.argmax())].tolist()
    return Suggestions(goals, (round(x, 3), round(y, 3), area.robot_height))


def thing_size(area: Area) -> float | None:
    """Return the width, metres, of an object that fills a robot's view at the area's step; None for the usual width."""
    return None if area.step is None else round(THING * area.step, 2)


def place_proposals(area: Area, found: Suggestions) -> dict[str, Any]:
    """Return what a ``scene.yaml`` says about training in a place, by the keys of ``PROPOSALS``."""
    return {
        "robot_height": area.robot_height,
        "walk": [list(corner) for corner in area.walk],
        "step": area.step,
        "voxel_size": area.occupancy.resolution,
        "goal": list(found.goals[0]) if found.goals else None,
        "object": list(found.thing) if found.thing else None,
        "object_size": thing_size(area),
    }


def _free_places(area: Area) -> tuple[Floats, Floats]:
    """Return the free and connected places [F, 2] of the robot's lattice, and the clearance around each, metres."""
    edge = area.spacing
    lower, upper = np.array(area.walk)
    axes = [low + edge * np.arange(round((high - low) / edge) + 1) for low, high in zip(lower, upper, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), -1)
    part, clearance = np.zeros(grid.shape[:2], bool), np.zeros(grid.shape[:2])
    for room in ROOM:
        clearance = _clearance(area, grid, room)
        labels, count = ndimage.label(clearance >= room)
        if count:
            part = labels == 1 + int(np.bincount(labels.reshape(-1))[1:].argmax())
        if part.sum() >= ENOUGH:
            break
    return grid[part], clearance[part]


def _clearance(area: Area, places: Floats, room: float) -> Floats:
    """Return how far places [X, Y, 2] are from what is no floor or is solid near the robot's height: [X, Y], metres.

    The distance is measured across the floor, a lower bound, at most ``FARTHEST``. Near are ``room`` above the robot's
    height and below it, but no more than half-way down to z = 0: the floor itself leaves a robot its room.
    """
    solid, edge, height = area.occupancy, area.occupancy.resolution, area.robot_height
    low, high = height - min(room, 0.5 * height), height + room
    layers = np.arange(math.floor(low / edge), math.floor(high / edge) + 1) - solid.origin_key[2]
    layers = layers[(layers >= 0) & (layers < solid.occupied.shape[2])]
    free = ~np.pad(solid.occupied[:, :, layers].any(2), 1)
    origin = np.array(solid.origin_key[:2]) - 1
    if area.floor is not None:
        columns = (np.indices(free.shape).reshape(2, -1).T + origin + 0.5) * edge
        level = (area.floor.origin_key[2] + 0.5) * area.floor.resolution
        free &= area.floor.contains(np.insert(columns, 2, level, axis=1)).reshape(free.shape)
    return np.minimum((cells_across(~free, origin.tolist(), edge, places) - 1.0) * edge, FARTHEST)


def _scores(seen: Seen, varied: Floats, place: Floats, height: float, wider: float) -> Floats:
    """Score how much there is to recognise from a place in each heading: [HEADINGS].

    ``varied`` is the standard deviation [P] across the channels of each colour.
    """
    points, colors = seen.points, seen.colors
    offsets = points - [*place, height]
    apart = np.sqrt(offsets[:, 0] ** 2 + offsets[:, 1] ** 2)
    near = (apart > NEAR[0] * wider) & (apart < NEAR[1] * wider) & (np.abs(offsets[:, 2]) < math.tan(HALF_VIEW) * apart)
    bearing, apart, colors = np.arctan2(offsets[near, 1], offsets[near, 0]), apart[near], colors[near]
    varied = varied[near]
    scores = np.zeros(HEADINGS)
    for heading in range(HEADINGS):
        turn = bearing - heading * math.tau / HEADINGS + math.pi  # more than -2π, since bearings are more than -π
        shown = np.abs(np.where(turn < 0.0, turn + math.tau, turn) - math.pi) < HALF_VIEW
        if shown.sum() >= 10:
            variety = float(colors[shown].std(0).sum() + varied[shown].mean())
            scores[heading] = variety * math.sqrt(float((1.0 / apart[shown]).sum()))
    return scores


def _differ(goal: Goal, other: Goal) -> bool:
    turn = abs((goal[2] - other[2] + 180.0) % 360.0 - 180.0)
    return math.dist(goal[:2], other[:2]) >= APART or turn >= 45.0
