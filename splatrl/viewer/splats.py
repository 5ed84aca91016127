"""Gaussians for the browser: the most important ones first, so that a picture is there before all have arrived."""

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch
from numpy.typing import NDArray

from splatrl.geometry import quats_to_rotations
from splatrl.scenes.gaussians import Gaussians
from splatrl.spherical_harmonics import C0

if TYPE_CHECKING:
    import viser

FIRST = 2**15
"""Gaussians of the first part, 1 MB; each part holds twice as many as the one before."""
BYTES = 32
"""Of a Gaussian, as viser sends it."""
PAUSE = 0.5
"""Seconds between parts, in which a browser draws what it has."""
LARGEST = 6e4
"""Covariance that half precision holds, square metres."""


@dataclass(frozen=True)
class Part:
    """Some of a scene's Gaussians, as viser takes them.

    Attributes:
        centers: [N, 3] float32, world, metres.
        covariances: [N, 3, 3] float16, square metres.
        colors: [N, 3] uint8, what is seen from all sides.
        opacities: [N, 1] uint8.
    """

    centers: NDArray[np.float32]
    covariances: NDArray[np.float16]
    colors: NDArray[np.uint8]
    opacities: NDArray[np.uint8]


def parts_of(gaussians: Gaussians, first: int = FIRST) -> list[Part]:
    """Split Gaussians into parts, the most important first: by opacity times the largest area that is seen of them.

    Spherical harmonics above degree 0, which change colours with the side, are left out.

    Args:
        gaussians: in the world frame.
        first: number of Gaussians of the first part.
    """
    g = gaussians.detach().cpu()
    area = g.scales.prod(1) / g.scales.amin(1)
    order = (g.opacities * area).argsort(descending=True, stable=True)
    rotations = quats_to_rotations(g.quats) * g.scales.unsqueeze(1)
    covariances = (rotations @ rotations.mT).clamp(-LARGEST, LARGEST)
    colors = (255 * (0.5 + C0 * g.sh[:, 0]).clamp(0, 1)).round().to(torch.uint8)
    opacities = (255 * g.opacities.unsqueeze(1)).round().to(torch.uint8)
    ends = [min(first * (2**number - 1), len(g)) for number in range(1, 64)]
    spans = [(start, end) for start, end in zip([0, *ends], ends, strict=False) if start < end]
    rows = [order[start:end] for start, end in spans]
    return [
        Part(g.means[row].numpy(), covariances[row].half().numpy(), colors[row].numpy(), opacities[row].numpy())
        for row in rows
    ]


def show_splats(server: "viser.ViserServer", parts: list[Part]) -> "viser.FrameHandle":
    """Send parts to everyone who opens the page, one after another; returns the node that they all hang on."""
    root = server.scene.add_frame("/splats", show_axes=False)

    @server.on_client_connect
    def send(client: "viser.ClientHandle") -> None:
        for number, part in enumerate(parts):
            if client.client_id not in server.get_clients():
                return
            client.scene.add_gaussian_splats(
                f"/splats/{number}", part.centers, part.covariances, part.colors, part.opacities
            )
            client.flush()
            if number + 1 < len(parts):
                time.sleep(PAUSE)

    return root
