"""Placement of the parts of each row, computed on the device before ``CudaRenderer`` draws them."""

import ctypes

import torch
from torch import Tensor

from splatrl.cameras import Cameras
from splatrl.device_faults import FaultFlag
from splatrl.native.cuda.kernels import Kernels
from splatrl.renderers.cuda_models import MOST_INDICES, CudaModels
from splatrl.renderers.parts import ABSENT, Parts, require_parts_of

MOST_PARTS = 128
"""The most parts per row: a thread block keeps the view of each in shared memory."""
PLACE_WORDS = 16
"""Size of ``Place`` in cuda/places.h, in 32-bit words."""


class _Asked(ctypes.Structure):
    """``Asked`` of cuda/place.cu."""

    _fields_ = (
        *(
            (name, ctypes.c_void_p)
            for name in ("models", "model", "model_to_world", "camera_to_world", "only", "fault")
        ),
        *((name, ctypes.c_int) for name in ("parts", "model_count", "most_indices", "most_gaussians")),
    )


class CudaParts:
    """Expresses cameras in the frames of parts, and numbers the parts' Gaussians, without synchronising with the host.

    Args:
        kernels: the kernels of cuda/place.cu.
        models: the models that parts refer to.
        most_gaussians: upper bound on the Gaussians of a row, merged ones not counted.
    """

    def __init__(self, kernels: Kernels, models: CudaModels, most_gaussians: int) -> None:
        self._kernels, self._models, self._most_gaussians = kernels, models, most_gaussians
        self._faults = FaultFlag(kernels.device)

    def capacity(self, parts: Parts) -> int:
        """Return the most Gaussians that a row with M parts can draw: M times the largest model's, within the bound."""
        return max(1, min(parts.model.shape[1] * self._models.gaussians, self._most_gaussians))

    def places(self, cameras: Tensor, parts: Parts, only: Tensor | None) -> Tensor:
        """Queue the placement of each part.

        Args:
            cameras: camera_to_world [B, 4, 4] float32, on the device.
            parts: the parts of the B rows.
            only: [B] bool, rows to process; None for all.

        Returns:
            [B, M, ``PLACE_WORDS``] int32, ``Place`` of cuda/places.h; uninitialised in the other rows.
        """
        device = self._kernels.device
        model = parts.model.to(device).contiguous()
        poses = parts.model_to_world.detach().to(device).contiguous()
        places = torch.empty(*model.shape, PLACE_WORDS, dtype=torch.int32, device=device)
        given = (self._models.table, model, poses, cameras, only, self._faults.flag)
        addresses = (None if value is None else value.data_ptr() for value in given)
        numbers = (model.shape[1], len(self._models.models), MOST_INDICES, self.capacity(parts))
        self._kernels.launch("place_parts", len(model), 32, _Asked(*addresses, *numbers), places)
        return places

    def raise_faults(self) -> None:
        """Raise an error for the faults in parts that were recorded since the last call; see ``Faulty``."""
        row = self._faults.take()
        if row is not None:
            raise ValueError(
                f"parts[{row}]: expected {ABSENT} or models in [0, {len(self._models.models)}), rigid model_to_world, "
                f"and together at most {self._most_gaussians:,} Gaussians ({MOST_INDICES:,} including merged ones)"
            )


def require_few_parts_of(parts: Parts, cameras: Cameras) -> None:
    """Reject parts that do not match a batch of cameras or are too many, without looking at their values.

    Raises:
        ValueError: for another shape or type, or more than ``MOST_PARTS`` per row.
    """
    require_parts_of(parts, cameras)
    if parts.model.shape[1] > MOST_PARTS:
        raise ValueError(f"parts.model: expected at most {MOST_PARTS} parts per row, got {parts.model.shape[1]}")
