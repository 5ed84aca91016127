"""Explore: visit as many cells of the floor as you can."""

import torch
from torch import Tensor
from torchrl.data import Categorical

from splatrl.envs.tasks import Memory, Step, TaskModule, Verdict
from splatrl.motions import PlannedMotion


class Explore(TaskModule):
    """Rewards 1 for each cell that is new in the episode, which ends only after ``max_steps``."""

    def __init__(self, motion: PlannedMotion, cell: float = 0.5, max_steps: int = 100):
        super().__init__(motion, max_steps)
        places = motion.planar(motion.states())[:, :2]
        self.cell, corner = cell, places.amin(0)
        self.columns, self.rows = ((places.amax(0) - corner) / cell).long().add(1).tolist()
        self.register_buffer("corner", corner, persistent=False)

    @property
    def memory_spec(self) -> dict[str, Categorical]:
        return {"visited": Categorical(2, shape=(self.columns * self.rows,), dtype=torch.bool)}

    def begin(self, state: Tensor, anywhere: object) -> Memory:
        return {"visited": self._here(state)}

    def judge(self, step: Step, anywhere: object) -> Verdict:
        here, visited = self._here(step.move.state), step.memory["visited"]
        fresh = (here & ~visited).any(1, keepdim=True)
        never = torch.zeros_like(fresh)
        return Verdict(fresh.float(), never, never.long(), {"visited": visited | here})

    def _here(self, state: Tensor) -> Tensor:
        column, row = ((self.motion.planar(state)[:, :2] - self.corner) / self.cell).long().unbind(1)
        cells = torch.arange(self.columns * self.rows, device=state.device)
        return (column * self.rows + row).unsqueeze(1) == cells
