"""Models as arrays, in the layout that the renderer for CPUs draws them from: to keep in a file, whole or in part.

The arrays, of C nodes of the tree in preorder, and of G groups of 16 Gaussians, the scene's own before M merged ones:
    nodes: [C, 3] uint32, first group, number of groups, and the node after all below it.
    errors: [C] float32, metres by which what a node shows is displaced: 0 in a leaf, infinite where it shows nothing.
    bounds: [C, 6] float32, of all below a node: centre and radius of a ball around the means, the most standard
        deviations at which one shows, and the largest product of that and its longest axis; metres.
    group_bounds: [C, 6, 16] float32, the same of each of its groups.
    geometry: [G − M, 10, 16] float32, mean, lower triangular factor of the covariance row by row, and log2 of the
        opacity.
    merged: [M, 448] uint8, the same in half floats, how many Gaussians a merged one stands for, and the sum of their
        opacities: ``MergedGroup`` of native/kernel.h.
    colors: [G, 3 · harmonics, 16] half floats, as uint16.
    indices: [G, 16] uint32, which breaks ties of depth.
"""

import heapq
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import pad

from splatrl.native import _core
from splatrl.renderers.lod import build_levels, gaussian_arrays
from splatrl.scenes.cache import Arrays
from splatrl.scenes.gaussians import Gaussians

PACKED_VERSION = 3
"""Raise it when the arrays or what they are made from change: those in the cache are then made again."""

HUGE_PAGE = 2**21


def packed_model(
    gaussians: Gaussians, merge: bool, background: tuple[float, float, float], antialiased: bool, sh_degree: int = 0
) -> Arrays:
    """Pack Gaussians, with a tree over them.

    Args:
        gaussians: N of them, in the frame of the model.
        merge: whether inner nodes hold merged Gaussians, for levels of detail.
        background: colour that the renderer draws on, which colours are relative to.
        antialiased: how it draws.
        sh_degree: the least of the harmonics; those of a lower one are filled up with zeros.

    Raises:
        ValueError: for Gaussians that cannot be drawn.
    """
    arrays, degree = gaussian_arrays(gaussians), gaussians.sh_degree
    levels = build_levels(arrays, degree) if merge else None
    return packed_arrays(arrays, levels, max(degree, sh_degree), background, antialiased)


def packed_arrays(
    arrays: Mapping[str, Tensor],
    levels: Arrays | None,
    degree: int,
    background: tuple[float, float, float],
    antialiased: bool,
) -> Arrays:
    """Pack ``gaussian_arrays`` and their levels, with harmonics filled up to a degree; see ``packed_model``."""
    harmonics = arrays["sh"].shape[1]
    missing = (degree + 1) ** 2 - harmonics
    if missing > 0:
        arrays = {**arrays, "sh": pad(arrays["sh"], (0, 0, 0, missing))}
        if levels is not None:
            sh = levels["sh"].reshape(-1, harmonics, 3)
            levels = levels | {"sh": np.pad(sh, ((0, 0), (0, missing), (0, 0))).reshape(-1)}
    return dict(
        _core.pack_model(**arrays, degree=degree, levels=levels, background=background, antialiased=antialiased)
    )


def packed_bytes(arrays: Arrays) -> int:
    """Memory that a model takes in the core, which keeps large arrays in whole huge pages."""
    sizes = [values.nbytes for values in arrays.values()]
    return sum(size if size <= HUGE_PAGE // 2 else -(-size // HUGE_PAGE) * HUGE_PAGE for size in sizes)


def top_of(arrays: Arrays, groups: int) -> tuple[Arrays, float]:
    """The top of a model's tree: a model that shows the same where the tree is cut above or at the nodes that end it.

    Nodes are opened one by one, the one with the largest error first, until the top is full. Bounds and errors above
    the nodes that end it stay, so that a camera cuts both trees alike; those that end it are drawn whenever the cut
    comes so far.

    Args:
        arrays: of the whole model, with merged Gaussians.
        groups: the most that the top may have, if that is not fewer than those of the root.

    Returns:
        Its arrays, and the largest error of the nodes that end it, metres: 0 where the top is the whole model.
    """
    nodes, errors = arrays["nodes"].astype(np.int64), arrays["errors"]
    counts, skips = nodes[:, 1], nodes[:, 2]
    kept, opened = {0}, set[int]()
    ends, held = [(-float(errors[0]), 0)], int(counts[0])
    while ends and ends[0][0] < 0.0:
        node = ends[0][1]
        second = int(skips[node + 1])
        below = [node + 1, second] if second < skips[node] else [node + 1]
        held += int(counts[below].sum())
        if held > groups:
            break
        heapq.heappop(ends)
        opened.add(node)
        kept.update(below)
        for child in below:
            heapq.heappush(ends, (-float(errors[child]), child))
    order = np.array(sorted(kept))
    return _part(arrays, order, np.array([node not in opened for node in order])), -ends[0][0]


def _part(arrays: Arrays, order: NDArray[np.int64], ends: NDArray[np.bool_]) -> Arrays:
    """The nodes ``order`` of a tree, with all that they hold; those that are ``ends`` have nothing below them."""
    nodes, own = arrays["nodes"].astype(np.int64), len(arrays["geometry"])
    first, counts, skips = nodes[order].T
    ranges = [np.arange(start, start + count) for start, count in zip(first, counts, strict=True)]
    groups = np.sort(np.concatenate(ranges))
    new_nodes = [np.searchsorted(groups, first), counts, np.searchsorted(order, skips)]
    ranks = np.unique(arrays["indices"][groups], return_inverse=True)[1]  # the order alone matters
    part: dict[str, Any] = {
        "geometry": arrays["geometry"][groups[groups < own]],
        "merged": arrays["merged"][groups[groups >= own] - own],
        "colors": arrays["colors"][groups],
    }
    return part | {
        "nodes": np.stack(new_nodes, 1).astype(np.uint32),
        "errors": np.where(ends, np.float32(0.0), arrays["errors"][order]),
        "bounds": arrays["bounds"][order],
        "group_bounds": arrays["group_bounds"][order],
        "indices": ranks.reshape(-1, 16).astype(np.uint32),
    }
