from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from splatrl.evaluation.scene_pictures import draw_scene, survey_occupancy
from splatrl.scenes import Scene
from splatrl.scenes.scene import robust_bounds
from tests.scenes.test_survey import BOXES, FLOOR, surfaces


def scene(scale: float = 1.0, boxes: bool = True) -> Scene:
    """Return a floor, bare or with boxes on it, as in a file whose unit is 1 / ``scale`` metres."""
    gaussians = surfaces([FLOOR, *BOXES] if boxes else [FLOOR])
    gaussians = gaussians.transformed(torch.diag(torch.tensor([scale, scale, scale, 1.0])))
    return Scene("yard", gaussians, robust_bounds(gaussians))


@pytest.mark.parametrize("scale", [0.01, 1.0, 40.0])
def test_the_voxel_size_follows_the_unit_of_the_scene(scale: float) -> None:
    occupancy = survey_occupancy(scene(scale))
    diagonal = np.linalg.norm(np.subtract(*scene(scale).bounds))
    assert diagonal / 257 < occupancy.resolution < diagonal / 49
    assert occupancy.count > 500
    assert survey_occupancy(scene(scale), 0.1 * scale).resolution == pytest.approx(0.1 * scale)


def test_a_scene_without_extent_is_refused_with_its_name() -> None:
    lone = scene()
    point = Scene("dot", lone.gaussians, (lone.bounds[0], lone.bounds[0]))
    with pytest.raises(ValueError, match="dot: expected a scene with a spatial extent"):
        survey_occupancy(point)


@pytest.mark.parametrize(("scale", "boxes"), [(0.05, False), (1.0, True)], ids=["small and flat", "large with boxes"])
def test_each_of_the_three_pictures_shows_more_than_one_colour(scale: float, boxes: bool, tmp_path: Path) -> None:
    seen = scene(scale, boxes)
    files = draw_scene(seen, survey_occupancy(seen), 0.0, 0.4, tmp_path / "new")
    assert [file.name for file in files] == ["yard-free.png", "yard-occupancy.png", "yard-view.png"]
    assert sorted(files) == sorted((tmp_path / "new").iterdir())
    for file in files:
        assert len(np.unique(np.asarray(Image.open(file).convert("L")))) > 1
