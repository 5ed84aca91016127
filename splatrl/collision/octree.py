"""Encodes an occupancy as an octree, in the stream format of OctoMap's binary files (Hornung et al. 2013)."""

import numpy as np
from numpy.typing import NDArray

from splatrl.collision.occupancy import Occupancy

DEPTH = 16
"""Levels below the root; OctoMap supports no other number."""

_OFFSET = 2 ** (DEPTH - 1)
_LEAF, _INNER = 2, 3
"""Codes of a solid leaf and of an inner child. Code 0 is unknown and 1 a free leaf; neither is needed here."""


def encode_octree(occupancy: Occupancy) -> NDArray[np.int8]:
    """Encode solid voxels as an OctoMap ``.bt`` stream without its header.

    Every inner node is one little-endian uint16 of eight 2-bit codes: child i in bits 2i and 2i + 1, where bit 0 of i
    is x, bit 1 y and bit 2 z. Nodes are ordered depth first, parents before children. A node whose eight children are
    all solid becomes one solid leaf.

    Args:
        occupancy: the solid voxels, with keys within ±32768.

    Returns:
        [2 · nodes] int8, which is what ``fcl.OcTree`` takes where C's ``char`` is signed; no bytes at all for an empty
        occupancy.

    Raises:
        ValueError: for a voxel outside the range of the octree's keys.
    """
    keys = occupancy.keys() + _OFFSET
    outside = ((keys < 0) | (keys >= 2**DEPTH)).any(1)
    if outside.any():
        key = keys[outside.argmax()] - _OFFSET
        raise ValueError(
            f"occupancy: expected voxel keys in [{-_OFFSET}, {_OFFSET}), got {key.tolist()} "
            f"({np.round(key * occupancy.resolution, 3).tolist()} m, at a resolution of {occupancy.resolution} m)"
        )
    nodes = np.sort(_morton(keys.astype(np.uint64)))
    full = np.ones(len(nodes), bool)
    places, words = [], []  # positions and codes of the inner nodes, one array per depth
    for depth in range(DEPTH - 1, -1, -1):
        if len(nodes) == 0:
            break
        parents, starts = np.unique(nodes >> np.uint64(3), return_index=True)
        codes = np.where(full, _LEAF, _INNER) << (2 * (nodes & np.uint64(7)).astype(np.int64))
        full = np.add.reduceat(full.astype(np.int64), starts) == 8
        inner = ~full
        places.append((parents[inner] << np.uint64(3 * (DEPTH - depth) + 5)) | np.uint64(depth))
        words.append(np.add.reduceat(codes, starts)[inner])
        nodes = parents
    if not words:
        return np.zeros(0, np.int8)
    depth_first = np.argsort(np.concatenate(places))
    return np.concatenate(words)[depth_first].astype("<u2").view(np.int8)


def _morton(keys: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Interleave the 16 bits of x, y and z: [M, 3] -> [M], x lowest."""
    spread = keys
    for shift, mask in ((16, 0x0000FF0000FF), (8, 0x00F00F00F00F), (4, 0x0C30C30C30C3), (2, 0x249249249249)):
        spread = (spread | (spread << np.uint64(shift))) & np.uint64(mask)
    return spread[:, 0] | (spread[:, 1] << np.uint64(1)) | (spread[:, 2] << np.uint64(2))
