import numpy as np
import pytest
from PIL import Image

from splatrl.collision import Occupancy
from splatrl.collision.pictures import draw_blocks, draw_maps


def shapes() -> Occupancy:
    """Make a 3 × 2 m floor with a low block, a high block and a shelf above the body."""
    lower = [[0.0, 0.0, -0.1], [0.5, 0.5, 0.0], [2.0, 1.0, 0.0], [1.2, 0.0, 0.9]]
    upper = [[3.0, 2.0, 0.0], [1.0, 1.0, 0.2], [2.5, 1.5, 1.4], [1.7, 0.5, 1.0]]
    return Occupancy.from_boxes(lower, upper, 0.1)


def colors(path) -> set[tuple[int, ...]]:
    image = Image.open(path).convert("RGB")
    return {color for _, color in image.getcolors(image.width * image.height)}


@pytest.mark.parametrize("occupancy", [shapes(), Occupancy.empty(0.1)], ids=["shapes", "nothing"])
def test_both_pictures_are_written_as_png_files_and_nothing_else_is_left(tmp_path, occupancy):
    draw_maps(occupancy, tmp_path / "maps.png", 0.3, 0.6)
    draw_blocks(occupancy, tmp_path / "blocks.png")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["blocks.png", "maps.png"]
    for path in tmp_path.iterdir():
        assert Image.open(path).format == "PNG"


def test_the_map_shows_what_is_solid_at_the_height_of_the_body(tmp_path):
    path = tmp_path / "maps.png"

    def solid_pixels(low: float, high: float) -> int:
        draw_maps(shapes(), path, low, high)
        pixels = np.asarray(Image.open(path).convert("RGB")).astype(int)
        return int((np.abs(pixels - (0x3B, 0x42, 0x52)).sum(2) < 6).sum())

    low, middle, shelf = solid_pixels(0.0, 0.2), solid_pixels(0.3, 0.6), solid_pixels(0.9, 1.0)
    assert middle > 500
    assert low == pytest.approx(2 * middle, rel=0.1)  # two blocks of the same size
    assert shelf == pytest.approx(2 * middle, rel=0.1)


def test_a_body_without_height_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"low: expected a height below high \(0.5 m\), got 0.5 m"):
        draw_maps(shapes(), tmp_path / "maps.png", 0.5, 0.5)


def test_a_wall_hides_what_is_behind_it_until_the_view_is_turned(tmp_path):
    wall = Occupancy.from_boxes([[0.0, 0.0, 0.0]], [[0.1, 3.0, 2.0]], 0.1)
    both = wall | Occupancy.from_boxes([[0.3, 0.9, 0.0]], [[0.5, 1.3, 0.3]], 0.1)
    floor = Occupancy.from_boxes([[0.0, 0.0, 0.0]], [[3.0, 3.0, 0.1]], 0.1)
    images = []
    for turns in (0, 2):
        for name, occupancy in (("wall", wall | floor), ("both", both | floor)):
            draw_blocks(occupancy, tmp_path / f"{name}.png", quarter_turns=turns)
            images.append(np.asarray(Image.open(tmp_path / f"{name}.png")))
    assert np.array_equal(images[0], images[1])
    assert not np.array_equal(images[2], images[3])


def test_cutting_a_scene_open_removes_what_is_above_the_cut(tmp_path):
    draw_blocks(shapes(), tmp_path / "whole.png")
    draw_blocks(shapes(), tmp_path / "cut.png", below=0.5)
    low = shapes().carved([[-1, -1, 0.5]], [[9, 9, 9]])
    draw_blocks(low.trimmed(), tmp_path / "low.png")
    cut = np.asarray(Image.open(tmp_path / "cut.png"))
    assert not np.array_equal(cut, np.asarray(Image.open(tmp_path / "whole.png")))
    assert np.array_equal(cut, np.asarray(Image.open(tmp_path / "low.png")))


def test_faces_are_shaded_by_their_direction(tmp_path):
    draw_blocks(Occupancy.from_boxes([[0, 0, 0]], [[0.1, 0.1, 0.1]], 0.1), tmp_path / "cube.png")
    drawn = colors(tmp_path / "cube.png")
    assert len([color for color in drawn if sum(color) < 400]) >= 3
