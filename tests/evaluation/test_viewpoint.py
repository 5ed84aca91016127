import numpy as np
import pytest
import torch

from splatrl.collision import Occupancy
from splatrl.evaluation.viewpoint import eye_view, open_corner, standing_place
from splatrl.scenes import Gaussians

BOUNDS = ((0.0, 0.0, 0.0), (6.0, 4.0, 2.5))


def sky_and_ground() -> Gaussians:
    """A red sheet far overhead and a blue one on the ground."""
    x, y = torch.meshgrid(torch.linspace(-10, 16, 40), torch.linspace(-10, 14, 40), indexing="ij")
    layers = [torch.stack([x, y, torch.full_like(x, z)], -1).reshape(-1, 3) for z in (5.0, 0.0)]
    count = len(layers[0])
    colors = torch.tensor([[1.0, -1.0, -1.0], [-1.0, -1.0, 1.0]]).repeat_interleave(count, 0)
    return Gaussians(
        means=torch.cat(layers),
        quats=torch.tensor([1.0, 0.0, 0.0, 0.0]).expand(2 * count, 4).clone(),
        scales=torch.tensor([0.6, 0.6, 0.01]).expand(2 * count, 3).clone(),
        opacities=torch.full((2 * count,), 0.95),
        sh=1.7 * colors[:, None],
        batch_size=[2 * count],
    )


def test_the_view_has_the_ground_below_and_the_sky_above() -> None:
    image = eye_view(sky_and_ground(), Occupancy.empty(), BOUNDS, 0.0, 1.6, width=90, rows=60).double()
    assert image.shape == (60, 90, 3)
    assert image[:10, :, 0].mean() > 2 * image[:10, :, 2].mean()
    assert image[-10:, :, 2].mean() > 2 * image[-10:, :, 0].mean()


def test_the_standing_place_is_in_free_space_and_away_from_the_middle() -> None:
    solid = Occupancy.from_boxes([[0.0, 0.0, 0.0], [2.5, 1.5, 0.0]], [[2.0, 4.0, 2.5], [3.5, 2.5, 2.5]], 0.1)
    place = np.array(standing_place(solid, BOUNDS, 1.6))
    assert place[0] > 4.0
    assert not solid.contains([[*place.tolist(), 1.6]])[0]
    assert np.linalg.norm(place - [3.0, 2.0]) > 1.0


@pytest.mark.parametrize("corner", range(4))
def test_voxels_are_viewed_from_the_corner_that_hides_least(corner: int) -> None:
    corners = np.array([[0.0, 0.0], [0.0, 3.0], [5.0, 3.0], [5.0, 0.0]])
    towers = np.pad(np.delete(corners, corner, 0), ((0, 0), (0, 1)))
    lower = np.concatenate([np.zeros((1, 3)), towers])
    upper = np.concatenate([np.array([[6.0, 4.0, 0.1]]), towers + np.array([1.0, 1.0, 2.0])])
    solid = Occupancy.from_boxes(lower, upper, 0.1)
    assert open_corner(solid) == corner
