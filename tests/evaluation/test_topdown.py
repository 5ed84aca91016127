"""The top-down picture shows the floor of the window, accurate to the pixel."""

import pytest
import torch

from splatrl.collision.occupancy import Occupancy
from splatrl.evaluation.topdown import WIDEST, TopDown, footprint, map_window, top_down
from splatrl.renderers import ReferenceRenderer
from splatrl.scenes.gaussians import Gaussians
from splatrl.spherical_harmonics import C0

LOWER, UPPER = (-1.0, 2.0), (2.0, 4.0)  # 3 m × 2 m, off the origin


def blobs(rows: list[tuple[tuple[float, float, float], float, tuple[float, float, float]]]) -> Gaussians:
    """Return opaque round Gaussians, each given by its mean, scale and colour."""
    means, scales, colors = (torch.tensor(column) for column in zip(*rows, strict=True))
    return Gaussians(
        means=means,
        quats=torch.tensor([1.0, 0.0, 0.0, 0.0]).repeat(len(rows), 1),
        scales=scales[:, None].repeat(1, 3),
        opacities=torch.full((len(rows),), 0.99),
        sh=((colors - 0.5) / C0)[:, None],
        batch_size=[len(rows)],
    )


RED, GREEN, BLUE = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)


def test_a_gaussian_appears_at_the_pixel_of_its_x_and_y() -> None:
    # 0.02 m per pixel: x = 1.41 is the centre of column 120, y = 3.37 of row 31
    image, extent = top_down(blobs([((1.41, 3.37, 0.2), 0.008, RED)]), LOWER, UPPER, below=1.0, size=150)
    assert image.shape == (100, 150, 3) and image.dtype == torch.uint8
    assert extent == pytest.approx((-1.0, 2.0, 2.0, 4.0))
    row, column = divmod(int(image[..., 0].argmax()), 150)
    assert (row, column) == (31, 120)
    halo = image[row - 1 : row + 2, column - 1 : column + 2, 0].float()
    assert torch.allclose(halo, halo.flip(0), atol=3.0) and torch.allclose(halo, halo.flip(1), atol=3.0)


def test_height_does_not_move_a_point_near_the_edge_by_half_a_pixel() -> None:
    for z in (-2.0, 0.0, 0.9):
        image, _ = top_down(blobs([((1.97, 2.05, z), 0.008, RED)]), LOWER, UPPER, below=1.0, size=150)
        assert divmod(int(image[..., 0].argmax()), 150) == (97, 148)


def test_the_higher_of_two_gaussians_hides_the_lower() -> None:
    scene = blobs([((0.05, 2.95, 0.501), 0.3, GREEN), ((0.05, 2.95, 0.5), 0.3, RED)])
    image, _ = top_down(scene, LOWER, UPPER, below=1.0, size=30)
    assert image[10, 10, 1] > 200 and image[10, 10, 0] < 30


def test_gaussians_above_the_cut_are_not_shown() -> None:
    scene = blobs([((0.5, 3.0, 0.0), 0.3, GREEN), ((0.5, 3.0, 1.5), 0.3, RED)])
    image, _ = top_down(scene, LOWER, UPPER, below=1.0, size=30)
    assert image[..., 0].max() == 0 and image[10, 15, 1] > 200


@pytest.mark.parametrize(
    ("mean", "scale"),
    [((30.0, 3.0, 0.5), 10.0), ((6.5, 3.0, 0.5), 2.9), ((0.5, 3.0, -20.0), 2.0), ((0.5, 3.0, 0.9), 8.0)],
)
def test_a_sky_dome_does_not_cover_the_floor(mean: tuple[float, float, float], scale: float) -> None:
    scene = blobs([((0.5, 3.0, 0.0), 0.3, GREEN), (mean, scale, BLUE)])
    image, _ = top_down(scene, LOWER, UPPER, below=1.0, size=30)
    assert image[..., 2].max() == 0 and image[10, 15, 1] > 200


def test_a_window_grows_about_its_centre_to_a_whole_number_of_pixels() -> None:
    shape = top_down(blobs([((0.5, 0.5, 0.0), 0.3, GREEN)]), (0.0, 0.0), (1.0, 0.61), below=1.0, size=10)
    assert shape.image.shape == (7, 10, 3)
    assert shape.extent == pytest.approx((0.0, 1.0, -0.045, 0.655))
    assert shape.pixels_per_metre == pytest.approx(10.0)


def test_the_renderer_can_be_chosen() -> None:
    def paper(gaussians: Gaussians) -> ReferenceRenderer:
        return ReferenceRenderer(gaussians, background=(1.0, 1.0, 1.0))

    image, _ = top_down(blobs([((0.5, 3.0, 0.0), 0.1, GREEN)]), LOWER, UPPER, 1.0, 30, paper)
    assert image[0, 0].tolist() == [255, 255, 255]


def test_a_window_without_area_is_refused_and_one_without_content_is_empty() -> None:
    scene = blobs([((0.5, 3.0, 0.0), 0.3, GREEN)])
    with pytest.raises(ValueError, match="lower < upper"):
        top_down(scene, (1.0, 0.0), (1.0, 2.0), below=1.0)
    image, _ = top_down(scene, LOWER, UPPER, below=-3.0, size=30)
    assert image.shape == (20, 30, 3) and not image.any()


EXTENT = (-1.0, 2.0, 2.0, 4.0)
GROUND = TopDown(torch.zeros(20, 30, 3, dtype=torch.uint8), EXTENT)  # 0.1 m per pixel


def test_a_footprint_covers_the_pixels_of_its_voxels_and_no_others() -> None:
    occupancy = Occupancy.from_keys([[0, 5, 1], [3, 4, 1], [2, 4, 3], [2, 4, -1]], 0.5)
    solid = footprint(occupancy, low=0.3, high=1.2, ground=GROUND)
    expected = torch.zeros(20, 30, dtype=torch.bool)
    expected[10:15, 10:15] = True  # x 0 to 0.5, y 2.5 to 3
    expected[15:20, 25:30] = True  # x 1.5 to 2, y 2 to 2.5
    assert torch.equal(solid, expected)


def test_a_voxel_that_is_partly_within_the_height_range_counts() -> None:
    occupancy = Occupancy.from_keys([[0, 5, 1]], 0.5)  # from 0.5 m to 1 m
    for low, high, counts in ((0.9, 2.0, True), (1.0, 2.0, False), (-1.0, 0.6, True), (-1.0, 0.5, False)):
        assert footprint(occupancy, low, high, GROUND).any() == counts


def test_the_footprint_of_an_empty_grid_is_empty() -> None:
    assert not footprint(Occupancy.empty(), 0.0, 1.0, GROUND).any()


def yard(half: float, walls: float = 1.0) -> Gaussians:
    """Return a square floor with walls at y = ± ``half``, under a ceiling that reaches farther in x."""
    steps = torch.linspace(-half, half, 41).tolist()
    floor = [((x, y, 0.0), 0.05, GREEN) for x in steps for y in steps]
    sides = [((x, s * half, z), 0.05, RED) for x in steps for s in (-1, 1) for z in (0.3, walls)]
    ceiling = [((4.0 * x, y, 3.0), 0.05, BLUE) for x in steps for y in steps]
    return blobs(floor + sides + ceiling)


def test_a_map_of_a_large_place_has_a_margin_and_an_overview_up_to_the_walls() -> None:
    (low, high), wide = map_window(yard(20.0), (-3.0, -3.0), (5.0, 3.0), below=1.5)
    assert low == pytest.approx([-5.0, -5.0]) and high == pytest.approx([7.0, 5.0])  # a margin of a quarter of 8 m
    assert wide is not None
    for corner, edge in zip(wide, (-20.4, 20.4), strict=True):
        assert corner == pytest.approx([edge, edge], abs=0.5)


def test_a_map_of_a_room_ends_at_its_walls_and_has_no_overview() -> None:
    (low, high), wide = map_window(yard(4.0), (-3.0, -3.0), (3.9, 3.0), below=1.5)
    assert low == pytest.approx([-4.0, -4.0], abs=0.1) and high == pytest.approx([4.3, 4.0], abs=0.1)
    assert wide is None


@pytest.mark.parametrize("along", [0, 1])
def test_a_map_of_a_corridor_shows_what_is_beside_it(along: int) -> None:
    floor = [torch.linspace(-5, 5, 41), torch.linspace(-0.3, 0.7, 5)]
    places = torch.cartesian_prod(*floor).roll(along, 1).tolist()
    poses = torch.tensor([[-4.0, 0.0], [4.0, 0.4]]).roll(along, 1).tolist()
    (low, high), _ = map_window(blobs([((x, y, 0.0), 0.05, GREEN) for x, y in places]), *poses, below=1.5)
    size = [b - a for a, b in zip(low, high, strict=True)]
    assert size[along] == pytest.approx(10.0, abs=0.3) and size[1 - along] == pytest.approx(size[along] / 3.0)
    assert low[1 - along] + high[1 - along] == pytest.approx(0.4, abs=0.1)


def test_the_width_of_an_overview_is_limited_to_a_multiple_of_the_map() -> None:
    (low, high), wide = map_window(yard(1000.0), (-1.0, -1.0), (1.0, 1.0), below=1.5)
    assert wide is not None
    assert wide[1][0] - wide[0][0] == pytest.approx(WIDEST * (high[0] - low[0]))
