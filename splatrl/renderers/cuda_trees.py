"""The trees over models as CUDA kernels read them, and how several are joined, such as those of a scene's blocks."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

CLUSTER = np.dtype(
    [
        ("center", np.float32, 3),
        ("radius", np.float32),
        ("reach", np.float32),
        ("reach_scale", np.float32),
        ("error", np.float32),
        ("first_group", np.uint32),
        ("groups", np.uint32),
        ("skip", np.uint32),
    ]
)
"""``Cluster`` of native/tree.h."""


class Tree(NamedTuple):
    """A tree, as nodes in preorder.

    Attributes:
        clusters: [C] ``CLUSTER``; ``skip`` is an index from the first of them.
        group_bounds: [C, bytes] uint8, ``GroupBounds`` of native/tree.h for each node.
    """

    clusters: NDArray[Any]
    group_bounds: NDArray[np.uint8]


def joined(trees: Sequence[Tree]) -> Tree:
    """Join trees under common nodes, which show nothing and so are always opened; each tree is cut as before."""
    if len(trees) == 1:
        return trees[0]
    half = (len(trees) + 1) // 2
    first, second = joined(trees[:half]), joined(trees[half:])
    top = np.zeros(1, CLUSTER)
    for bound in ("reach", "reach_scale"):
        top[bound] = max(first.clusters[0][bound], second.clusters[0][bound])
    top["center"], top["radius"] = _ball_around([first.clusters[0], second.clusters[0]])
    top["error"], top["skip"] = np.inf, 1 + len(first.clusters) + len(second.clusters)
    below = moved(first.clusters, 1), moved(second.clusters, 1 + len(first.clusters))
    nothing = np.zeros_like(first.group_bounds[:1])
    return Tree(np.concatenate([top, *below]), np.concatenate([nothing, first.group_bounds, second.group_bounds]))


def moved(clusters: NDArray[Any], nodes: int, groups: int = 0) -> NDArray[Any]:
    """Return the nodes of a tree, [N] ``CLUSTER``, with the indices that hold once other trees are stored before it.

    Args:
        clusters: [N] ``CLUSTER``, the nodes of the tree.
        nodes: number of nodes that are stored before them.
        groups: number of groups of Gaussians that are stored before those of the tree.
    """
    clusters = clusters.copy()
    clusters["skip"] += np.uint32(nodes)
    clusters["first_group"] += np.uint32(groups)
    return clusters


def _ball_around(balls: Sequence[Any]) -> tuple[NDArray[np.float32], float]:
    """Return centre and radius of a ball around others, slightly loose so that rounding never cuts one off."""
    centers = np.array([ball["center"] for ball in balls], np.float64)
    radii = np.array([ball["radius"] for ball in balls], np.float64)
    low, high = (centers - radii[:, None]).min(0), (centers + radii[:, None]).max(0)
    center = (0.5 * (low + high)).astype(np.float32)
    return center, float((np.linalg.norm(centers - center, axis=1) + radii).max()) * 1.0001
