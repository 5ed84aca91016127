"""What is found in splats that come without cameras: where to walk, also where a place has surroundings and a sky."""

from pathlib import Path

import pytest
import torch

import splatrl
from splatrl.capture import inspection
from splatrl.capture.walkable import walkable_area
from splatrl.evaluation.scene_pictures import survey_occupancy
from splatrl.scenes import Gaussians, Scene
from splatrl.scenes.scene import captured_bounds, robust_bounds
from tests.scenes.test_survey import BOXES, FLOOR, WALLS, surfaces


def room(scale: float, sky: bool) -> Gaussians:
    """Return a room of 6 × 4 m times a scale, with or without a sky above it."""
    result = surfaces([FLOOR, *BOXES, *WALLS])
    result.sh = torch.sin(3.0 * result.means).unsqueeze(1)
    if sky:
        dome = torch.randn(200, 3, generator=torch.manual_seed(0))
        far = result[:200].clone()
        far.means = 400.0 * dome.abs() / dome.norm(dim=1, keepdim=True)
        far.scales = torch.full((200, 3), 3.0)
        result = torch.cat([result, far])
    result.means, result.scales = scale * result.means, scale * result.scales
    return result


def test_robots_walk_in_the_yard_and_not_in_the_meadow_around_it() -> None:
    yard = splatrl.yard(0)
    (left, front, _), (right, back, _) = yard.bounds
    lower, upper = captured_bounds(yard.gaussians)
    assert all(high - low < 2.5 * (b - a) for low, high, a, b in zip(lower, upper, *yard.bounds, strict=True))
    for bounds in (captured_bounds(yard.gaussians), robust_bounds(yard.gaussians)):
        scene = Scene("yard", yard.gaussians, bounds)
        area = walkable_area(scene, survey_occupancy(scene), 0.0, 0.4)
        assert area is not None
        (x0, y0), (x1, y1) = area.walk
        assert left - 0.3 < x0 and x1 < right + 0.3 and front - 0.3 < y0 and y1 < back + 0.3


def test_a_place_of_faint_gaussians_has_a_walkable_area() -> None:
    gaussians = room(1.0, sky=False)
    scene = Scene("room", gaussians, robust_bounds(gaussians))
    solid = survey_occupancy(scene)
    scene.gaussians.opacities = scene.gaussians.opacities.clamp(max=0.45)
    area = walkable_area(scene, solid, 0.0, 0.4)
    assert area is not None and area.walk[1][0] - area.walk[0][0] > 2.0


def test_a_place_without_surroundings_keeps_its_bounds() -> None:
    assert captured_bounds(room(1.0, sky=False)) == robust_bounds(room(1.0, sky=False))
    assert captured_bounds(room(1.0, sky=True))[1][2] < 4.0 < robust_bounds(room(1.0, sky=True))[1][2]


def test_a_sky_far_above_a_place_does_not_count_for_the_boxes_in_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("of_goals", "of_terrain"):
        monkeypatch.setattr(inspection.ScenePictures, name, lambda *_: [])
    monkeypatch.setattr("splatrl.capture.lattice.FEW", -1.0)  # says how much of the floor is out of reach at any rate
    gaussians = room(2.5, sky=True)
    everything, place = (Scene("room", gaussians, of(gaussians)) for of in (robust_bounds, captured_bounds))
    proposed = inspection.propose(everything, survey_occupancy(place), 0.0, 0.4, inspection.ScenePictures(tmp_path))
    assert any(line.startswith("boxes") for line in proposed.lines) and "goal" in proposed.settings
    assert proposed.lines[-1].strip().startswith("0 % of the free floor cannot be reached in steps of")
