"""Detects, without a GPU, what a step on a GPU must not do.

``NoHostReads`` watches every operation on a CPU and refuses those for which the host would wait for a GPU, or whose
output would have a size that only the device knows. ``NoTransfers`` watches an env on the ``meta`` device, which holds
no data: any read by the host fails there by itself, and so does any tensor that was left behind on the CPU; transfers
within a step are refused.
"""

from typing import Any

import pytest
import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode

from splatrl.bodies import Body
from splatrl.cameras import Cameras
from splatrl.renderers import Parts, RenderOutput
from tests.tiny import BODY

aten = torch.ops.aten

READS = {
    aten._local_scalar_dense,  # item, bool, int, float, an index without a dimension
    aten.equal,
    aten.is_nonzero,
    aten.nonzero,
    aten.masked_select,
    aten._unique2,
    aten.unique_dim,
    aten.unique_consecutive,
    aten.bincount,
    aten.histc,
    aten.repeat_interleave,
    aten.multinomial,  # checks that its probabilities are valid
    aten.normal,  # checks its standard deviations
}
"""Operations that make the host wait for the device."""
INDEXED = {aten.index, aten.index_put, aten.index_put_, aten._index_put_impl_}
"""Operations that synchronise if an index is a mask, because its rows are looked up, or if the value they write is a
scalar, because it comes from the host."""


class HostReadError(AssertionError):
    """The host would have waited for the device."""


class NoHostReads(TorchDispatchMode):
    """Refuses operations that make the host wait for the device."""

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        packet = func.overloadpacket
        masked = packet in INDEXED and any(
            index is not None and index.dtype in (torch.bool, torch.uint8) for index in args[1]
        )
        number = packet in INDEXED and len(args) > 2 and args[2].ndim == 0
        if packet in READS or masked or number:
            raise HostReadError(f"{func}{' by a mask' if masked else ' of a number' if number else ''}")
        return func(*args, **(kwargs or {}))


class NoTransfers(TorchDispatchMode):
    """Refuses copies between devices, and operations that mix CPU tensors with a device's."""

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        given = [value for value in (*args, *(kwargs or {}).values()) if isinstance(value, Tensor)]
        given += [one for value in args if isinstance(value, (list, tuple)) for one in value if isinstance(one, Tensor)]
        out = func(*args, **(kwargs or {}))
        made = [out] if isinstance(out, Tensor) else []
        devices = {value.device.type for value in (*given, *made)}
        if len(devices) > 1 or func.overloadpacket in READS:
            raise HostReadError(f"{func} between {', '.join(sorted(devices))}")
        return out


class AnywhereGenerator(torch.Generator):
    """A CPU generator that accepts any device, since ``meta`` has no generators and draws nothing."""

    def __new__(cls, device: Any = "cpu") -> "AnywhereGenerator":
        return super().__new__(cls, "cpu")


def pretend_device(monkeypatch: pytest.MonkeyPatch) -> None:
    """Allow envs on ``meta``, with generators and with specs that do not read their limits."""
    monkeypatch.setattr(torch, "Generator", AnywhereGenerator)
    monkeypatch.setattr(torch, "allclose", lambda *tensors, **options: True)


class Painter:
    """A stateless renderer that never synchronises: it colours each view by its camera's position and direction."""

    def render(self, cameras: Cameras, parts: Parts | None = None, only: Tensor | None = None) -> RenderOutput:
        pose = cameras.camera_to_world
        shape = (len(cameras), cameras.height, cameras.width)
        level = torch.sigmoid(pose[:, :3, 3] + pose[:, :3, 2])  # [B, 3], metres and directions
        across = torch.linspace(0, 1, cameras.width, device=pose.device).view(-1, 1)
        rgb = (level.view(-1, 1, 1, 3) * across).expand(*shape, 3)
        depth = pose[:, 2, 3].abs().view(-1, 1, 1).expand(shape) + 0.7
        alpha = torch.ones(shape, device=pose.device)
        if only is None:
            return RenderOutput(rgb, depth, alpha)
        return RenderOutput(*(torch.where(only.view(-1, *[1] * (x.ndim - 1)), x, 0.0) for x in (rgb, depth, alpha)))

    def pixels(self, cameras: Cameras, parts: Parts | None = None, only: Tensor | None = None) -> Tensor:
        return (255 * self.render(cameras, parts, only).rgb).to(torch.uint8)


class SquareChecker:
    """Checks collision with a square around the origin, only at the ends of moves."""

    def __init__(self, body: Body = BODY, reach: float = 0.35):
        self.body, self.reach = body, reach

    def collides(self, body_to_world: Tensor) -> Tensor:
        return (body_to_world[:, :2, 3].abs() < self.reach).all(1)

    def free_fraction(self, start: Tensor, end: Tensor) -> Tensor:
        return torch.where(self.collides(end), 0.5, 1.0)

    def sweeps(self, start: Tensor, end: Tensor) -> Tensor:
        return self.collides(end)

    def clearance(self, points: Tensor) -> Tensor:
        return (points[:, :2].abs().amax(1) - self.reach).clamp_min(0)
