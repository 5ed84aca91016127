"""Goals and objects that are suggested for a closed room lie in it, however the room is turned in its file."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from splatrl.capture.area import Area
from splatrl.capture.suggestions import seen_in_splat, suggest
from splatrl.capture.walkable import walkable_area
from splatrl.evaluation.scene_pictures import survey_occupancy
from splatrl.scenes import Scene
from splatrl.scenes.frame import similarity
from splatrl.scenes.scene import captured_bounds
from tests.scenes.test_survey import BOXES, CEILING, FLOOR, WALLS, surfaces

YAW = np.radians(33.0)
TURN = np.array([[np.cos(YAW), -np.sin(YAW)], [np.sin(YAW), np.cos(YAW)]])
BACK = (0.0, 4.0, 0.0, 6.0, 4.0, 2.5)


def turned_room(height: float) -> tuple[Scene, Area]:
    """Return a closed room of 6 × 4 m that is turned by 33°, and where robots of some height walk in it."""
    gaussians = surfaces([FLOOR, *BOXES, *WALLS, BACK, CEILING])
    gaussians.sh = torch.sin(3.0 * gaussians.means).unsqueeze(1)
    rows = np.eye(4)
    rows[:2, :2] = TURN
    gaussians = gaussians.transformed(similarity(matrix=rows.tolist()))
    scene = Scene("room", gaussians, captured_bounds(gaussians))
    area = walkable_area(scene, survey_occupancy(scene), 0.0, height)
    assert area is not None
    return scene, area


def suggested(scene: Scene, area: Area) -> NDArray[np.float64]:
    """Return the suggested goals and the object in the room's own frame: [N, 2]."""
    found = suggest(seen_in_splat(scene.gaussians), area)
    assert found.thing is not None and found.goals
    return np.array([goal[:2] for goal in found.goals] + [found.thing[:2]]) @ TURN


@pytest.mark.parametrize("height", [0.2, 0.4])
def test_goals_and_object_lie_in_a_closed_room_that_is_turned_in_its_file(height: float) -> None:
    places = suggested(*turned_room(height))
    assert (places > 0.0).all() and (places < [6.0, 4.0]).all()


def test_an_object_has_room_beside_it_where_cameras_were_low() -> None:
    scene, area = turned_room(0.2)
    left, front, _, right, back, _ = BOXES[0]
    middle = TURN @ [0.5 * (left + right), 0.5 * (front + back)]
    around = (middle - 1.0).tolist(), (middle + 1.0).tolist()
    x, y = suggested(scene, replace(area, floor=None, walk=around))[-1]
    assert max(left - x, x - right, front - y, y - back) > 0.4
