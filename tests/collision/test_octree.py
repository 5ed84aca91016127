import platform

import fcl
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from splatrl.collision import Occupancy
from splatrl.collision.octree import encode_octree


def decode(stream: np.ndarray) -> set[tuple[int, int, int, int]]:
    """Decode the solid leaves of a stream by plain recursion, as (edge in voxels, key of the lowest corner)."""
    words = iter(stream.view("<u2").tolist())
    leaves = set()

    def visit(edge: int, x: int, y: int, z: int) -> None:
        word, half = next(words), edge // 2
        for child in range(8):
            code = word >> 2 * child & 3
            corner = (x + half * (child & 1), y + half * (child >> 1 & 1), z + half * (child >> 2 & 1))
            if code == 2:
                leaves.add((half, *corner))
            elif code == 3:
                visit(half, *corner)

    visit(2**16, -(2**15), -(2**15), -(2**15))
    assert next(words, None) is None, "the stream goes on after its last node"
    return leaves


def voxels(leaves: set[tuple[int, int, int, int]]) -> set[tuple[int, int, int]]:
    return {
        (x + i, y + j, z + k) for edge, x, y, z in leaves for i in range(edge) for j in range(edge) for k in range(edge)
    }


def random_occupancy(seed: int, share: float, shape: tuple[int, int, int], origin: tuple[int, int, int]) -> Occupancy:
    return Occupancy(np.random.default_rng(seed).random(shape) < share, origin, 0.1)


@settings(max_examples=30)
@given(
    seed=st.integers(0, 2**32 - 1),
    share=st.sampled_from([0.02, 0.5, 0.97]),
    origin=st.tuples(*[st.integers(-(2**15), 2**15 - 9)] * 3),
)
def test_a_decoder_finds_the_voxels_that_were_encoded(seed, share, origin):
    occupancy = random_occupancy(seed, share, (9, 5, 7), origin)
    if occupancy.count:
        assert voxels(decode(encode_octree(occupancy))) == set(map(tuple, occupancy.keys().tolist()))


def test_eight_solid_children_become_one_leaf():
    assert decode(encode_octree(Occupancy(np.ones((4, 4, 4), bool), (-4, 8, 0), 0.1))) == {(4, -4, 8, 0)}


def test_a_missing_voxel_keeps_only_its_own_branch_unpruned():
    occupied = np.ones((4, 4, 4), bool)
    occupied[3, 0, 1] = False
    leaves = decode(encode_octree(Occupancy(occupied, (0, 0, 0), 0.1)))
    assert sorted(edge for edge, *_ in leaves) == [1] * 7 + [2] * 7


def takes(stream):
    try:
        return bool(fcl.OcTree(0.1, stream))
    except OverflowError:
        return False


def test_fcl_accepts_bytes_only_with_the_signedness_of_the_platforms_char():
    stream = encode_octree(Occupancy(np.ones((1, 1, 1), bool), (-1, -1, -1), 0.1))
    assert stream.dtype == np.int8 and stream.min() < 0
    taken = [takes(stream), takes(stream.view(np.uint8))]
    assert taken == ([False, True] if platform.machine() == "aarch64" else [True, False])


def test_an_empty_occupancy_encodes_to_nothing():
    assert encode_octree(Occupancy.empty()).size == 0
    assert encode_octree(Occupancy(np.zeros((2, 3, 4), bool), (0, 0, 0), 0.1)).size == 0


@pytest.mark.parametrize("key", [(-(2**15) - 1, 0, 0), (0, 2**15, 0), (5, 5, 2**15 + 7)])
def test_a_key_beyond_the_range_of_the_octree_is_named(key):
    with pytest.raises(ValueError, match=r"expected voxel keys in \[-32768, 32768\), got \[" + str(key[0])):
        encode_octree(Occupancy.from_keys([key], 0.1))


def test_the_outermost_keys_are_encoded():
    for key in [(-(2**15),) * 3, (2**15 - 1,) * 3]:
        assert decode(encode_octree(Occupancy.from_keys([key], 0.1))) == {(1, *key)}
