"""A slow level-of-detail tree, straight from its definition: the readable twin of ``splatrl/native/levels.cpp``.

Here a merged Gaussian is the list of the Gaussians that it represents, and all its values are computed from these in
float64. The C++ code merges in pairs, in float32.
"""

import numpy as np
from numpy.typing import NDArray

from splatrl.scenes.cache import Arrays
from splatrl.spherical_harmonics import C0

CAPACITY = 256
"""Maximum number of Gaussians per node."""
RUN = 16
"""Neighbours that are adjacent in memory, in any order."""
BUCKET = 64
"""Neighbours among which partners for merging are sought."""
LEAST_CONTRAST = 0.2
"""Contrast that is added to that of the colours, so that merging equal colours has a cost, too."""

Numbers = NDArray[np.float64]
Group = NDArray[np.int64]  # indices of the Gaussians that a merged one represents


def tree_of(means: Numbers, axes: Numbers, opacities: Numbers, sh: Numbers) -> Arrays:
    """Build the tree; see ``splatrl.renderers.lod.build_levels`` for arguments and result."""
    return _Twin(means, axes, opacities, sh).arrays()


class _Twin:
    def __init__(self, means: Numbers, axes: Numbers, opacities: Numbers, sh: Numbers) -> None:
        self.means, self.covariances, self.opacities, self.sh = means, axes @ axes.swapaxes(1, 2), opacities, sh
        self.masses = opacities * projected_area(axes)
        self.order: list[int] = []
        self.nodes: list[list[int]] = []
        self.errors: list[float] = []
        self.merged: list[Group] = []
        self.top(self.build(np.arange(len(means))))

    def build(self, members: Group) -> list[Group]:
        """Append the node over some Gaussians and all nodes below it, and return the groups that the node shows."""
        node = len(self.nodes)
        self.nodes.append([0, 0, 0, 0])
        self.errors.append(0.0)
        if len(members) <= CAPACITY:
            members = members[in_space(self.means[members], RUN)]
            groups = [np.array([member]) for member in members]
            self.nodes[node] = [len(self.order), len(members), 0, 1]
            self.order.extend(members.tolist())
        else:
            left, right = split(self.means[members], CAPACITY)
            groups = self.merge(self.build(members[left]) + self.build(members[right]))
            self.nodes[node] = [len(self.merged), len(groups), 0, 0]
            self.errors[node] = self.error(groups)
            self.merged.extend(groups)
        self.nodes[node][2] = len(self.nodes)  # the node after the subtree of this one
        return groups

    def top(self, groups: list[Group]) -> None:
        """Add nodes above the root, each with three quarters of the groups below it, rounded down to whole runs."""
        while (target := len(groups) * 3 // 4 // RUN * RUN) > 0:
            groups = self.merge(groups, target)
            self.nodes = [[first, count, skip + 1, leaf] for first, count, skip, leaf in self.nodes]
            self.nodes.insert(0, [len(self.merged), len(groups), len(self.nodes) + 1, 0])
            self.errors.insert(0, self.error(groups))
            self.merged.extend(groups)

    def merge(self, groups: list[Group], target: int = CAPACITY) -> list[Group]:
        """Merge the cheapest pair of neighbours repeatedly, until ``target`` groups are left."""
        groups = [groups[i] for i in in_space(self.centers(groups), BUCKET)]
        masses, centers, colors = (np.array(values) for values in zip(*map(self.summary, groups), strict=True))
        bucket = np.arange(len(groups)) // BUCKET
        alive = np.ones(len(groups), bool)

        def costs(i: int) -> Numbers:
            """Return the cost of merging i with each group: mass that moves · distance² · contrast of colours²."""
            moved = masses[i] * masses / (masses[i] + masses)
            distances, contrasts = (((values[i] - values) ** 2).sum(1) for values in (centers, colors))
            possible = alive & (bucket == bucket[i]) & (np.arange(len(groups)) != i)
            return np.where(possible, moved * distances * (LEAST_CONTRAST**2 + contrasts), np.inf)

        table = np.array([costs(i) for i in range(len(groups))])
        while alive.sum() > target and table.min() < np.inf:
            i, j = sorted(np.unravel_index(table.argmin(), table.shape))
            groups[i] = np.concatenate([groups[i], groups[j]])
            masses[i], centers[i], colors[i] = self.summary(groups[i])
            alive[j] = False
            table[j], table[:, j] = np.inf, np.inf
            table[i] = table[:, i] = costs(i)
        groups = [group for group, lives in zip(groups, alive, strict=True) if lives]
        return [groups[i] for i in in_space(self.centers(groups), RUN)]

    def summary(self, group: Group) -> tuple[float, Numbers, Numbers]:
        """Return mass, mean and mean colour of a group."""
        return self.masses[group].sum(), self.mean(self.means, group), C0 * self.mean(self.sh[:, 0], group)

    def mean(self, values: Numbers, group: Group) -> Numbers:
        """Return the mean over the group's members, weighted by mass."""
        return np.average(values[group], axis=0, weights=self.masses[group])

    def centers(self, groups: list[Group]) -> Numbers:
        return np.array([self.mean(self.means, group) for group in groups])

    def covariance(self, group: Group) -> Numbers:
        """Return the group's covariance: the mean of its members' covariances plus the covariance of their means."""
        offsets = self.means - self.mean(self.means, group)
        return self.mean(self.covariances + offsets[:, :, None] * offsets[:, None], group)

    def error(self, groups: list[Group]) -> float:
        """Return the root mean square distance of members from their merged mean, weighted by mass, metres."""
        squares = np.concatenate([((self.means[g] - self.mean(self.means, g)) ** 2).sum(1) for g in groups])
        return float(np.sqrt(np.average(squares, weights=self.masses[np.concatenate(groups)])))

    def arrays(self) -> Arrays:
        covariances = np.array([self.covariance(group) for group in self.merged]).reshape(-1, 3, 3)
        axes = np.linalg.cholesky(covariances)
        masses = np.array([self.masses[group].sum() for group in self.merged])
        return {
            "order": np.array(self.order),
            "nodes": np.array(self.nodes),
            "errors": np.array(self.errors),
            "means": self.centers(self.merged),
            "axes": axes,
            "opacities": masses / projected_area(axes),
            "sh": np.array([self.mean(self.sh, group) for group in self.merged]),
            "members": masses**2 / np.array([(self.masses[group] ** 2).sum() for group in self.merged]),
            "sums": np.array([self.opacities[group].sum() for group in self.merged]),
        }


def projected_area(axes: Numbers) -> Numbers:
    """Return the area over π of the ellipses that Gaussians project to: root mean square over all directions.

    ``axes`` [N, 3, 3] are factors of the covariances. The cross products of their columns are the minors.
    """
    minors = np.cross(axes, np.roll(axes, 1, axis=2), axis=1)
    return np.sqrt((minors**2).sum((1, 2)) / 3.0)


def split(points: Numbers, multiple: int) -> tuple[Group, Group]:
    """Split points along an axis, at a multiple, such that the sum of count times box diagonal is minimal.

    Neither part has less than a sixteenth of the leaves that all points fill.
    """
    leaves = -(-len(points) // multiple)
    fewest = max(1, leaves // 16)

    def cost(group: Group) -> float:
        return len(group) * float(np.linalg.norm(np.ptp(points[group], axis=0)))

    orders = [np.argsort(points[:, axis], kind="stable") for axis in range(3)]
    cuts = [(order[:at], order[at:]) for order in orders for at in multiple * np.arange(fewest, leaves - fewest + 1)]
    return min(cuts, key=lambda cut: cost(cut[0]) + cost(cut[1]))


def halves(points: Numbers, multiple: int) -> tuple[Group, Group]:
    """Split points into two halves along the longest axis of their bounding box, at a multiple."""
    along = points[:, np.ptp(points, axis=0).argmax()]
    parts = -(-len(points) // multiple)
    middle = (parts + 1) // 2 * multiple
    order = np.argsort(along, kind="stable")
    return order[:middle], order[middle:]


def in_space(points: Numbers, run: int) -> Group:
    """Return an order in which neighbours follow each other, by halving until only runs are left."""
    if len(points) <= run:
        return np.arange(len(points))
    return np.concatenate([half[in_space(points[half], run)] for half in halves(points, run)])
