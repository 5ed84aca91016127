"""Shortest paths over grids of nodes, against those that SciPy finds on the same graph."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import ndimage, sparse
from scipy.sparse import csgraph

from splatrl.bodies import Sphere
from splatrl.collision import NoChecker, Occupancy
from splatrl.curriculum.ground import WAYS, Ground
from splatrl.motions import NavigateMotion
from splatrl.native import _core

CELL = 0.05
LENGTHS = CELL * np.hypot(*WAYS.T)
Floats = NDArray[np.float32]


def random_ways(shape: tuple[int, int], share: float, rng: np.random.Generator) -> tuple[Any, NDArray[np.bool_]]:
    """Leave out some nodes and, of the ways between the others, a tenth: the ways that are open, and the nodes."""
    nodes = rng.random(shape) >= share
    ways = np.zeros(shape, np.uint16)
    for bit, way in enumerate(WAYS):
        there = np.indices(shape) + way[:, None, None]
        inside = ((there >= 0) & (there < np.array(shape)[:, None, None])).all(0)
        joined = inside & nodes & (rng.random(shape) >= 0.1)
        joined[joined] = nodes[tuple(there[:, joined])]
        ways[joined] |= np.uint16(1 << bit)
    return ways, nodes


def graph_of(ways: NDArray[np.uint16]) -> Any:
    """Return the same graph for SciPy."""
    begins, bits = np.nonzero((ways.reshape(-1, 1) >> np.arange(len(WAYS))) & 1)
    ends = begins + WAYS[bits] @ [ways.shape[1], 1]
    return sparse.csr_matrix((LENGTHS[bits], (begins, ends)), (ways.size, ways.size))


def found(ways: NDArray[np.uint16], goals: Any, threads: int = 1, **changes: Any) -> Floats:
    """Return the distances from all nodes to goals: [G, X · Y]."""
    metres = np.empty((len(goals), ways.size), np.float32)
    nearest, away = np.arange(ways.size).reshape(ways.shape), np.zeros(ways.shape)
    given = {"steps": WAYS, "lengths": LENGTHS, "nearest": nearest, "away": away} | changes
    _core.find_geodesics(ways=ways, goals=np.asarray(goals, np.int64), metres=metres, threads=threads, **given)
    return metres


def largest_part(ways: NDArray[np.uint16], nodes: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the nodes of the largest connected part."""
    part = np.empty(ways.shape, bool)
    _core.find_largest_part(ways, WAYS, nodes, part)
    return part


@settings(max_examples=40)
@given(
    shape=st.tuples(st.integers(1, 30), st.integers(1, 30)),
    goals=st.integers(1, 20),
    share=st.sampled_from([0.0, 0.2, 0.5, 0.7, 0.9]),
    seed=st.integers(0, 2**32 - 1),
)
def test_distances_and_the_largest_part_are_those_of_scipy_to_the_last_bit(
    shape: tuple[int, int], goals: int, share: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    ways, nodes = random_ways(shape, share, rng)
    rows = rng.integers(0, ways.size, goals)
    expected = csgraph.dijkstra(graph_of(ways), directed=False, indices=rows)
    assert np.array_equal(found(ways, rows), expected.astype(np.float32))
    _, label = csgraph.connected_components(graph_of(ways), directed=False)
    sizes = np.bincount(label, weights=nodes.reshape(-1))
    assert np.array_equal(largest_part(ways, nodes).reshape(-1), nodes.reshape(-1) & (label == sizes.argmax()))


def test_a_path_may_turn_back_many_times() -> None:
    nodes = np.ones((21, 40), bool)  # a corridor that winds through the grid
    nodes[1::4, :-1] = nodes[3::4, 1:] = False
    assert_as_scipy(nodes)
    assert_as_scipy(nodes.T.copy())


def assert_as_scipy(nodes: NDArray[np.bool_]) -> None:
    """Join neighbouring nodes, and compare the distances to the first and the last."""
    ways = np.zeros(nodes.shape, np.uint16)
    ways[:-1] |= np.where(nodes[:-1] & nodes[1:], 1, 0).astype(np.uint16)
    ways[:, :-1] |= np.where(nodes[:, :-1] & nodes[:, 1:], 2, 0).astype(np.uint16)
    goals = np.flatnonzero(nodes)[[0, -1]]
    metres = found(ways, goals)
    assert np.array_equal(metres, csgraph.dijkstra(graph_of(ways), directed=False, indices=goals).astype(np.float32))
    assert metres[0, goals[1]] > 10 * CELL * max(nodes.shape)


def test_the_number_of_threads_changes_no_byte() -> None:
    ways, _ = random_ways((50, 70), 0.3, np.random.default_rng(0))
    goals = np.random.default_rng(1).integers(0, ways.size, 29)
    assert found(ways, goals, threads=4).tobytes() == found(ways, goals).tobytes()


def test_distances_are_infinite_between_parts_that_no_way_connects() -> None:
    ways = np.zeros((2, 3), np.uint16)
    ways[0, :2] = ways[1, :1] = 2  # (0, 0) to (0, 2), and (1, 0) to (1, 1)
    infinite = np.inf
    assert found(ways, [0, 4]) == pytest.approx(
        np.array([[0.0, 0.05, 0.1, *[infinite] * 3], [*[infinite] * 3, 0.05, 0.0, infinite]])
    )
    assert largest_part(ways, np.ones((2, 3), bool)).tolist() == [[True] * 3, [False] * 3]


def test_a_node_that_is_not_open_takes_the_distance_of_the_nearest_open_one() -> None:
    ways, nodes = random_ways((31, 47), 0.3, np.random.default_rng(2))
    part = largest_part(ways, nodes)
    body = NoChecker(Occupancy.empty(), Sphere(0.1))
    place = Ground(np.zeros(2), nodes.shape, CELL, part.reshape(-1), ways, NavigateMotion(0.0), body)
    goals = np.flatnonzero(part)[:9]
    among = csgraph.dijkstra(graph_of(ways), directed=False, indices=goals)
    away, (x, y) = ndimage.distance_transform_edt(~part, return_indices=True)
    expected = among[:, (x * 47 + y).reshape(-1)] + CELL * away.reshape(-1)
    assert np.array_equal(place.distances(goals), expected.astype(np.float32))


def test_ways_that_leave_the_grid_and_nodes_outside_it_are_refused() -> None:
    none = np.zeros((4, 5), np.uint16)
    for node, bit in (((3, 0), 0), ((0, 4), 1), ((0, 0), 3), ((1, 0), 12)):
        ways = none.copy()
        ways[node] = 1 << bit
        with pytest.raises(ValueError, match=r"ways: expected ways that end on the grid"):
            found(ways, [0])
    with pytest.raises(ValueError, match=r"ways: expected no more bits than steps"):
        found(none + np.uint16(4), [0], steps=WAYS[:2], lengths=LENGTHS[:2])
    for goal in (-1, 20):
        with pytest.raises(ValueError, match=r"goals, nearest: expected nodes of the grid"):
            found(none, [goal])
        with pytest.raises(ValueError, match=r"goals, nearest: expected nodes of the grid"):
            found(none, [0], nearest=np.full((4, 5), goal))
    with pytest.raises(ValueError, match=r"lengths: expected positive ones"):
        found(none, [0], lengths=np.zeros(len(WAYS)))
    with pytest.raises(ValueError, match=r"lengths: expected one for each step"):
        found(none, [0], lengths=LENGTHS[:3])
    with pytest.raises(ValueError, match=r"steps: expected \(0, 1\), or steps to later columns"):
        found(none, [0], steps=-WAYS)
    with pytest.raises(ValueError, match=r"steps: expected at most 16"):
        found(none, [0], steps=np.concatenate([WAYS, WAYS[:1]]), lengths=np.append(LENGTHS, CELL))
    with pytest.raises(ValueError, match=r"find_geodesics: expected arrays for the same nodes and goals"):
        found(none, [0], away=np.zeros((4, 4)))
    with pytest.raises(ValueError, match=r"find_largest_part: expected arrays for the same nodes"):
        largest_part(none, np.ones((4, 4), bool))
