"""Clearing: go to where there is most room, wherever that is in a scene."""

from torch import Tensor

from splatrl.envs.tasks import OutcomeTask, Rewards
from splatrl.motions import Fits, PlannedMotion, Site, narrowed


class Clearing(OutcomeTask):
    """Succeeds within ``near`` metres of the roomiest place; episodes begin at least ``apart`` metres from it."""

    of_scene = ("place",)

    def __init__(self, motion: PlannedMotion, near: float = 0.3, apart: float = 1.0, max_steps: int = 100):
        super().__init__(motion, Rewards(), max_steps)
        self.near, self.apart = near, apart
        self.register_buffer("place", None, persistent=False)

    def settle(self, site: Site, fits: Fits) -> Fits:
        fits = super().settle(site, fits)
        poses = self.motion.body_to_world(self.motion.states())
        places = poses[fits(poses), :3, 3]
        if not len(places):
            raise ValueError("expected room for the robot, found none")
        place = self.place = places[site.checker.clearance(places).argmax(), :2]
        return narrowed(fits, lambda poses: (poses[:, :2, 3] - place).norm(dim=1) >= self.apart)

    def reached(self, state: Tensor) -> Tensor | None:
        if self.place is None:  # not settled
            return None
        return (self.motion.planar(state)[:, :2] - self.place).norm(dim=1) <= self.near
