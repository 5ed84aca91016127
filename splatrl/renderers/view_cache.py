"""Remembers the views of a finite lattice of poses, so that each is rendered once."""

from typing import Any

import torch
from torch import Tensor

from splatrl.cameras import Cameras
from splatrl.faults import Faulty
from splatrl.native import _core
from splatrl.renderers.base import Renderer, RenderOutput, checked_only, draw_only
from splatrl.renderers.device_album import DeviceAlbum
from splatrl.renderers.parts import ABSENT, Parts, require_parts_of

Column = tuple[int, int, int]
"""Address of values, bytes of a row, and bytes from one row to the next."""


class _Album:
    """Remembered images of one size: a tensor that doubles as it fills, and the number of each view in it."""

    def __init__(self) -> None:
        self.index = _core.RowIndex()
        self.images: Tensor | None = None  # [capacity, H, W, 3] uint8

    def bytes_held(self) -> int:
        return 0 if self.images is None else self.images.nbytes

    def add(self, columns: list[Column], rows: list[int], images: Tensor, max_bytes: int) -> None:
        """Remember the first of these images, as many as fit into ``max_bytes`` with what is there.

        Args:
            columns: of a batch.
            rows: those of it to which the images belong, none of which is remembered yet.
            images: [len(rows), H, W, 3] uint8.
            max_bytes: the most that ``images`` may take.
        """
        used, most = len(self.index), max_bytes // images[0].nbytes
        count = max(0, min(len(rows), most - used))
        if count == 0:
            return
        if self.images is None or used + count > len(self.images):
            capacity = min(most, max(used + count, 2 * used))
            grown = images.new_empty(capacity, *images.shape[1:])
            if self.images is not None:
                grown[:used] = self.images[:used]
            self.images = grown
        self.images[used : used + count] = images[:count]
        self.index.add(columns, rows[:count])


class LatticeRenderer:
    """Returns the bytes of another renderer, remembered by the exact bytes of the camera and its parts.

    Worth it where robots stand on a finite lattice of poses: in time every view is a copy. Where poses are continuous
    or noisy nothing repeats; use the renderer itself. When the memory is full, new views are rendered and not
    remembered. Duplicates within a batch are rendered once, on a device until one of them is remembered. Pickles
    remember nothing.

    Args:
        renderer: what renders the views that are not remembered.
        max_bytes: bound on the remembered images; while they are copied to a larger tensor, the old one exists too. On
            a device this much is taken at once for each size of images, keys included.
        on_device: whether views are looked up where the cameras are, without the host reading anything, so that a step
            can be captured in a CUDA graph: for a GPU. The renderer must take ``only`` the same way.

    Raises:
        ValueError: for a negative bound.
    """

    def __init__(self, renderer: Renderer, max_bytes: int = 256 * 2**20, on_device: bool = False) -> None:
        if max_bytes < 0:
            raise ValueError(f"max_bytes: expected at least 0, got {max_bytes}")
        self.renderer = renderer
        self.max_bytes = max_bytes
        self.on_device = on_device
        if isinstance(renderer, Faulty):
            self.raise_faults = renderer.raise_faults
        self._albums: dict[tuple[int, int, bool], _Album] = {}
        self._on_device: dict[tuple[int, int, int], DeviceAlbum] = {}

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.renderer, self.max_bytes, self.on_device)

    def __len__(self) -> int:
        """How many views are remembered."""
        on_device = sum(len(album) for album in self._on_device.values())
        return on_device + sum(len(album.index) for album in self._albums.values())

    def bytes_held(self) -> int:
        """Memory that the remembered images take."""
        on_device = sum(album.images.nbytes for album in self._on_device.values())
        return on_device + sum(album.bytes_held() for album in self._albums.values())

    def render(self, cameras: Cameras, parts: Parts | None = None, only: Tensor | None = None) -> RenderOutput:
        """Colour, depth and alpha of each camera; nothing is remembered."""
        return self.renderer.render(cameras, parts, only)

    @torch.compiler.disable
    def pixels(self, cameras: Cameras, parts: Parts | None = None, only: Tensor | None = None) -> Tensor:
        """[B, H, W, 3] uint8: remembered views are copied, others rendered; rows not in ``only`` are zero."""
        if self.on_device:
            return self._found(cameras, parts, only)
        return draw_only(self._recalled, cameras, parts, only)

    def _found(self, cameras: Cameras, parts: Parts | None, only: Tensor | None) -> Tensor:
        """What ``pixels`` gives, from the album of a device: the renderer draws what is not in it, and only that."""
        if parts is not None:
            require_parts_of(parts, cameras)
        wanted = None if only is None else checked_only(only, cameras)
        keys = _words(cameras, parts)
        kind = cameras.width, cameras.height, keys.shape[1]
        if kind not in self._on_device:
            one = keys.new_empty(cameras.height, cameras.width, 3, dtype=torch.uint8)
            self._on_device[kind] = DeviceAlbum(keys.shape[1], one, self.max_bytes)
        album = self._on_device[kind]
        if album.sets == 0 or len(cameras) == 0:
            return self.renderer.pixels(cameras, parts, only)
        places, known = album.find(keys)
        fresh = ~known if wanted is None else wanted & ~known
        drawn = self.renderer.pixels(cameras, parts, fresh)
        album.add(keys, places, drawn, fresh)
        recalled = known if wanted is None else wanted & known
        return torch.where(recalled[:, None, None, None], album.images[places], drawn)

    def _recalled(self, cameras: Cameras, parts: Parts | None) -> Tensor:
        kind = cameras.width, cameras.height, parts is None  # a row without parts is not the scene where it stands
        album = self._albums.get(kind) or self._albums.setdefault(kind, _Album())
        values = _values(cameras, parts)
        columns = [(one.data_ptr(), size, step) for one, size, step in values]
        numbers = torch.empty(len(cameras), dtype=torch.int64)
        fresh = album.index.find(columns, len(cameras), numbers.data_ptr())
        if album.images is not None and not fresh:
            return _take(album.images, numbers)

        rows = torch.tensor(fresh, dtype=torch.int64)
        rendered = self.renderer.pixels(cameras[rows], None if parts is None else parts.rows(rows))
        known = (numbers >= 0).nonzero().squeeze(1)
        sources, places = rendered, -1 - numbers
        if album.images is not None:
            sources = torch.cat([rendered, _take(album.images, numbers[known])])
            places[known] = torch.arange(len(rendered), len(sources))
        if fresh:
            album.add(columns, fresh, rendered, self.max_bytes - (self.bytes_held() - album.bytes_held()))
        return _take(sources, places)


def _take(images: Tensor, rows: Tensor) -> Tensor:
    """A copy of some images; ``index_select`` copies a whole image at a time, indexing goes pixel by pixel."""
    return images.index_select(0, rows.to(images.device))


def _words(cameras: Cameras, parts: Parts | None) -> Tensor:
    """What tells views apart, where the cameras are: [B, words] int32."""
    count = len(cameras)
    values = [cameras.camera_to_world.float(), cameras.K.float().expand(count, 3, 3)]
    if parts is not None:
        absent = (parts.model == ABSENT)[..., None, None]
        values += [parts.model_to_world.float().masked_fill(absent, 0.0)]
    words = [value.contiguous().view(torch.int32).flatten(1) for value in values]
    return torch.cat(words if parts is None else [*words, parts.model.int()], 1)


def _values(cameras: Cameras, parts: Parts | None) -> list[tuple[Tensor, int, int]]:
    """What tells views apart, in main memory: values, bytes of a row, and bytes from one row to the next, of each."""
    values = [cameras.camera_to_world, cameras.K]
    if parts is not None:
        absent = (parts.model == ABSENT)[..., None, None]
        values += [parts.model, parts.model_to_world.masked_fill(absent, 0.0)]  # never read
    held = []
    for one in values:
        repeated = one.stride(0) == 0
        rows = (one[:1] if repeated else one).cpu().contiguous()
        size = rows.nbytes // max(len(rows), 1)
        held.append((rows, size, 0 if repeated else size))
    return held
