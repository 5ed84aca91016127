"""Gaussians for the browser: the most important ones are sent first, so that a picture appears before all arrive."""

import itertools
import threading
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from splatrl.geometry import quats_to_rotations
from splatrl.scenes.gaussians import Gaussians
from splatrl.spherical_harmonics import C0, sh_colors

if TYPE_CHECKING:
    import viser

FIRST = 2**15
"""Number of Gaussians in the first part, 1 MB; each further part holds twice as many as the one before."""
BYTES = 32
"""Bytes per Gaussian, as viser sends it."""
ARRIVES, SLOW = 60.0, 1.0
"""Seconds to wait for the browser to render a part, and the longest a render may take for more parts to be sent."""
WIDER = 8
"""Pixels by which the renders of parts are wider than the page. viser 1.1.1 projects splats as if depth were not
reversed, so that they hide everything in front of them, until it is asked for a render of another shape."""
LARGEST = 6e4
"""Largest variance that fits in half precision, square metres."""


@dataclass(frozen=True)
class Part:
    """A part of a scene's Gaussians, in the form that viser takes.

    Attributes:
        centers: [N, 3] float32, world, metres.
        covariances: [N, 3, 3] float16, square metres.
        colors: [N, 3] uint8, independent of the view direction.
        opacities: [N, 1] uint8.
    """

    centers: NDArray[np.float32]
    covariances: NDArray[np.float16]
    colors: NDArray[np.uint8]
    opacities: NDArray[np.uint8]


def parts_of(gaussians: Gaussians, eyes: Tensor | None = None, first: int = FIRST) -> list[Part]:
    """Split Gaussians into parts by importance, which is opacity times the largest area they can cover.

    The browser draws each Gaussian in one colour from all sides. For spherical harmonics above degree 0 this is the
    mean of the colours seen from ``eyes``, which is closer to what is seen from there than degree 0 alone.

    Args:
        gaussians: Gaussians in the world frame.
        eyes: [E, 3] viewpoints, metres; None takes degree 0 alone.
        first: number of Gaussians in the first part.
    """
    g = gaussians.detach().cpu()
    area = g.scales.prod(1) / g.scales.amin(1)
    order = (g.opacities * area).argsort(descending=True, stable=True)
    rotations = quats_to_rotations(g.quats) * g.scales.unsqueeze(1)
    covariances = rotations @ rotations.mT
    widest = covariances.diagonal(dim1=1, dim2=2).amax(1)
    covariances *= (LARGEST / widest).clamp(max=1)[:, None, None]  # smaller, but of the same shape
    colors = (255 * _colors(g, eyes).clamp(0, 1)).round().to(torch.uint8)
    opacities = (255 * g.opacities.unsqueeze(1)).round().to(torch.uint8)
    ends = [min(first * (2**number - 1), len(g)) for number in range(1, 64)]
    spans = [(start, end) for start, end in zip([0, *ends], ends, strict=False) if start < end]
    rows = [order[start:end] for start, end in spans]
    return [
        Part(g.means[row].numpy(), covariances[row].half().numpy(), colors[row].numpy(), opacities[row].numpy())
        for row in rows
    ]


def _colors(g: Gaussians, eyes: Tensor | None) -> Tensor:
    """Return the mean colour of Gaussians as seen from some viewpoints: [N, 3], in [0, 1] unless out of gamut."""
    if eyes is None or g.sh.shape[1] == 1:
        return 0.5 + C0 * g.sh[:, 0]
    seen = [sh_colors(g.sh, torch.nn.functional.normalize(g.means - eye, dim=1)) for eye in eyes]
    return torch.stack(seen).mean(0)


class Splats:
    """The splats of a page, sent part by part to every browser that opens it.

    Unless a number of parts is requested, a browser gets more as long as it renders what it has within ``SLOW``.

    Args:
        server: server of the page.
        parts: parts of the scene's Gaussians.

    Attributes:
        root: parent node of all parts.
    """

    def __init__(self, server: "viser.ViserServer", parts: list[Part]):
        self._parts, self._server = parts, server
        self._wanted: int | None = None
        self.root = server.scene.add_frame("/splats", show_axes=False)
        self._shown: dict[int, list[viser.GaussianSplatHandle]] = {}
        self._turns: dict[int, threading.Lock] = {}

        @server.on_client_connect
        def come(client: "viser.ClientHandle") -> None:
            self._shown[client.client_id], self._turns[client.client_id] = [], threading.Lock()
            self._bring(client)

        @server.on_client_disconnect
        def leave(client: "viser.ClientHandle") -> None:
            self._shown.pop(client.client_id, None)
            self._turns.pop(client.client_id, None)

    @property
    def counts(self) -> list[int]:
        """Number of Gaussians shown with one part, with two, and so on."""
        return list(itertools.accumulate(len(part.centers) for part in self._parts))

    def show(self, wanted: int | None) -> None:
        """Show a number of parts to everyone; None shows each browser as many as it renders quickly."""
        self._wanted = wanted
        for client in self._server.get_clients().values():
            self._bring(client)

    def _bring(self, client: "viser.ClientHandle") -> None:
        """Send a client the parts that it lacks, and remove those that are too many."""
        shown, turn = self._shown.get(client.client_id), self._turns.get(client.client_id)
        if shown is None or turn is None:
            return
        with turn:
            while self._wanted is not None and len(shown) > self._wanted:
                shown.pop().remove()
            while len(shown) < (self._wanted or len(self._parts)):
                part = self._parts[len(shown)]
                name = f"/splats/{len(shown)}"
                shown.append(
                    client.scene.add_gaussian_splats(name, part.centers, part.covariances, part.colors, part.opacities)
                )
                client.flush()
                if self._wanted is None and not _is_quick(client):
                    return


def _is_quick(client: "viser.ClientHandle") -> bool:
    """Whether a browser is still connected and renders what it was sent within ``SLOW``."""
    height, width = client.camera.image_height, client.camera.image_width + WIDER
    try:
        client.get_render(height, width, timeout=ARRIVES)  # the first render waits until all has arrived
        began = time.monotonic()
        client.get_render(height, width, timeout=ARRIVES)
    except (RuntimeError, TimeoutError):  # disconnected, or no answer
        return False
    return time.monotonic() - began < SLOW
