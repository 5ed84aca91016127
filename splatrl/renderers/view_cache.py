"""A cache of rendered views for poses on a finite lattice, so that each view is rendered only once."""

import threading
from abc import ABC, abstractmethod
from typing import Any, Generic, Protocol, TypeVar

import torch
from torch import Tensor

from splatrl.cameras import Cameras
from splatrl.device_faults import Faulty
from splatrl.native import _core
from splatrl.renderers.base import Renderer, RenderOutput, draw_only
from splatrl.renderers.parts import ABSENT, Parts

Column = tuple[int, int, int]
"""Address of values, bytes per row, and stride from one row to the next in bytes."""


class Album(Protocol):
    """Cached images of one size."""

    def __len__(self) -> int:
        """Number of images."""
        ...

    def bytes_held(self) -> int:
        """Return the bytes that the images take."""
        ...


Kept = TypeVar("Kept", bound=Album)


class ViewCache(ABC, Generic[Kept]):
    """Caches the images of another renderer, keyed by the exact bytes of the camera and its parts.

    This pays off if robots stand on a finite lattice of poses: eventually every view is a copy. If poses are continuous
    or noisy, nothing repeats, and the renderer itself should be used. When the memory is full, new views are rendered
    but not cached. Threads may share a cache, and draw through it one at a time. Pickles do not include the cached
    images.

    Args:
        renderer: the renderer of the views that are not cached.
        max_bytes: bound on the memory of cached images.

    Raises:
        ValueError: for a negative bound.
    """

    def __init__(self, renderer: Renderer, max_bytes: int = 256 * 2**20) -> None:
        if max_bytes < 0:
            raise ValueError(f"max_bytes: expected at least 0, got {max_bytes}")
        self.renderer = renderer
        self.max_bytes = max_bytes
        self._using = threading.Lock()  # no other thread may store a view between looking one up and storing it
        self._albums: dict[tuple[int, ...], Kept] = {}  # by image size and whatever else must match
        if isinstance(renderer, Faulty):
            self.raise_faults = renderer.raise_faults

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.renderer, self.max_bytes)

    def __len__(self) -> int:
        """Number of cached views."""
        return sum(map(len, self._albums.values()))

    def bytes_held(self) -> int:
        """Return the bytes that the cached images take."""
        return sum(album.bytes_held() for album in self._albums.values())

    def render(self, cameras: Cameras, parts: Parts | None = None, only: Tensor | None = None) -> RenderOutput:
        """Render colour, depth and alpha for each camera; nothing is cached. See ``Renderer``."""
        return self.renderer.render(cameras, parts, only)

    @torch.compiler.disable
    def pixels(self, cameras: Cameras, parts: Parts | None = None, only: Tensor | None = None) -> Tensor:
        """Return [B, H, W, 3] uint8: cached views are copied, others rendered; rows not in ``only`` are zero."""
        with self._using:
            return self._pixels(cameras, parts, only)

    @abstractmethod
    def _pixels(self, cameras: Cameras, parts: Parts | None, only: Tensor | None) -> Tensor:
        """Do what ``pixels`` does, while no other thread does."""


class _Album:
    """Cached images of one size: a tensor that doubles as it fills, and an index of the views in it."""

    def __init__(self) -> None:
        self.index = _core.RowIndex()
        self.images: Tensor | None = None  # [capacity, H, W, 3] uint8

    def __len__(self) -> int:
        return len(self.index)

    def bytes_held(self) -> int:
        return 0 if self.images is None else self.images.nbytes

    def add(self, columns: list[Column], rows: list[int], images: Tensor, max_bytes: int) -> None:
        """Store images, from the first on, as many as fit into ``max_bytes`` together with those already stored.

        Args:
            columns: the columns of a batch.
            rows: the rows of the batch that the images belong to, none of which is stored yet.
            images: [len(rows), H, W, 3] uint8.
            max_bytes: the most bytes that ``self.images`` may take.
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
    """A ``ViewCache`` in main memory that grows as it fills; while it grows, the old and the new images exist together.

    Duplicates within a batch are rendered once.
    """

    def _pixels(self, cameras: Cameras, parts: Parts | None, only: Tensor | None) -> Tensor:
        return draw_only(self._recalled, cameras, parts, only)

    def _recalled(self, cameras: Cameras, parts: Parts | None) -> Tensor:
        kind = cameras.width, cameras.height, parts is None  # no parts draw model 0, empty parts draw nothing
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
    """Copy some images; ``index_select`` copies whole images, whereas indexing would copy single pixels."""
    return images.index_select(0, rows.to(images.device))


def _values(cameras: Cameras, parts: Parts | None) -> list[tuple[Tensor, int, int]]:
    """Return the values that identify a view, in main memory, each with its bytes per row and its stride in bytes."""
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
