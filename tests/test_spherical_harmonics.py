import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from splatrl.geometry import quats_to_rotations
from splatrl.spherical_harmonics import C0, rotate_sh, sh_basis, sh_colors, sh_degree


def sphere(count: int) -> Tensor:
    """Return evenly spread unit vectors, [count, 3] float64."""
    i = torch.arange(count, dtype=torch.float64)
    z, phi = 1 - (2 * i + 1) / count, i * math.pi * (3 - math.sqrt(5))
    return torch.stack([(1 - z * z).sqrt() * phi.cos(), (1 - z * z).sqrt() * phi.sin(), z], -1)


def test_the_basis_is_orthonormal_on_the_sphere() -> None:
    basis = sh_basis(sphere(20_000), 3)
    gram = 4 * math.pi * basis.T @ basis / len(basis)
    torch.testing.assert_close(gram, torch.eye(16, dtype=torch.float64), atol=1e-3, rtol=0)


def test_the_basis_of_a_lower_degree_is_the_beginning_of_that_of_a_higher_one() -> None:
    directions = sphere(50)
    full = sh_basis(directions, 3)
    for degree in range(3):
        assert torch.equal(sh_basis(directions, degree), full[:, : (degree + 1) ** 2])


@pytest.mark.parametrize(
    ("axis", "index", "sign"), [([0.0, 1.0, 0.0], 1, -1), ([0.0, 0.0, 1.0], 2, 1), ([1.0, 0.0, 0.0], 3, -1)]
)
def test_degree_one_has_the_signs_of_3dgs(axis: list[float], index: int, sign: int) -> None:
    values = sh_basis(torch.tensor(axis), 1)
    assert values[index].item() == pytest.approx(sign * math.sqrt(3 / (4 * math.pi)), rel=1e-6)


def test_without_harmonics_above_the_first_a_colour_is_the_same_from_everywhere() -> None:
    sh = torch.zeros(1, 9, 3, dtype=torch.float64)
    sh[0, 0] = (torch.tensor([0.2, 0.5, 0.9], dtype=torch.float64) - 0.5) / C0
    colors = sh_colors(sh, sphere(7))
    torch.testing.assert_close(colors, torch.tensor([0.2, 0.5, 0.9], dtype=torch.float64).expand(7, 3))


def test_colours_are_clamped_only_from_below() -> None:
    sh = torch.tensor([[[-10.0, 0.0, 10.0]]])
    red, green, blue = sh_colors(sh, torch.tensor([[0.0, 0.0, 1.0]]))[0].tolist()
    assert red == 0 and green == 0.5 and blue > 1


@given(seed=st.integers(0, 2**31), degree=st.integers(0, 3))
def test_rotated_harmonics_have_the_same_values_in_rotated_directions(seed: int, degree: int) -> None:
    g = torch.Generator().manual_seed(seed)
    sh = torch.randn(5, (degree + 1) ** 2, 3, generator=g, dtype=torch.float64)
    rotation = quats_to_rotations(torch.randn(4, generator=g, dtype=torch.float64))
    directions = sphere(11)
    before = torch.einsum("dk,nkc->ndc", sh_basis(directions, degree), sh)
    after = torch.einsum("dk,nkc->ndc", sh_basis(directions @ rotation.T, degree), rotate_sh(sh, rotation))
    torch.testing.assert_close(after, before, atol=1e-9, rtol=0)


@pytest.mark.parametrize("count", [0, 2, 3, 5, 15, 25])
def test_numbers_of_coefficients_that_no_degree_has_are_refused(count: int) -> None:
    with pytest.raises(ValueError, match=f"expected 1, 4, 9 or 16 coefficients per channel, got {count}"):
        sh_degree(count)
