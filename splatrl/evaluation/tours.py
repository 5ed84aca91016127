"""Short closed tours over a lattice that pass as many of its places as their length allows."""

import math
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra

Floats = NDArray[np.float64]

WAYS = ((0, 1), (1, 0), (1, 1), (1, -1))
"""Offsets to half of a place's eight neighbours, so that each edge is listed once."""


def round_trip(places: Floats, step: float, length: float) -> Floats:
    """Find a closed tour over a lattice of places that passes as many well-spread stops as its length allows.

    Where the places extend too far for that, the tour keeps to those around their middle.

    Args:
        places: [F, 2] connected places of a lattice, metres.
        step: spacing of the lattice, metres.
        length: maximum length of the tour, metres; a tour of a few steps may exceed it.

    Returns:
        [P, 2] places in order along the tour; the last equals the first.
    """
    graph, order = _graph(places, step), _spread_out(places)
    fewest, most = 3, len(order) + 1
    best = _tour(graph, order[:fewest])
    if _length(places[best]) > length:
        middle = int(np.linalg.norm(places - places.mean(0), axis=1).argmin())
        reach = max(length / 6, math.hypot(step, step))  # past three of these places no tour is longer than length
        near = dijkstra(graph, directed=False, indices=middle) <= reach + 1e-9
        if not near.all():
            return round_trip(places[near], step, length)
    while most - fewest > 1:
        count = (fewest + most) // 2
        tried = _tour(graph, order[:count])
        if _length(places[tried]) <= length:
            fewest, best = count, tried
        else:
            most = count
    return places[best]


def _graph(places: Floats, step: float) -> coo_matrix:
    """Build the graph of distances between neighbouring places of a lattice, including diagonal ones."""
    keys = np.round((places - places.min(0)) / step).astype(int)
    rows = np.full(keys.max(0) + 3, -1)  # with an empty border
    rows[tuple((keys + 1).T)] = np.arange(len(places))
    found: list[tuple[Sequence[int], Sequence[int], float]] = []
    for way in WAYS:
        there = rows[tuple((keys + 1 + way).T)]
        both = there >= 0
        found.append((np.flatnonzero(both).tolist(), there[both].tolist(), step * math.hypot(*way)))
    starts = [row for begin, _, _ in found for row in begin]
    ends = [row for _, end, _ in found for row in end]
    lengths = [length for begin, _, length in found for _ in begin]
    return coo_matrix((lengths, (starts, ends)), (len(places), len(places)))


def _spread_out(places: Floats) -> list[int]:
    """Order all places by farthest-point sampling: each is as far as possible from those before it."""
    order = [0]
    apart = np.linalg.norm(places - places[0], axis=1)
    while len(order) < len(places):
        order.append(int(apart.argmax()))
        apart = np.minimum(apart, np.linalg.norm(places - places[order[-1]], axis=1))
    return order


def _tour(graph: coo_matrix, stops: Sequence[int]) -> list[int]:
    """Find a short closed tour along edges of a graph past some of its nodes: nearest neighbour, then 2-opt."""
    distances, before = dijkstra(graph, directed=False, indices=list(stops), return_predecessors=True)
    apart = distances[:, stops]
    tour, left = [0], set(range(1, len(stops)))
    while left:
        tour.append(min(sorted(left), key=lambda stop: apart[tour[-1], stop]))
        left.remove(tour[-1])
    order = _untangled(np.array(tour), apart)
    way = [stops[order[0]]]
    for start, end in zip(order, [*order[1:], order[0]], strict=True):
        way += list(_steps(before[start], stops[start], stops[end]))
    return way


def _untangled(tour: NDArray[np.int_], apart: Floats) -> list[int]:
    """Improve a closed tour by 2-opt: reverse stretches of it as long as that makes it shorter."""
    improved = True
    while improved:
        improved = False
        for i in range(1, len(tour) - 1):
            ahead = np.roll(tour, -1)[i:]
            now = apart[tour[i - 1], tour[i]] + apart[tour[i:], ahead]
            turned = apart[tour[i - 1], tour[i:]] + apart[tour[i], ahead]
            gain = now - turned
            end = int(gain.argmax())
            if gain[end] > 1e-9:
                tour[i : i + end + 1] = tour[i : i + end + 1][::-1].copy()
                improved = True
    return [int(stop) for stop in tour]


def _steps(before: NDArray[np.int_], start: int, end: int) -> Iterator[int]:
    """Yield the nodes of a shortest path from Dijkstra's predecessors, without the first."""
    way = []
    while end != start:
        way.append(end)
        end = int(before[end])
    yield from reversed(way)


def _length(way: Floats) -> float:
    return float(np.linalg.norm(np.diff(way, axis=0), axis=1).sum())
