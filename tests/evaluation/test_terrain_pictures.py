import math
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from splatrl.evaluation.terrain_pictures import _open_side, _seen, draw_terrain
from splatrl.physics.ground import Ground
from splatrl.physics.survey import Surveyed
from splatrl.physics.terrain import Terrain
from tests.tiny import tiny_gaussians

LOWER, UPPER = (-1, -1), (1, 1)


def surveyed(*boxes: tuple[float, ...]) -> Surveyed:
    plane = np.array([0.0, 0.0, 1.0, 0.0])
    rows = torch.tensor(boxes, dtype=torch.float64).reshape(-1, 6)
    return Surveyed(Ground(plane, 0.0, 100, 1.0, (0.0, 0.0), 0.0), Terrain(torch.from_numpy(plane), rows))


def test_boxes_are_drawn_at_their_positions(tmp_path: Path) -> None:
    middles = []
    for x in (-0.6, 0.6):
        path = tmp_path / "ground.png"
        draw_terrain(tiny_gaussians(), surveyed((x, 0.0, 0.2, 0.2, 0.5, 0.2)), LOWER, UPPER, path)
        image = np.asarray(Image.open(path).convert("RGB")).astype(int)
        tall = (image[..., 0] > 220) & (image[..., 1] > 220) & (image[..., 2] < 80)  # colour of the highest top face
        columns = np.flatnonzero(tall[:, : image.shape[1] * 2 // 5].any(0))  # in the map from above
        assert len(columns)
        middles.append(columns.mean())
    assert middles[0] < middles[1] - 50


@pytest.mark.parametrize("half", [(1.0, 1.0), (6.0, 0.5), (0.5, 4.0)])
def test_nothing_is_cut_off_at_the_edges_of_the_picture(tmp_path: Path, half: tuple[float, float]) -> None:
    path, (x, y) = tmp_path / "ground.png", half
    draw_terrain(tiny_gaussians(), surveyed(), (-x, -y), (x, y), path)
    image = np.asarray(Image.open(path).convert("RGB"))
    assert (np.concatenate([image[0], image[-1], image[:, 0], image[:, -1]]) == 255).all()


def test_view_dependent_colours_which_take_most_of_the_memory_are_not_drawn(tmp_path: Path) -> None:
    plain = tiny_gaussians()
    plain = plain.replace(sh=plain.sh[:, :1])
    glossy = plain.replace(sh=torch.cat([plain.sh, torch.full((len(plain), 15, 3), 0.2)], 1))
    for name, gaussians in (("plain", plain), ("glossy", glossy)):
        draw_terrain(gaussians, surveyed(), LOWER, UPPER, tmp_path / f"{name}.png")
    assert (tmp_path / "plain.png").read_bytes() == (tmp_path / "glossy.png").read_bytes()


def test_the_view_is_from_the_side_without_boxes() -> None:
    boxes = surveyed((0.0, -1.0, 0.2, 0.5, 0.1, 0.2)).terrain.boxes.numpy()
    assert _open_side(boxes, np.zeros(2)) == pytest.approx(math.pi / 2)
    assert math.isfinite(_open_side(np.zeros((0, 6)), np.zeros(2)))


def test_lines_behind_the_camera_are_left_out() -> None:
    lines = np.array([[[0.0, 0.0, 1.0], [1.0, 0.0, 2.0]], [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]])
    K = torch.tensor([[10.0, 0.0, 5.0], [0.0, 10.0, 4.0], [0.0, 0.0, 1.0]])
    seen = _seen(lines, torch.eye(4), K)
    assert len(seen) == 1
    np.testing.assert_allclose(seen[0], [[5.0, 4.0], [10.0, 4.0]])
