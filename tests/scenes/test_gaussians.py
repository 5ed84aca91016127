import math

import pytest
import torch

from splatrl.geometry import axis_rotations, quats_to_rotations, rigid
from splatrl.scenes.gaussians import checked_gaussians
from splatrl.spherical_harmonics import sh_colors
from tests.scenes.samples import assert_same, assert_valid, sample_gaussians

FIELDS = ("means", "quats", "scales", "opacities", "sh")


def fields(count: int = 5, degree: int = 1) -> dict[str, torch.Tensor]:
    gaussians = sample_gaussians(count, degree)
    return {name: getattr(gaussians, name).clone() for name in FIELDS}


def similarity_of_a_quarter_turn() -> torch.Tensor:
    transform = rigid(2.0 * axis_rotations(2, torch.tensor(math.pi / 2)), torch.tensor([1.0, 2.0, 3.0]))
    return transform.double()


def test_a_covariance_has_the_squared_scales_along_the_gaussians_own_axes() -> None:
    gaussians = sample_gaussians(4)
    axes = quats_to_rotations(gaussians.quats)
    along = axes.mT @ gaussians.covariances() @ axes
    torch.testing.assert_close(along, torch.diag_embed(gaussians.scales**2), atol=1e-6, rtol=1e-4)


def test_a_transform_moves_turns_and_scales_means_and_covariances() -> None:
    gaussians = sample_gaussians(6)
    moved = gaussians.transformed(similarity_of_a_quarter_turn())
    x, y, z = gaussians.means.unbind(1)
    torch.testing.assert_close(moved.means, torch.stack([1 - 2 * y, 2 + 2 * x, 3 + 2 * z], 1))
    turn = axis_rotations(2, torch.tensor(math.pi / 2))
    torch.testing.assert_close(moved.covariances(), 4 * turn @ gaussians.covariances() @ turn.T, atol=1e-6, rtol=1e-4)
    assert moved.batch_size == gaussians.batch_size


def test_a_transformed_gaussian_shows_the_same_colour_from_the_transformed_direction() -> None:
    gaussians = sample_gaussians(6, degree=3)
    moved = gaussians.transformed(similarity_of_a_quarter_turn())
    directions = torch.nn.functional.normalize(torch.randn(6, 3, generator=torch.Generator().manual_seed(1)), dim=1)
    turned = directions @ axis_rotations(2, torch.tensor(math.pi / 2)).T
    torch.testing.assert_close(sh_colors(moved.sh, turned), sh_colors(gaussians.sh, directions), atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize(
    "diagonal", [(1.0, 1.0, -1.0), (1.0, 1.0, 2.0), (0.0, 0.0, 0.0)], ids=["reflection", "stretch", "collapse"]
)
def test_a_transform_that_is_not_a_similarity_is_refused(diagonal: tuple[float, float, float]) -> None:
    with pytest.raises(ValueError, match="expected a rotation times a positive scale"):
        sample_gaussians().transformed(torch.diag(torch.tensor([*diagonal, 1.0])))


def test_checked_gaussians_have_unit_quaternions() -> None:
    values = fields()
    expected = sample_gaussians(5, 1)
    for factor in (1e-30, 3.0, 1e30):
        gaussians = checked_gaussians("here", **{**values, "quats": values["quats"] * factor})
        assert_valid(gaussians)
        assert_same(gaussians, expected)


@pytest.mark.parametrize(
    ("name", "row", "value"),
    [
        ("means", 0, math.nan),
        ("means", 0, -3e38),
        ("quats", 1, 0.0),
        ("scales", 2, 1.9e19),
        ("scales", 2, math.inf),
        ("scales", 2, 0.0),
        ("opacities", 3, math.nan),
        ("sh", 4, -math.inf),
    ],
)
def test_a_row_that_cannot_be_drawn_is_dropped_and_counted(name: str, row: int, value: float) -> None:
    values = fields()
    values[name][row] = value
    with pytest.warns(UserWarning, match="here: dropped 1 non-finite or degenerate and 0 fully transparent of 5"):
        gaussians = checked_gaussians("here", **values)
    assert_valid(gaussians)
    kept = [i for i in range(5) if i != row]
    torch.testing.assert_close(gaussians.means, values["means"][kept])


def test_transparent_rows_are_dropped_and_counted_separately() -> None:
    values = fields()
    values["opacities"][:2] = torch.tensor([0.0, 0.24 / 255])
    values["opacities"][2] = 0.26 / 255  # which exact antialiased images show
    values["means"][4] = math.nan
    with pytest.warns(UserWarning, match="dropped 1 non-finite or degenerate and 2 fully transparent of 5"):
        assert len(checked_gaussians("here", **values)) == 2


def test_no_gaussians_at_all_are_refused() -> None:
    nothing = {"means": torch.zeros(0, 3), "quats": torch.zeros(0, 4), "scales": torch.zeros(0, 3)}
    with pytest.raises(ValueError, match="empty: expected at least one Gaussian, got none"):
        checked_gaussians("empty", **nothing, opacities=torch.zeros(0), sh=torch.zeros(0, 1, 3))


def test_gaussians_that_are_all_transparent_are_refused() -> None:
    with pytest.raises(ValueError, match="here: expected at least one finite, visible Gaussian, got none among 5"):
        checked_gaussians("here", **{**fields(), "opacities": torch.zeros(5)})


@pytest.mark.parametrize(
    ("name", "shape"),
    [("means", (5, 2)), ("quats", (4, 4)), ("scales", (5,)), ("opacities", (5, 1)), ("sh", (5, 5, 3)), ("sh", (5, 4))],
)
def test_a_wrong_shape_is_refused_by_name(name: str, shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match=f"here: {name}: expected shape .* got \\[{shape[0]}"):
        checked_gaussians("here", **{**fields(), name: torch.ones(shape)})
