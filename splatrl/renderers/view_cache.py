"""Remembers the views of a finite lattice of poses, so that each is rendered once."""

import torch
from torch import Tensor

from splatrl.cameras import Cameras
from splatrl.renderers.base import Renderer, RenderOutput, draw_only
from splatrl.renderers.parts import ABSENT, Parts


class _Album:
    """Remembered images of one size: a tensor that doubles as it fills, and the slot of each view."""

    def __init__(self) -> None:
        self.slots: dict[bytes, int] = {}
        self.images: Tensor | None = None  # [capacity, H, W, 3] uint8

    def bytes_held(self) -> int:
        return 0 if self.images is None else self.images.nbytes

    def add(self, views: list[bytes], images: Tensor, max_bytes: int) -> None:
        """Remember the first of these images, as many as fit into ``max_bytes`` with what is there.

        Args:
            views: keys that are not yet in ``slots``.
            images: [len(views), H, W, 3] uint8.
            max_bytes: the most that ``images`` may take.
        """
        used, most = len(self.slots), max_bytes // images[0].nbytes
        count = max(0, min(len(views), most - used))
        if count == 0:
            return
        if self.images is None or used + count > len(self.images):
            capacity = min(most, max(used + count, 2 * used))
            grown = images.new_empty(capacity, *images.shape[1:])
            if self.images is not None:
                grown[:used] = self.images[:used]
            self.images = grown
        self.images[used : used + count] = images[:count]
        self.slots.update(zip(views[:count], range(used, used + count), strict=True))


class LatticeRenderer:
    """Returns the bytes of another renderer, remembered by the exact bytes of the camera and its parts.

    Worth it where robots stand on a finite lattice of poses: in time every view is a copy. Where poses are continuous
    or noisy nothing repeats; use the renderer itself. When the memory is full, new views are rendered and not
    remembered. Duplicates within a batch are rendered once.

    Args:
        renderer: what renders the views that are not remembered.
        max_bytes: bound on the remembered images; while they are copied to a larger tensor, the old one exists too.

    Raises:
        ValueError: for a negative bound.
    """

    def __init__(self, renderer: Renderer, max_bytes: int = 256 * 2**20) -> None:
        if max_bytes < 0:
            raise ValueError(f"max_bytes: expected at least 0, got {max_bytes}")
        self.renderer = renderer
        self.max_bytes = max_bytes
        self._albums: dict[tuple[int, int], _Album] = {}

    def __len__(self) -> int:
        """How many views are remembered."""
        return sum(len(album.slots) for album in self._albums.values())

    def bytes_held(self) -> int:
        """Memory that the remembered images take."""
        return sum(album.bytes_held() for album in self._albums.values())

    def render(self, cameras: Cameras, parts: Parts | None = None, only: Tensor | None = None) -> RenderOutput:
        """Colour, depth and alpha of each camera; nothing is remembered."""
        return self.renderer.render(cameras, parts, only)

    @torch.compiler.disable
    def pixels(self, cameras: Cameras, parts: Parts | None = None, only: Tensor | None = None) -> Tensor:
        """[B, H, W, 3] uint8: remembered views are copied, others rendered; rows not in ``only`` are zero."""
        return draw_only(self._recalled, cameras, parts, only)

    def _recalled(self, cameras: Cameras, parts: Parts | None) -> Tensor:
        album = self._albums.setdefault((cameras.width, cameras.height), _Album())
        views = _keys(cameras, parts)
        slots = [slot for slot in map(album.slots.get, views) if slot is not None]
        if album.images is not None and len(slots) == len(views):
            return _take(album.images, slots)

        first_rows: dict[bytes, int] = {}
        for row, view in enumerate(views):
            first_rows.setdefault(view, row)
        known = [view for view in first_rows if view in album.slots]
        fresh = [view for view in first_rows if view not in album.slots]
        rows = torch.tensor([first_rows[view] for view in fresh], dtype=torch.long)
        rendered = self.renderer.pixels(cameras[rows], None if parts is None else parts.rows(rows))
        sources = rendered
        if album.images is not None:
            sources = torch.cat([rendered, _take(album.images, [album.slots[view] for view in known])])
        positions = {view: position for position, view in enumerate([*fresh, *known])}
        if fresh:
            album.add(fresh, rendered, self.max_bytes - (self.bytes_held() - album.bytes_held()))
        return _take(sources, [positions[view] for view in views])


def _take(images: Tensor, rows: list[int]) -> Tensor:
    """A copy of some images; ``index_select`` copies a whole image at a time, indexing goes pixel by pixel."""
    return images.index_select(0, torch.tensor(rows, dtype=torch.long, device=images.device))


def _keys(cameras: Cameras, parts: Parts | None) -> list[bytes]:
    """The exact bytes of each camera's pose and intrinsics, and of the parts that it is shown."""
    keys = _row_bytes(torch.cat([cameras.camera_to_world.flatten(1), cameras.K.flatten(1)], 1))
    if parts is None:
        return keys
    absent = (parts.model == ABSENT)[..., None, None]
    poses = parts.model_to_world.masked_fill(absent, 0.0)  # never read
    placed = zip(keys, _row_bytes(parts.model), _row_bytes(poses.flatten(1)), strict=True)
    return [b"parts".join(key) for key in placed]  # so that a row without parts differs from the scene where it stands


def _row_bytes(values: Tensor) -> list[bytes]:
    """The bytes of each row: [B, N] values."""
    raw, row_bytes = values.contiguous().cpu().numpy().tobytes(), values.element_size() * values.shape[1]
    return [raw[row * row_bytes : (row + 1) * row_bytes] for row in range(len(values))]
