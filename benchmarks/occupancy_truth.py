"""Ground truth of solid and free space in two scenes, and the places at which cubes test it."""

from collections.abc import Sequence
from dataclasses import dataclass
from xml.etree import ElementTree

import torch
from scenes import SCENES, kitchen
from torch import Tensor

from splatrl.scenes import Scene, backyard
from splatrl.scenes.yard import backyard_obstacles

Box = tuple[Sequence[float], Sequence[float]]
MARGIN = 0.12
"""Minimum distance of a small cube's centre from solid boxes to count as free, metres."""
BEFORE, BEHIND = 0.3, 0.6
"""Distances from a wall's inner face at which a move through it begins, inside, and ends, outside; metres."""


@dataclass(frozen=True)
class Wall:
    """An upright wall perpendicular to a horizontal axis.

    Attributes:
        side: signed axis that points outwards through the wall: 1 is +x, −2 is −y.
        plane: coordinate of its inner face on that axis, metres.
        span: extent along the other horizontal axis, metres.
    """

    side: int
    plane: float
    span: tuple[float, float]


@dataclass(frozen=True)
class Truth:
    """A scene with its ground truth; lengths in metres.

    Attributes:
        scene: the Gaussians.
        open: box in which cubes should be free, except for ``solids``.
        solids: boxes around everything solid near ``open``.
        faces: flat boxes on known surfaces.
        walls: walls around ``open``.
        whole: range of heights at which the walls are closed.
        gappy: range of heights at which the captured walls have gaps, or another range if they have none.
        seed: a free, reachable place.
    """

    scene: Scene
    open: Box
    solids: Sequence[Box]
    faces: Sequence[Box]
    walls: Sequence[Wall]
    whole: tuple[float, float]
    gappy: tuple[float, float]
    seed: tuple[float, float, float]

    def free(self, count: int) -> Tensor:
        """Draw places [M, 3], M ≤ count, in the open box and clear of the solids."""
        places = _uniform(self.open, count, 0)
        for lower, upper in self.solids:
            outside = (places < torch.tensor(lower) - MARGIN) | (places > torch.tensor(upper) + MARGIN)
            places = places[outside.any(1)]
        return places

    def surface(self, count: int) -> Tensor:
        """Draw places [M, 3] on the faces, equally many per square metre; M is about ``count``."""
        areas = torch.tensor([_area(face) for face in self.faces])
        counts = (count * areas / areas.sum()).ceil().long().tolist()
        return torch.cat([_uniform(face, n, i) for i, (face, n) in enumerate(zip(self.faces, counts, strict=True))])

    def through_floor(self, count: int) -> tuple[Tensor, Tensor]:
        """Return the ends of moves from a little above the floor to as much below it."""
        start = self.free(count)
        start[:, 2] = 0.3
        return start, start * torch.tensor([1.0, 1.0, -1.0])

    def through_wall(self, count: int, heights: tuple[float, float]) -> tuple[Tensor, Tensor]:
        """Return the ends of moves from ``BEFORE`` metres inside a wall's inner face to ``BEHIND`` metres beyond it."""
        generator = torch.Generator().manual_seed(9)
        rows, picks = torch.arange(count), torch.randint(len(self.walls), (count,), generator=generator)
        start = _uniform(((0.0, 0.0, heights[0]), (1.0, 1.0, heights[1])), count, 1)
        axes = torch.tensor([abs(wall.side) - 1 for wall in self.walls])[picks]
        signs = torch.tensor([1.0 if wall.side > 0 else -1.0 for wall in self.walls])[picks]
        planes, spans = torch.tensor([wall.plane for wall in self.walls]), torch.tensor([w.span for w in self.walls])
        low, high = spans[picks].unbind(1)
        start[rows, 1 - axes] = low + (high - low) * start[rows, 1 - axes]
        end = start.clone()
        start[rows, axes] = planes[picks] - BEFORE * signs
        end[rows, axes] = planes[picks] + BEHIND * signs
        return start, end


def kitchen_truth() -> Truth | None:
    """Return the kitchen and its hand-made boxes; None if it is not found."""
    subject = kitchen()
    if subject is None:
        return None
    boxes: list[Box] = []
    for body in ElementTree.parse(SCENES / "kitchen" / "collision.xml").iter("body"):
        geom = body.find("geom")
        assert geom is not None
        center, half = (torch.tensor([float(v) for v in e.split()]) for e in (body.attrib["pos"], geom.attrib["size"]))
        boxes.append(((center - half).tolist(), (center + half).tolist()))
    east, south, west = boxes[:3]
    top = south[1][2]
    faces: list[Box] = [
        ((east[0][0], -0.3, top), (1.5, 0.88, top)),
        ((-0.9, -0.7, top), (0.9, south[1][1], top)),
        ((-1.5, -0.3, top), (west[1][0], 0.88, top)),
        ((east[0][0], south[1][1], 0.1), (east[0][0], 0.85, top)),
        ((west[1][0], south[1][1], 0.1), (west[1][0], 0.85, top)),
        ((west[1][0], south[1][1], 0.1), (east[0][0], south[1][1], top)),
    ]
    middle = ((-0.75, 0.0, 0.1), (0.75, 0.85, 1.9))
    walls = [Wall(1, 1.7, (-0.8, 0.8)), Wall(-1, -1.7, (-0.8, 0.8)), Wall(-2, -0.86, (-1.6, 1.6))]
    return Truth(subject.scene, middle, boxes, faces, walls, (1.4, 1.9), (0.15, 1.2), (0.4, 0.4, 1.05))


def yard_truth() -> Truth:
    """Return the built-in backyard and what its generator knows."""
    solids: list[Box] = [(low, high) for _, low, high in backyard_obstacles()]
    flat = ("garden wall", "table", "wood pile", "bench seat")
    faces = [side for name, low, high in backyard_obstacles() if name in flat for side in _sides(low, high)]
    faces += [((-3.0, -2.8, 0.1), (-3.0, 2.9, 1.8)), ((-2.9, 3.0, 0.1), (2.7, 3.0, 1.6))]
    faces += [((-1.6, -2.9, 0.1), (0.8, -2.9, 1.9)), ((2.95, -2.9, 0.1), (2.95, 2.9, 1.45))]
    place = ((-2.3, -2.1, 0.2), (2.3, 2.2, 1.0))
    walls = [
        Wall(1, 2.9, (-2.8, 2.8)),
        Wall(-1, -3.0, (-2.8, 2.8)),
        Wall(2, 3.0, (-2.8, 2.8)),
        Wall(-2, -2.9, (-1.6, 0.8)),
    ]
    return Truth(backyard(), place, solids, faces, walls, (0.7, 1.4), (0.15, 0.6), (0.6, 0.4, 0.4))


def _sides(low: Sequence[float], high: Sequence[float]) -> list[Box]:
    """Return the four upright faces of a box and its top."""
    (x0, y0, z0), (x1, y1, z1) = low, high
    upright = [((x, y0, z0), (x, y1, z1)) for x in (x0, x1)] + [((x0, y, z0), (x1, y, z1)) for y in (y0, y1)]
    return [*upright, ((x0, y0, z1), (x1, y1, z1))]


def _area(face: Box) -> float:
    a, b = sorted((high - low for low, high in zip(*face, strict=True)), reverse=True)[:2]
    return a * b


def _uniform(box: Box, count: int, seed: int) -> Tensor:
    lower, upper = torch.tensor(box[0]), torch.tensor(box[1])
    return lower + (upper - lower) * torch.rand(count, 3, generator=torch.Generator().manual_seed(seed))
