"""Remembers the views of a finite lattice of poses, so that each is rendered once."""

from abc import ABC, abstractmethod
from typing import Any, Generic, Protocol, TypeVar

import torch
from torch import Tensor

from splatrl.cameras import Cameras
from splatrl.faults import Faulty
from splatrl.native import _core
from splatrl.renderers.base import Renderer, RenderOutput, draw_only
from splatrl.renderers.parts import ABSENT, Parts

Column = tuple[int, int, int]
"""Address of values, bytes of a row, and bytes from one row to the next."""


class Album(Protocol):
    """Remembered images of one size."""

    def __len__(self) -> int:
        """How many there are."""
        ...

    def bytes_held(self) -> int:
        """Memory that they take."""
        ...


Kept = TypeVar("Kept", bound=Album)


class ViewCache(ABC, Generic[Kept]):
    """Returns the bytes of another renderer, remembered by the exact bytes of the camera and its parts.

    Worth it where robots stand on a finite lattice of poses: in time every view is a copy. Where poses are continuous
    or noisy nothing repeats; use the renderer itself. When the memory is full, new views are rendered and not
    remembered. Pickles remember nothing.

    Args:
        renderer: what renders the views that are not remembered.
        max_bytes: bound on the remembered images.

    Raises:
        ValueError: for a negative bound.
    """

    def __init__(self, renderer: Renderer, max_bytes: int = 256 * 2**20) -> None:
        if max_bytes < 0:
            raise ValueError(f"max_bytes: expected at least 0, got {max_bytes}")
        self.renderer = renderer
        self.max_bytes = max_bytes
        self._albums: dict[tuple[int, ...], Kept] = {}  # by the size of the images, and what else tells them apart
        if isinstance(renderer, Faulty):
            self.raise_faults = renderer.raise_faults

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.renderer, self.max_bytes)

    def __len__(self) -> int:
        """How many views are remembered."""
        return sum(map(len, self._albums.values()))

    def bytes_held(self) -> int:
        """Memory that the remembered images take."""
        return sum(album.bytes_held() for album in self._albums.values())

    def render(self, cameras: Cameras, parts: Parts | None = None, only: Tensor | None = None) -> RenderOutput:
        """Colour, depth and alpha of each camera; nothing is remembered."""
        return self.renderer.render(cameras, parts, only)

    @abstractmethod
    def pixels(self, cameras: Cameras, parts: Parts | None = None, only: Tensor | None = None) -> Tensor:
        """[B, H, W, 3] uint8: remembered views are copied, others rendered; rows not in ``only`` are zero."""


class _Album:
    """Remembered images of one size: a tensor that doubles as it fills, and the number of each view in it."""

    def __init__(self) -> None:
        self.index = _core.RowIndex()
        self.images: Tensor | None = None  # [capacity, H, W, 3] uint8

    def __len__(self) -> int:
        return len(self.index)

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
        used, most = len(self), max_bytes // images[0].nbytes
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


class LatticeRenderer(ViewCache[_Album]):
    """A ``ViewCache`` in main memory that grows as it fills: while it does, the old and the new images exist together.

    Duplicates within a batch are rendered once.
    """

    @torch.compiler.disable
    def pixels(self, cameras: Cameras, parts: Parts | None = None, only: Tensor | None = None) -> Tensor:
        """[B, H, W, 3] uint8: remembered views are copied, others rendered; rows not in ``only`` are zero."""
        return draw_only(self._recalled, cameras, parts, only)

    def _recalled(self, cameras: Cameras, parts: Parts | None) -> Tensor:
        kind = cameras.width, cameras.height, parts is None  # a row without parts is not the scene where it stands
        if kind not in self._albums:
            self._albums[kind] = _Album()
        album = self._albums[kind]
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
