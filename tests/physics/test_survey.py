"""The terrain of whole scenes: cached, and with a warning if the ground is not a plane."""

import warnings
from pathlib import Path

import numpy as np
import pytest
import torch

from splatrl.collision import Occupancy
from splatrl.physics import survey as module
from splatrl.physics.survey import survey_terrain
from splatrl.scenes import Scene
from tests.tiny import BLOCK, tiny_gaussians

LOWER, UPPER = (-1.0, -1.5), (1.0, 1.5)


@pytest.fixture
def room() -> Scene:
    return Scene("room", tiny_gaussians(), ((-1.5, -2.0, 0.0), (1.5, 2.0, 1.2)))


def test_the_tiny_room_is_a_floor_and_a_block(room: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SPLATRL_CACHE", str(tmp_path))
    occupancy = Occupancy.from_gaussians(room.gaussians)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = survey_terrain(room, occupancy, LOWER, UPPER, reach=0.1, top=0.6)
    terrain = found.terrain
    assert terrain.plane.tolist() == found.ground.plane.tolist()
    assert terrain.height(torch.zeros(1, 2, dtype=torch.float64)).item() == pytest.approx(0.0, abs=0.02)
    low, high = (
        (terrain.boxes[:, :3] - terrain.boxes[:, 3:]).numpy(),
        (terrain.boxes[:, :3] + terrain.boxes[:, 3:]).numpy(),
    )
    np.testing.assert_allclose(low.min(0)[:2], -BLOCK, atol=0.11)  # the walls are farther than bodies reach
    np.testing.assert_allclose(high.max(0)[:2], BLOCK, atol=0.11)
    assert high.max() == pytest.approx(0.6 + 0.05, abs=0.051)

    monkeypatch.setattr(module, "fit_ground", None)  # a second survey reads the cache
    again = survey_terrain(room, occupancy, LOWER, UPPER, reach=0.1, top=0.6)
    assert torch.equal(again.terrain.boxes, terrain.boxes) and torch.equal(again.terrain.plane, terrain.plane)
    assert str(again.ground) == str(found.ground)
    monkeypatch.setattr(module, "merged_boxes", None)
    with pytest.raises(TypeError):  # another body needs other boxes
        survey_terrain(room, occupancy, LOWER, UPPER, reach=0.1, top=0.7)


def test_a_ground_that_is_not_a_plane_gives_a_warning(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SPLATRL_CACHE", str(tmp_path))
    gaussians = tiny_gaussians()
    gaussians.means[:, 2] += 0.2 * (2 * gaussians.means[:, 1]).sin()
    hills = Scene("hills", gaussians, ((-1.5, -2.0, -0.2), (1.5, 2.0, 1.2)))
    with pytest.warns(UserWarning, match="hills: the ground is not one plane"):
        survey_terrain(hills, Occupancy.from_gaussians(gaussians), LOWER, UPPER, reach=0.1, top=0.6)


def test_a_negative_reach_is_refused(room: Scene) -> None:
    with pytest.raises(ValueError, match=r"reach: expected a non-negative number of metres, got -0\.1"):
        survey_terrain(room, Occupancy.empty(0.05), LOWER, UPPER, reach=-0.1, top=0.6)
