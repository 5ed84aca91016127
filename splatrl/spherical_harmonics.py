"""Real spherical harmonics as 3D Gaussian Splatting uses them: evaluation and rotation.

Coefficients are [..., (degree + 1)², 3], degree 0 to 3, in the order and with the signs of the 3DGS reference code
(Kerbl et al. 2023, after Sloan's "Efficient Spherical Harmonic Evaluation").
"""

import math

import torch
from torch import Tensor

C0 = 0.28209479177387814


def sh_degree(coefficients: int) -> int:
    """Return the degree that has this many coefficients; ValueError for counts other than 1, 4, 9 and 16."""
    degree = math.isqrt(coefficients) - 1
    if degree not in (0, 1, 2, 3) or (degree + 1) ** 2 != coefficients:
        raise ValueError(f"sh: expected 1, 4, 9 or 16 coefficients per channel, got {coefficients}")
    return degree


def sh_basis(directions: Tensor, degree: int) -> Tensor:
    """Evaluate the basis functions in some directions.

    Args:
        directions: [..., 3] unit vectors.
        degree: 0 to 3.

    Returns:
        [..., (degree + 1)²].
    """
    x, y, z = directions.unbind(-1)
    basis = [torch.full_like(x, C0)]
    if degree >= 1:
        basis += [-0.4886025119029199 * y, 0.4886025119029199 * z, -0.4886025119029199 * x]
    if degree >= 2:
        basis += [
            1.0925484305920792 * x * y,
            -1.0925484305920792 * y * z,
            0.31539156525252005 * (2 * z * z - x * x - y * y),
            -1.0925484305920792 * x * z,
            0.5462742152960396 * (x * x - y * y),
        ]
    if degree >= 3:
        basis += [
            -0.5900435899266435 * y * (3 * x * x - y * y),
            2.890611442640554 * x * y * z,
            -0.4570457994644658 * y * (4 * z * z - x * x - y * y),
            0.3731763325901154 * z * (2 * z * z - 3 * x * x - 3 * y * y),
            -0.4570457994644658 * x * (4 * z * z - x * x - y * y),
            1.445305721320277 * z * (x * x - y * y),
            -0.5900435899266435 * x * (x * x - 3 * y * y),
        ]
    return torch.stack(basis, -1)


def sh_colors(sh: Tensor, directions: Tensor) -> Tensor:
    """Return the colour seen along a direction: SH + 0.5, clamped from below at 0.

    Args:
        sh: [..., (degree + 1)², 3].
        directions: [..., 3] unit vectors from the camera to the Gaussian.

    Returns:
        [..., 3].
    """
    basis = sh_basis(directions, sh_degree(sh.shape[-2]))
    return ((basis.unsqueeze(-1) * sh).sum(-2) + 0.5).clamp_min(0.0)


def rotate_sh(sh: Tensor, rotation: Tensor) -> Tensor:
    """Rotate the coefficients along with the scene, so that ``f'(R d) = f(d)``.

    Each band is closed under rotation, so its matrix follows exactly (to float64) from a least-squares fit between the
    basis before and after the rotation, evaluated in more directions than the band has functions.

    Args:
        sh: [N, (degree + 1)², 3].
        rotation: [3, 3].

    Returns:
        [N, (degree + 1)², 3], dtype and device of ``sh``.
    """
    degree = sh_degree(sh.shape[-2])
    i = torch.arange(64, dtype=torch.float64)
    z, phi = 1 - (2 * i + 1) / 64, i * math.pi * (3 - math.sqrt(5))  # a Fibonacci sphere
    directions = torch.stack([(1 - z * z).sqrt() * phi.cos(), (1 - z * z).sqrt() * phi.sin(), z], -1)
    before = sh_basis(directions, degree)
    after = sh_basis(directions @ rotation.double().cpu().T, degree)
    rotated = sh.clone()
    for band in range(1, degree + 1):
        rows = slice(band * band, (band + 1) ** 2)
        matrix = torch.linalg.lstsq(after[:, rows], before[:, rows]).solution.to(sh)
        rotated[:, rows] = torch.einsum("ij,njc->nic", matrix, sh[:, rows])
    return rotated
