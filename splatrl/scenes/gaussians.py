"""The Gaussians of a scene, with activated values."""

import warnings

import torch
from tensordict import TensorClass
from torch import Tensor

from splatrl.geometry import multiply_quats, quats_to_rotations, rotations_to_quats
from splatrl.spherical_harmonics import rotate_sh, sh_degree

GREY_LEVEL = 1.0 / 255.0
"""Minimum visible opacity in a classic image."""
INVISIBLE = GREY_LEVEL / 4
"""Minimum visible opacity in an exact antialiased image, so fainter Gaussians cannot change any image. Distant surfaces
consist of many Gaussians that are each fainter than a grey level: without them, tables vanish from small images."""
LARGEST = 1e15
"""Largest coordinate and scale of a usable Gaussian: their squares, times a squared focal length, fit float32."""
BLOCK = 1 << 16
"""Rows processed per batch: this bounds memory and lets Ctrl-C take effect between batches."""


class Gaussians(TensorClass):
    """N anisotropic Gaussians (Kerbl et al. 2023), with activated values where files store logs and logits.

    Attributes:
        means: [N, 3] float32, metres if in the world frame.
        quats: [N, 4] float32, wxyz, unit.
        scales: [N, 3] float32, standard deviations along the Gaussian's own axes, metres, above 0.
        opacities: [N] float32 in [0, 1].
        sh: [N, (degree + 1)², 3] float32, spherical harmonics, degree 0 to 3.
    """

    means: Tensor
    quats: Tensor
    scales: Tensor
    opacities: Tensor
    sh: Tensor

    @property
    def sh_degree(self) -> int:
        """Degree of the spherical harmonics, 0 to 3."""
        return sh_degree(self.sh.shape[-2])

    def covariances(self) -> Tensor:
        """Return the covariance of each Gaussian: [N, 3, 3], square metres."""
        axes = quats_to_rotations(self.quats) * self.scales.unsqueeze(-2)
        return axes @ axes.mT

    def transformed(self, transform: Tensor) -> "Gaussians":
        """Transform the Gaussians to another frame; their spherical harmonics rotate with them.

        Means of higher precision than the other values, as from a file with doubles, are rounded after the transform.

        Args:
            transform: [4, 4], a rotation, a uniform positive scale and a translation.

        Raises:
            ValueError: if the upper left 3×3 block is not a scaled rotation.
        """
        matrix = transform.double().cpu()
        scale = matrix[:3, :3].det().sign() * matrix[:3, :3].det().abs() ** (1 / 3)
        rotation = matrix[:3, :3] / scale
        if not (scale > 0 and torch.allclose(rotation @ rotation.T, torch.eye(3, dtype=torch.float64), atol=1e-4)):
            raise ValueError(f"transform: expected a rotation times a positive scale, got {matrix[:3, :3].tolist()}")
        turn = rotation.to(self.means)
        return Gaussians(
            means=(self.means @ (turn.T * scale.to(self.means)) + matrix[:3, 3].to(self.means)).to(self.scales.dtype),
            quats=multiply_quats(rotations_to_quats(rotation).to(self.quats), self.quats),
            scales=self.scales * scale.to(self.scales),
            opacities=self.opacities,
            sh=rotate_sh(self.sh, rotation),
            batch_size=self.batch_size,
        )


def checked_gaussians(
    source: str, means: Tensor, quats: Tensor, scales: Tensor, opacities: Tensor, sh: Tensor
) -> Gaussians:
    """Build Gaussians from external values: check shapes, normalise quaternions and drop unusable rows.

    Rows with a non-finite value, a zero quaternion, a scale that is not positive, a coordinate or scale beyond
    ``LARGEST`` or an opacity below ``INVISIBLE`` are left out, with one warning that counts them.

    Args:
        source: origin of the values, for error messages.
        means: [N, 3]; doubles stay doubles, so that they can be ``transformed`` before they are rounded.
        quats: [N, 4] wxyz, of any length.
        scales: [N, 3] metres.
        opacities: [N].
        sh: [N, K, 3].

    Raises:
        ValueError: for inconsistent shapes, a wrong number of harmonics, or if no row is usable.
    """
    count = means.shape[0]
    if not count:
        raise ValueError(f"{source}: expected at least one Gaussian, got none")
    expected = {"means": (count, 3), "quats": (count, 4), "scales": (count, 3), "opacities": (count,)}
    for (name, shape), value in zip(expected.items(), (means, quats, scales, opacities), strict=True):
        if value.shape != shape:
            raise ValueError(f"{source}: {name}: expected shape {list(shape)}, got {list(value.shape)}")
    if sh.ndim != 3 or sh.shape[0] != count or sh.shape[1] not in (1, 4, 9, 16) or sh.shape[2] != 3:
        raise ValueError(f"{source}: sh: expected shape [{count}, 1 or 4 or 9 or 16, 3], got {list(sh.shape)}")
    places, quats, scales, opacities, sh = (v.float() for v in (means, quats, scales, opacities, sh))
    means = means if means.dtype == torch.float64 else places
    limits = (LARGEST, torch.inf, LARGEST, torch.inf, torch.inf)
    checked = zip((places, quats, scales, opacities, sh), limits, strict=True)
    finite = torch.stack([_finite(v.reshape(count, -1), most) for v, most in checked]).all(0)
    norms = quats.double().norm(dim=1, keepdim=True)  # float64: squares neither underflow nor overflow
    finite &= (norms[:, 0] > 0) & (scales > 0).all(1)
    visible = opacities >= INVISIBLE * (1 - 1e-6)  # the logits of a PLY round
    keep = finite & visible
    if not keep.any():
        raise ValueError(
            f"{source}: expected at least one finite, visible Gaussian, got none among {count}: "
            f"{int((norms[:, 0] == 0).sum())} have a zero quaternion, {int((scales <= 0).any(1).sum())} a scale of 0 "
            f"or less, {int((~visible).sum())} are transparent"
        )
    if not keep.all():
        warnings.warn(
            f"{source}: dropped {int((~finite).sum())} non-finite or degenerate and "
            f"{int((finite & ~visible).sum())} fully transparent of {count} Gaussians",
            stacklevel=3,
        )
        means, quats, norms, scales, opacities, sh = (
            torch.cat([block[kept] for block, kept in zip(v.split(BLOCK), keep.split(BLOCK), strict=True)])
            for v in (means, quats, norms, scales, opacities, sh)
        )
    return Gaussians(
        means=means,
        quats=(quats / norms).float(),
        scales=scales,
        opacities=opacities.clamp(0.0, 1.0),
        sh=sh,
        batch_size=[means.shape[0]],
    )


def _finite(values: Tensor, most: float) -> Tensor:
    """Return a mask of the rows that hold only finite numbers of at most this magnitude: [N, D] -> [N] bool."""
    return torch.cat([(block.isfinite() & (block.abs() <= most)).all(1) for block in values.split(BLOCK)])
