"""The occupancy of a captured kitchen, compared with hand-made collision boxes."""

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import torch

from splatrl.bodies import Box
from splatrl.collision import FclChecker, Occupancy
from splatrl.geometry import rigid
from splatrl.scenes import read_scene

MIDDLE = ((-0.75, 0.0, 0.1), (0.75, 0.85, 1.9))
"""The space between the counters on three sides, from above the floor to the ceiling."""


@pytest.fixture(scope="module")
def occupancy(shared_scenes: Path) -> Occupancy:
    scene = read_scene(shared_scenes / "kitchen" / "kitchen.spz", world_from_splat={"axes": ["x", "-z", "y"]})
    return Occupancy.from_gaussians(scene.gaussians)


@pytest.fixture(scope="module")
def boxes(shared_scenes: Path) -> np.ndarray:
    """Lower and upper corners of the hand-made boxes, three counters and three walls: [N, 2, 3]."""
    corners = []
    for body in ElementTree.parse(shared_scenes / "kitchen" / "collision.xml").iter("body"):
        center, half = (np.array(e.split(), float) for e in (body.attrib["pos"], body.find("geom").attrib["size"]))
        corners.append((center - half, center + half))
    return np.array(corners)


def places(lower, upper, count: int = 4000) -> torch.Tensor:
    points = np.random.default_rng(0).uniform(lower, upper, (count, 3))
    return rigid(torch.eye(3), torch.from_numpy(points).float())


def test_a_cube_in_the_open_middle_hits_nothing(occupancy, boxes):
    cube = Box((0.1, 0.1, 0.1))
    poses = places(*MIDDLE)
    reference = Occupancy.from_boxes(boxes[:, 0], boxes[:, 1], 0.02)
    assert not FclChecker(reference, cube).collides(poses).any()
    assert FclChecker(occupancy, cube).collides(poses).float().mean() <= 0.01


def test_the_floor_is_closed_and_a_low_body_drives_above_it(occupancy):
    lower, upper = (-0.75, 0.05, 0.0), (0.75, 0.65, 0.0)
    assert FclChecker(occupancy, Box((0.01, 0.01, 0.1))).collides(places(lower, upper)).all()
    above = places(lower, upper)
    above[:, 2, 3] = 0.4
    assert not FclChecker(occupancy, Box((0.4, 0.4, 0.1))).collides(above).any()


def test_a_body_that_enters_a_counter_from_the_middle_hits_it(occupancy, boxes):
    body = FclChecker(occupancy, Box((0.1, 0.1, 0.1)))
    count = 300
    start = places((-0.7, 0.05, 0.15), (0.7, 0.75, 0.7), count)
    for (lower, upper), axis in zip(boxes[:3], (0, 1, 0), strict=True):
        end = start.clone()
        end[:, axis, 3] = float(0.5 * (lower + upper)[axis])
        assert body.sweeps(start, end).float().mean() >= 0.99


def test_the_grid_is_no_larger_than_the_room(occupancy):
    lower, upper = occupancy.bounds
    assert (lower > [-2.2, -1.5, -0.3]).all()
    assert (upper < [2.4, 1.4, 2.7]).all()
