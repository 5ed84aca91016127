"""The graph of states and actions on a lattice, against which plans are checked."""

import torch
from torch import Tensor

from splatrl.curriculum import UNREACHABLE, Plan
from splatrl.motions import FiniteMotion


def successors(plan: Plan) -> Tensor:
    """Return the row of the state that each action leads to: [S, A] int64, UNREACHABLE where the move is blocked."""
    motion, states = plan.motion, plan.states
    assert isinstance(motion, FiniteMotion)
    rows_after = torch.full((len(states), len(plan.actions)), UNREACHABLE)
    for column, action in enumerate(plan.actions):
        ahead = motion.advance(states, action.expand(len(states)))
        rows = (plan.free & motion.inside(ahead)).nonzero().squeeze(1)
        rows = rows[plan.free[motion.index(ahead[rows])]]
        start, end = motion.body_to_world(states[rows]), motion.body_to_world(ahead[rows])
        rows = rows[~plan.checker.sweeps(start, end)]
        rows_after[rows, column] = motion.index(ahead[rows])
    return rows_after
