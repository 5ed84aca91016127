"""A cache of rendered views that lives on a device: looking up and storing never synchronises with the host."""

import torch
from torch import Tensor

from splatrl.cameras import Cameras
from splatrl.renderers.base import checked_only
from splatrl.renderers.parts import ABSENT, Parts, require_parts_of
from splatrl.renderers.view_cache import ViewCache

WAYS = 16
"""Associativity: the number of slots in which an image may lie. With half of all slots taken, one image in 1,200 finds
none of its own free: Poisson(8) beyond 16."""


class DeviceAlbum:
    """A hash table of images in a fixed amount of memory.

    A key selects a set of ``WAYS`` slots and is compared in full with the keys in them, so a hit is always the image
    that was asked for. Entries are never evicted: an image whose set is full is not stored. No tensor is ever
    reallocated, so a step that uses the table can be captured in a CUDA graph.

    Args:
        words: 32-bit words per key.
        image: an example image, [H, W, 3] uint8, with the size of all images and on their device.
        max_bytes: bound on the memory of images and keys.
    """

    def __init__(self, words: int, image: Tensor, max_bytes: int) -> None:
        self.sets = max_bytes // (WAYS * (image.nbytes + 4 * words))
        places, device = self.sets * WAYS + 1, image.device  # the last one takes rows that are not stored
        self.keys = torch.zeros(places, words, dtype=torch.int32, device=device)
        self.taken = torch.zeros(places, dtype=torch.bool, device=device)
        self.images = image.new_zeros(places, *image.shape) if self.sets > 0 else image.new_zeros(0)
        g = torch.Generator().manual_seed(0)
        self._factors = (2 * torch.randint(2**62, (words,), generator=g) + 1).to(device)
        self._ways = torch.arange(WAYS, device=device)

    def __len__(self) -> int:
        """Number of stored images; the host waits for the device."""
        return int(self.taken[:-1].sum())

    def bytes_held(self) -> int:
        """Return the bytes that the images take."""
        return self.images.nbytes

    def find(self, keys: Tensor) -> tuple[Tensor, Tensor]:
        """Look up keys.

        Args:
            keys: [B, words] int32.

        Returns:
            places: [B] int64, the slot of each key; if it is not stored, the first free slot of its set, or the last
                slot of all if there is none.
            known: [B] bool, whether each key is stored.
        """
        mixed = (keys * self._factors).sum(1)  # modulo 2^64
        mixed = (mixed ^ (mixed >> 31)) * 0x1CE4E5B9BF58476D
        first = ((mixed >> 33) & 0x7FFFFFFF) % self.sets * WAYS
        places = first[:, None] + self._ways  # [B, WAYS]
        taken = self.taken[places]
        same = taken & (self.keys[places] == keys[:, None]).all(2)
        known, free = same.any(1), ~taken
        way = torch.where(known, same.int().argmax(1), free.int().argmax(1))
        none = ~known & ~free.any(1)
        return torch.where(none, len(self.taken) - 1, first + way), known

    def add(self, keys: Tensor, places: Tensor, images: Tensor, fresh: Tensor) -> None:
        """Store images in the slots that ``find`` returned.

        If several images of a batch compete for one slot, the first is stored, and the others may be another time.

        Args:
            keys: [B, words] int32.
            places: [B] int64, slots from ``find``.
            images: [B, H, W, 3] uint8.
            fresh: [B] bool, which of the images to store.
        """
        nowhere = len(self.taken) - 1
        rows = torch.arange(len(keys), device=keys.device)
        asked = torch.where(fresh, places, nowhere)
        first = torch.full_like(self.taken, len(keys), dtype=torch.int64).scatter_reduce(0, asked, rows, "amin")
        kept = torch.where(first[asked] == rows, asked, nowhere)
        self.keys[kept], self.images[kept] = keys, images
        self.taken.index_fill_(0, kept, True)  # not an assignment, which would copy True from the host


class DeviceLatticeRenderer(ViewCache[DeviceAlbum]):
    """A ``ViewCache`` on the cameras' device, which never synchronises, so a step can be captured in a CUDA graph.

    ``max_bytes``, keys included, are allocated up front for each size of images. Duplicates within a batch are all
    rendered until one of them is stored. The renderer must handle ``only`` without synchronising as well.
    """

    def _pixels(self, cameras: Cameras, parts: Parts | None, only: Tensor | None) -> Tensor:
        if parts is not None:
            require_parts_of(parts, cameras)
        wanted = None if only is None else checked_only(only, cameras)
        keys = _words(cameras, parts)
        kind = cameras.width, cameras.height, keys.shape[1], parts is None  # no parts draw model 0, empty ones nothing
        if kind not in self._albums:
            one = keys.new_empty(cameras.height, cameras.width, 3, dtype=torch.uint8)
            self._albums[kind] = DeviceAlbum(keys.shape[1], one, self.max_bytes)
        album = self._albums[kind]
        if album.sets == 0 or len(cameras) == 0:
            return self.renderer.pixels(cameras, parts, only)
        places, known = album.find(keys)
        fresh = ~known if wanted is None else wanted & ~known
        drawn = self.renderer.pixels(cameras, parts, fresh)
        album.add(keys, places, drawn, fresh)
        recalled = known if wanted is None else wanted & known
        return torch.where(recalled[:, None, None, None], album.images[places], drawn)


def _words(cameras: Cameras, parts: Parts | None) -> Tensor:
    """Return the bits that identify each view, on the cameras' device: [B, words] int32."""
    count = len(cameras)
    values = [cameras.camera_to_world.float(), cameras.K.float().expand(count, 3, 3)]
    if parts is not None:
        absent = (parts.model == ABSENT)[..., None, None]
        values += [parts.model_to_world.float().masked_fill(absent, 0.0)]
    words = [value.contiguous().view(torch.int32).flatten(1) for value in values]
    return torch.cat(words if parts is None else [*words, parts.model.int()], 1)
