"""Geodesic distances from any place on the ground to goals, along the shortest way that a body fits through."""

from collections.abc import Sequence
from functools import cached_property
from typing import Any, Self, cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from splatrl.bodies import Box
from splatrl.collision.several import SeveralCheckers
from splatrl.curriculum.ground import Ground
from splatrl.motions.base import PlannedMotion
from splatrl.per_scene import SelfStacking, rows_of, stacked

MOST_DISTANCES = 2**29
"""Most distances, nodes times goals, to the goals of one scene or those of a file: each takes 4 bytes."""
AT_ONCE = 2**20
"""Most distances that ``Geodesics.within`` looks up at once, unless there are more places."""
NEAR = 2.0
"""Distance from a goal within which the straight-line distance is used, cells."""


class Geodesics(SelfStacking):
    """Look-up of geodesic distances to goals in one scene or several; a goal is a row that belongs to one scene.

    Attributes:
        grounds: the ground of each scene.
        for_training: number of goals per scene that are drawn in training; they come first.
        for_tests: number of goals per scene that are drawn in tests; they come next.
        motion: how robots move in each scene, ``stacked``.
    """

    motion: PlannedMotion
    metres: Tensor  # [sum of X · Y] float32, the distance fields of all goals, one after the other
    first: Tensor  # [G] int64, where each goal's field begins in ``metres``
    shape: Tensor  # [G, 2] int64
    corner: Tensor  # [G, 2] float32
    goals: Tensor  # [G, 2] float32, x and y
    begins: Tensor  # [S] int64, the first goal of each scene
    open: Tensor  # [sum of X · Y] bool, whether a node is open, one scene after the other
    first_open: Tensor  # [G] int64, where the nodes of each goal's scene begin in ``open``

    def __init__(
        self,
        grounds: Sequence[Ground],
        goals: Sequence[NDArray[np.int64]],
        for_training: int,
        metres: Tensor | None = None,
    ):
        """Compute the distances to the goal nodes of each ground, unless ``metres`` holds them."""
        super().__init__()
        self.grounds, self.for_training, self.cell = tuple(grounds), for_training, grounds[0].cell
        self.motion = cast(PlannedMotion, stacked([cast(nn.Module, each.motion) for each in grounds]))
        self._scene: Tensor | None = None
        self._nodes = [np.asarray(nodes, np.int64) for nodes in goals]
        counts = np.array([len(nodes) for nodes in goals])
        sizes = np.repeat([each.shape[0] * each.shape[1] for each in grounds], counts)
        places = [each.place(nodes) for each, nodes in zip(grounds, self._nodes, strict=True)]
        if metres is None:
            fields = [each.distances(nodes).reshape(-1) for each, nodes in zip(grounds, self._nodes, strict=True)]
            metres = torch.from_numpy(np.concatenate(fields))
        self.register_buffer("metres", metres, persistent=False)
        self._keep("first", np.cumsum(sizes) - sizes)
        self._keep("shape", np.repeat([each.shape for each in grounds], counts, 0))
        self._keep("corner", np.repeat([each.corner for each in grounds], counts, 0).astype(np.float32))
        self._keep("goals", np.concatenate(places).astype(np.float32))
        self._keep("begins", np.cumsum(counts) - counts)
        nodes_of = np.array([each.open.size for each in grounds])
        self._keep("open", np.concatenate([each.open for each in grounds]))
        self._keep("first_open", np.repeat(np.cumsum(nodes_of) - nodes_of, counts))
        self.for_tests = int(counts.min()) - for_training

    @property
    def longest(self) -> float:
        """Length of the longest of all shortest paths to a goal, metres."""
        return float(self.metres[self.metres.isfinite()].max())

    @property
    def round(self) -> bool:
        """Whether the body is round about z, so that it can turn wherever it fits."""
        return not isinstance(self.grounds[0].checker.body, Box)

    @cached_property
    def _checkers(self) -> SeveralCheckers:
        """The checkers of all scenes."""
        return SeveralCheckers([each.checker for each in self.grounds])

    def _keep(self, name: str, values: NDArray[Any]) -> None:
        self.register_buffer(name, torch.from_numpy(values), persistent=False)

    @classmethod
    def drawn(cls, place: Ground, for_training: int, for_tests: int, seed: int) -> "Geodesics":
        """Draw goals anywhere in the largest connected component of a ground, from a seed.

        Raises:
            ValueError: if there are fewer free places than goals, or more than ``MOST_DISTANCES`` distances to them.
        """
        nodes, wanted = np.flatnonzero(place.open), for_training + for_tests
        most = min(len(nodes), MOST_DISTANCES // place.open.size)
        if wanted > most:
            why = "one per free place" if most == len(nodes) else f"for a grid of {place.open.size:,} nodes"
            raise ValueError(f"task.goals: expected at most {most} goals, {why}, got {wanted}")
        return cls([place], [np.random.default_rng(seed).choice(nodes, wanted, replace=False)], for_training)

    @classmethod
    def joined(cls, scenes: Sequence[Self]) -> Self:
        """Join the geodesics of several scenes, each given by its own."""
        metres = torch.cat([each.metres for each in scenes])
        grounds, nodes = [each.grounds[0] for each in scenes], [each._nodes[0] for each in scenes]
        return cls(grounds, nodes, scenes[0].for_training, metres).to(metres.device)

    def at(self, scene: Tensor) -> Self:
        """Return a view for rows in given scenes, [B] int64: ``draw`` then takes each row's goal from its scene."""
        result = nn.Module.__new__(type(self))
        result.__dict__ = {**self.__dict__, "_scene": scene}
        return result

    def with_goals(self, places: NDArray[np.float64], scene: NDArray[np.int64]) -> "tuple[Geodesics, Tensor]":
        """Return a copy with further goals at places [N, 2] of scenes [N], and the rows of these goals, [N] int64.

        Raises:
            ValueError: for a place where the robot does not fit, or outside the largest connected component, or for
                more than ``MOST_DISTANCES`` distances to further goals.
        """
        node, fits = np.zeros(len(places), np.int64), np.ones(len(places), bool)
        for number, each in enumerate(self.grounds):
            mine = np.flatnonzero(scene == number)
            node[mine] = each.node(places[mine])
            off = np.abs(each.place(node[mine]) - places[mine]).max(1, initial=0.0)
            fits[mine] = each.open[node[mine]] & (off <= each.cell)
        if not fits.all():
            wrong = int(fits.argmin())
            got = np.round(places[wrong], 3).tolist()
            raise ValueError(f"goal of episode {wrong}: expected a free place, got {got}")
        further = [np.setdiff1d(node[scene == number], own) for number, own in enumerate(self._nodes)]
        needed = sum(len(new) * each.open.size for new, each in zip(further, self.grounds, strict=True))
        if needed > MOST_DISTANCES:
            raise ValueError(
                f"goals: expected at most {MOST_DISTANCES:,} distances to further goals, got {needed:,} to "
                f"{sum(map(len, further)):,}; type starts=... for the first episodes alone, or a larger task.cell"
            )
        nodes = [np.concatenate(pair) for pair in zip(self._nodes, further, strict=True)]
        result = Geodesics(self.grounds, nodes, self.for_training)
        begins, rows = result.begins.cpu().numpy(), np.zeros(len(places), np.int64)
        for number, all_of in enumerate(nodes):
            mine, order = scene == number, all_of.argsort()
            rows[mine] = begins[number] + order[np.searchsorted(all_of, node[mine], sorter=order)]
        return result.to(self.metres.device), torch.from_numpy(rows)

    def distance(self, place: Tensor, goal: Tensor) -> Tensor:
        """Return the length of the shortest path from places to goals, interpolated between nodes.

        Paths lead over nodes, so those past obstacles are longer than the true ones, by up to about two cells. A place
        beyond the grid is as far as the nearest one on its edge, plus the straight distance to that.

        Args:
            place: [B, 2] float32, metres.
            goal: [B] int64, rows of goals.

        Returns:
            [B] float32, metres.
        """
        straight = (place - self.goals[goal]).norm(dim=1)
        corner = self.corner[goal]
        edge = torch.minimum(torch.maximum(place, corner), corner + self.cell * (self.shape[goal] - 1))
        found = self._between_nodes(self.metres, self.first, place, goal) + (place - edge).norm(dim=1)
        return torch.where(straight < NEAR * self.cell, straight, torch.maximum(found, straight))

    def room(self, place: Tensor, goal: Tensor) -> Tensor:
        """Return whether the body fits at places in the goals' scenes, interpolated between nodes.

        Args:
            place: [B, 2] float32, metres.
            goal: [B] int64, rows of goals.

        Returns:
            [B] float32, 1 where all surrounding nodes are open, 0 where none of them is and outside the bounds.
        """
        at = (place - self.corner[goal]) / self.cell
        inside = ((at >= 0) & (at <= self.shape[goal] - 1)).all(1)
        return torch.where(inside, self._between_nodes(self.open, self.first_open, place, goal), 0.0)

    def clear(self, start: Tensor, end: Tensor, goal: Tensor) -> Tensor:
        """Return whether the body touches nothing between poses in the goals' scenes, and ends within the bounds.

        Args:
            start: [B, N, 3] float32, x and y in metres and yaw in radians.
            end: [B, N, 3] float32, likewise.
            goal: [B] int64, rows of goals.

        Returns:
            [B, N] bool.
        """
        scene = (torch.searchsorted(self.begins, goal, right=True) - 1).repeat_interleave(start.shape[1])
        motion = cast(PlannedMotion, rows_of(cast(nn.Module, self.motion), scene))
        begins, ends = (motion.nearest(each.flatten(0, 1).double()) for each in (start, end))
        touched = self._checkers.at(scene).sweeps(motion.body_to_world(begins), motion.body_to_world(ends))
        return (motion.inside(ends) & ~touched).view(start.shape[:2])

    def reachable(self, place: Tensor, goal: Tensor) -> Tensor:
        """Return whether paths lead from free places, next to open nodes, to goals: [B, 2], [B] int64 -> [B] bool."""
        return self._between_nodes(self.open, self.first_open, place, goal) > 0.0

    def _between_nodes(self, values: Tensor, first: Tensor, place: Tensor, goal: Tensor) -> Tensor:
        """Interpolate node values, which begin at ``first`` [G] for each goal, at places [B, 2]: [B] float32."""
        shape = self.shape[goal]
        at = (place - self.corner[goal]) / self.cell
        low = torch.minimum(at.floor().long().clamp_min(0), shape - 2)
        share = (at - low).clamp(0.0, 1.0)
        begin = first[goal] + low[:, 0] * shape[:, 1] + low[:, 1]
        found = torch.zeros_like(share[:, 0])
        for x, y in ((0, 0), (0, 1), (1, 0), (1, 1)):
            weight = (share[:, 0] if x else 1.0 - share[:, 0]) * (share[:, 1] if y else 1.0 - share[:, 1])
            found = found + weight * values[begin + x * shape[:, 1] + y]
        return found

    def within(self, place: Tensor, least: float, most: float) -> Tensor:
        """Return whether some training goal of a single scene is in a range of distances: [N, 2] -> [N] bool."""
        found = torch.zeros(len(place), dtype=torch.bool, device=place.device)
        done, count = 0, 1
        while done < self.for_training:  # twice as many goals at a time, as most places need no more than the first
            left = (~found).nonzero().squeeze(1)
            goals = torch.arange(done, min(done + count, self.for_training), device=place.device)
            done, count = done + count, max(1, min(2 * count, AT_ONCE // max(len(left), 1)))
            far = self.distance(place[left].repeat_interleave(len(goals), 0), goals.repeat(len(left)))
            found[left] = ((far >= least) & (far <= most)).view(len(left), len(goals)).any(1)
        return found

    def draw(self, place: Tensor, least: float, most: float, generator: torch.Generator, tests: bool = False) -> Tensor:
        """Draw a goal for each place, within a range of distances if there is one there, else any.

        Args:
            place: [B, 2] float32, metres.
            least: shortest distance, metres.
            most: longest distance, metres.
            generator: source of randomness; always consumes equally many numbers.
            tests: whether to draw from the goals for tests.

        Returns:
            [B] int64, rows of goals.
        """
        count, skipped = (self.for_tests, self.for_training) if tests else (self.for_training, 0)
        own = torch.arange(skipped, skipped + count, device=place.device)
        begins = self.begins[:1].expand(len(place)) if self._scene is None else self.begins.index_select(0, self._scene)
        rows = begins.unsqueeze(1) + own
        far = self.distance(place.repeat_interleave(count, 0), rows.flatten()).view(len(place), count)
        drawn = torch.rand(len(place), count, generator=generator, device=place.device)
        chosen = torch.where((far >= least) & (far <= most), 1.0 + drawn, drawn).argmax(1)
        return rows.gather(1, chosen.unsqueeze(1)).squeeze(1)
