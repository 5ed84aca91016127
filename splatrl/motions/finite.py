"""Motions over a finite set of states, given by integer indices: the base of lattice motions."""

import math
from abc import abstractmethod
from collections.abc import Sequence

import torch
from torch import Tensor
from torchrl.data import Bounded, Categorical

from splatrl.motions.base import Taps
from splatrl.motions.module import SweptMotion
from splatrl.motions.size import require_few

PAIRS = 2**22
"""Pairs of a pose and a state that ``nearest`` compares at once; bounds memory."""


class FiniteMotion(SweptMotion):
    """A motion whose states are [..., D] int64 indices from 0 to below ``shape``; an action adds one of ``moves``.

    Shortest paths are exact, because every state is a node.

    Args:
        shape: number of values of each index.
        moves: [A][D], the indices that each action adds.
        action_names: a name for each action.
        step: longest distance that an action moves the robot, metres.
        angle_step: largest angle that an action turns the robot, radians.
        height: z of every pose, metres; None if the height varies.

    Raises:
        ValueError: for more than ``MOST_STATES`` states.
    """

    moves: Tensor  # [A, D] int64
    counts: Tensor  # [D] int64, the shape; [S, D] for several scenes
    of_scene: tuple[str, ...] = ("shape", "counts", "height")

    def __init__(
        self,
        shape: Sequence[int],
        moves: Sequence[Sequence[int]],
        action_names: Sequence[str],
        step: float,
        angle_step: float,
        height: float | None,
    ):
        super().__init__()
        require_few(shape)
        assert len(action_names) == len(moves), (action_names, moves)
        self.shape, self.action_names = tuple(shape), tuple(action_names)
        self.step, self.angle_step, self.height = step, angle_step, height
        self.register_buffer("moves", torch.tensor(moves, dtype=torch.int64), persistent=False)
        self.register_buffer("counts", torch.tensor(self.shape), persistent=False)

    @property
    def action_spec(self) -> Categorical:
        """Spec of one robot's action: the index of a move; no batch."""
        return Categorical(len(self.moves), shape=(), dtype=torch.int64)

    @property
    def state_spec(self) -> Bounded:
        """Spec of one robot's state: indices [D], up to those of the largest of several scenes; no batch."""
        high = self.counts.reshape(-1, len(self.shape)).amax(0) - 1
        return Bounded(low=torch.zeros_like(high), high=high, shape=high.shape, dtype=torch.int64)

    def states(self) -> Tensor:
        """Return every state, in the order of ``index``: [S, D] int64."""
        return torch.cartesian_prod(*(torch.arange(n, device=self.moves.device) for n in self.shape))

    def actions(self) -> Tensor:
        """Return the actions from which paths are made, which are all of them: [A] int64."""
        return torch.arange(len(self.moves), device=self.moves.device)

    def index(self, state: Tensor) -> Tensor:
        """Return the row of each state in ``states()``: [..., D] int64, inside the lattice -> [...] int64."""
        row = state[..., 0]
        for axis, count in enumerate(self.shape[1:], 1):
            row = row * count + state[..., axis]
        return row

    def nodes(self) -> Tensor:
        """Return the nodes, which are all states: [S, D] int64."""
        return self.states()

    def taps(self, state: Tensor) -> Taps:
        """Return the single node that is the state itself: [N, D] int64, inside the lattice -> taps of [N, 1]."""
        node = self.index(state).unsqueeze(1)
        return Taps(node, torch.ones_like(node, dtype=torch.float32))

    def nearest(self, planar: Tensor) -> Tensor:
        """Return the nearest states in steps and angle steps: [N, 3] float64 x, y and yaw -> [N, D] int64."""
        states = self.states()
        places = self.planar(states).to(planar.device)

        def rows(some: Tensor) -> Tensor:
            away = (some.unsqueeze(1) - places).abs()
            turn = torch.minimum(away[..., 2], math.tau - away[..., 2]) / self.angle_step
            return torch.hypot(away[..., :2].norm(dim=-1) / self.step, turn).argmin(1)

        return states[torch.cat([rows(some) for some in planar.split(max(1, PAIRS // len(states)))])]

    @abstractmethod
    def planar(self, state: Tensor) -> Tensor:
        """Return position and heading of states; see ``Motion``."""
