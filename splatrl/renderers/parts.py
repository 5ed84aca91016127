"""Placed models: what each camera of a batch is shown, when that is more than one scene where it stands."""

from typing import NamedTuple

from torch import Tensor

from splatrl.cameras import Cameras
from splatrl.geometry import invert_rigid

ABSENT = -1
"""The model of a part that shows nothing: rows of a batch may have different numbers of parts."""


class Parts(NamedTuple):
    """For each row of a batch, up to M models of a renderer and where they stand.

    All parts of a row are drawn into one image: their Gaussians are sorted by depth and blended together, so parts hide
    each other exactly. At equal depths the part that comes first is in front.

    Attributes:
        model: [B, M] int64, which of the renderer's models; ``ABSENT`` (−1) for none.
        model_to_world: [B, M, 4, 4] float32, rigid, metres; not looked at where ``model`` is ``ABSENT``.
    """

    model: Tensor
    model_to_world: Tensor

    def rows(self, rows: slice | Tensor) -> "Parts":
        """The parts of some rows of the batch: a slice, a mask or indices."""
        return Parts(self.model[rows], self.model_to_world[rows])


def camera_to_models(cameras: Cameras, parts: Parts) -> Tensor:
    """The pose of each row's camera in the frame of each of its parts: so harmonics need no turning.

    Args:
        cameras: B views.
        parts: of the B rows.

    Returns:
        [B, M, 4, 4] float32, metres, computed in double precision and rounded once; a part that stands at the origin
        gives ``camera_to_world`` to the bit.
    """
    world_to_model = invert_rigid(parts.model_to_world.double())
    return (world_to_model @ cameras.camera_to_world.double().unsqueeze(1)).float()
