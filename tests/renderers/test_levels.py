"""The level-of-detail tree, compared with its readable twin."""

import numpy as np
import pytest
from numpy.typing import NDArray

from splatrl.renderers.lod import build_levels, gaussian_arrays
from splatrl.scenes.cache import Arrays
from tests.renderers.cases import random_gaussians
from tests.renderers.levels_twin import RUN, tree_of

MERGED = {"means": (3,), "axes": (3, 3), "opacities": (), "sh": (-1, 3), "members": (), "sums": ()}
"""Names of the values of each merged Gaussian, and their shapes; -1 is the number of harmonics."""


def sorted_in_runs(nodes: NDArray[np.uint32], values: NDArray[np.float64], leaf: bool) -> NDArray[np.int64]:
    """Return an order of rows that sorts each run by value, since the order within a run is arbitrary."""
    order = np.arange(len(values))
    for first, count, _, kind in nodes.astype(np.int64):
        for start in range(first, first + count, RUN) if kind == leaf else ():
            run = slice(start, min(start + RUN, first + count))
            order[run] = order[run][values[run].argsort()]
    return order


def tidied(levels: Arrays, harmonics: int) -> Arrays:
    """Return the same tree with its rows reshaped, in an order that does not depend on which code built it."""
    nodes, order = levels["nodes"].reshape(-1, 4), levels["order"]
    rows = {
        name: levels[name].reshape(-1, *(harmonics if size < 0 else size for size in shape))
        for name, shape in MERGED.items()
    }
    merged = sorted_in_runs(nodes, rows["means"][:, 0], leaf=False)
    order = order[sorted_in_runs(nodes, order, leaf=True)]
    return {"nodes": nodes, "order": order, "errors": levels["errors"]} | {n: v[merged] for n, v in rows.items()}


@pytest.mark.parametrize(("seed", "count", "degree"), [(0, 200, 0), (1, 300, 2), (2, 800, 1)])
def test_the_tree_equals_that_of_its_readable_twin(seed: int, count: int, degree: int) -> None:
    arrays = gaussian_arrays(random_gaussians(seed, count, degree))
    built = tidied(build_levels(arrays, degree), (degree + 1) ** 2)
    expected = tidied(tree_of(*(value.double().numpy() for value in arrays.values())), (degree + 1) ** 2)
    assert np.array_equal(built["nodes"], expected["nodes"])
    assert np.array_equal(built["order"], expected["order"])
    assert built["nodes"][0].tolist() == [len(built["means"]) - 16, 16, len(built["nodes"]), 0]
    for name in ("errors", *MERGED):
        np.testing.assert_allclose(built[name], expected[name], rtol=1e-4, atol=2e-5, err_msg=name)
