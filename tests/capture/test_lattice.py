"""The lattice of a captured place leads through its doorways, or it is said what does."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from splatrl.capture.area import survey_area
from splatrl.capture.lattice import FreeGround, Walk, aligned, free_ground, remarks
from splatrl.capture.walkable import walkable_area
from splatrl.collision.occupancy import Occupancy
from splatrl.evaluation.scene_pictures import survey_occupancy
from splatrl.scenes import Scene
from splatrl.scenes.scene import captured_bounds
from tests.capture.rooms import tiny_capture
from tests.scenes.test_survey import surfaces

Boxes = list[tuple[float, ...]]


def rooms(door: float, width: float, x: float = 5.0) -> Boxes:
    """Return two rooms of 5 × 4 m, as boxes; the doorway in the wall between them begins at y = ``door``."""
    wall = x, x + 0.1
    outer = [(0.0, -0.1, 0.0, 10.1, 0.0, 2.0), (0.0, 4.0, 0.0, 10.1, 4.1, 2.0)]
    outer += [(-0.1, 0.0, 0.0, 0.0, 4.0, 2.0), (10.1, 0.0, 0.0, 10.2, 4.0, 2.0)]
    return [*outer, (wall[0], 0.0, 0.0, wall[1], door, 2.0), (wall[0], door + width, 0.0, wall[1], 4.0, 2.0)]


def ground_of(boxes: Boxes, known: Sequence[tuple[float, float]]) -> FreeGround:
    sides = torch.tensor(boxes)
    solid = Occupancy.empty(0.05).with_boxes(sides[:, :3], sides[:, 3:])
    return free_ground(solid, 0.4, WALK, np.array(known))


WALK: Walk = ((0.3, 0.3), (8.7, 3.9))
STEP = 0.4
HALL, ROOM = [(1.0, 1.0), (2.0, 2.0)], [(7.0, 1.0)]
"""Places where people walked."""


@pytest.mark.parametrize("width", [0.7, 0.9])
def test_the_lattice_leads_through_a_doorway_wherever_that_is(width: float) -> None:
    missed = []
    for door in np.arange(1.3, 1.7, 0.05):
        ground = ground_of(rooms(door, width), HALL)
        missed.append(ground.out_of_reach(WALK, STEP) > 0.4)
        walk = aligned(ground, WALK, STEP)
        assert (walk == WALK) != missed[-1], "a lattice that leads through it already stays"
        assert ground.out_of_reach(walk, STEP) == 0.0 and remarks(ground, walk, STEP) == []
        assert np.subtract(walk[1], walk[0]) == pytest.approx([8.4, 3.6])
        assert (np.abs(np.subtract(walk[0], WALK[0])) <= 0.5 * STEP + 1e-9).all()
    assert any(missed) == (width == 0.7)


def test_steps_that_reach_the_rest_are_named_where_no_lattice_of_the_usual_ones_leads_through_every_doorway() -> None:
    second = [(6.5, 0.0, 0.0, 6.6, 2.1, 2.0), (6.5, 2.7, 0.0, 6.6, 4.0, 2.0)]
    ground = ground_of([*rooms(1.5, 0.6), *second], HALL)
    walk = aligned(ground, WALK, STEP)
    said = " % of the free floor cannot be reached in steps of 0.4 m by a body 0.4 m wide: "
    assert remarks(ground, walk, STEP) == [f"22{said}task.motion.step=0.2 in training does."]
    assert ground.out_of_reach(walk, 0.2) == 0.0
    assert remarks(ground, walk, 3.6)[0].endswith("a narrower robot.body may reach it.")


def test_a_room_behind_a_gap_narrower_than_the_body_counts_if_people_walked_there() -> None:
    boxes = rooms(1.5, 0.4)
    assert remarks(ground_of(boxes, HALL), WALK, STEP) == []
    both = ground_of(boxes, [*HALL, *ROOM])
    assert remarks(both, WALK, STEP)[0].endswith("a narrower robot.body may reach it.")
    assert aligned(both, WALK, STEP) == WALK, "no lattice reaches more"


def test_splats_and_captures_have_a_lattice_that_leads_through_their_doorway(tmp_path: Path) -> None:
    gaussians = surfaces([(0.0, 0.0, 0.0, 10.1, 4.0, 0.0), *rooms(1.5, 0.7)], 0.08)
    scene, placed = Scene("rooms", gaussians, captured_bounds(gaussians)), tiny_capture(tmp_path)
    poses, count = placed.reconstruction.camera_to_world.clone(), len(placed.reconstruction.paths)
    poses[:, 0, 3] = torch.linspace(0.5, 9.6, count)
    poses[:, 1, 3] = torch.tensor([0.5, 3.5]).repeat(count // 2)
    splat = walkable_area(scene, survey_occupancy(scene), 0.0, 0.4)
    reconstruction = replace(placed.reconstruction, camera_to_world=poses)
    capture = survey_area(gaussians, replace(placed, reconstruction=reconstruction))
    assert splat is not None and capture.step == STEP
    for area in (splat, capture):
        assert area.ground(poses[:, :2, 3].numpy()).out_of_reach(area.walk, area.spacing) == 0.0
        for (low, high), first, last in zip(zip(*area.walk, strict=True), *area.bounds, strict=False):
            assert first + 0.29 < low < high < last - 0.29, "the bounds leave room around the area where it lies"
