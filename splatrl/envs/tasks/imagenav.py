"""The imagenav task: go to the place from which an image was taken."""

import math
from collections.abc import Mapping

import torch
from torch import Tensor
from torchrl.data import TensorSpec, Unbounded

from splatrl.envs.tasks.base import Anywhere, Memory, Step, Verdict
from splatrl.envs.tasks.navigation import NavigationTask
from splatrl.envs.teachers.pathfinder import ROOM
from splatrl.geometry import wrapped

LOST = 16
"""Moves over the motion's ``reach`` after which the teacher considers its last look in the direction of the goal image
outdated; each takes one step of ``NavigateMotion``, and several of a motion by velocities."""
ROUNDING = 1e-3
"""Tolerance for the rounding of headings, radians."""


class ImageNav(NavigationTask):
    """Image-goal navigation (Zhu et al. 2017): the goal is given by the camera's view from there.

    Observation: ``imagegoal`` [B, H, W, 3] uint8, ``pixels``, and whatever else ``sensors`` returns. A stop within 1 m
        is a success, as in Mezghani et al. 2022.
    Memory: also ``unseen`` [B, 1] int64, steps since the robot last faced in the direction of the goal image, without
        those in which the teacher would have had it look and there was no room to.
    Everything else: see ``NavigationTask``.

    Example:
        >>> import splatrl
        >>> env = splatrl.make_env(["task=imagenav"], batch_size=[4])
        >>> env.reset()["imagegoal"].shape
        torch.Size([4, 64, 64, 3])
    """

    @property
    def memory_spec(self) -> Mapping[str, TensorSpec]:
        """Specs of the memory; see the class."""
        return {**super().memory_spec, "unseen": Unbounded(shape=(1,), dtype=torch.int64)}

    def episode(self, state: Tensor, row: Tensor, yaw: Tensor) -> dict[str, Tensor]:
        """Return what is remembered at the start of episodes with given goals; see ``NavigationTask.episode``."""
        begun = super().episode(state, row, yaw)
        return begun | {"unseen": self._unseen(state, begun, torch.full_like(begun["goal_row"], self.lost_after))}

    @property
    def around(self) -> int:
        """Steps within which a robot that can turn has faced in all directions, at half the speed of its turns."""
        steering = self.steering
        return 2 * math.ceil(math.tau / min(steering.angle_step, steering.angle_between) - 1e-6)

    @property
    def lost_after(self) -> int:
        """Steps after which the teacher considers its last look in the direction of the goal image outdated."""
        return round(LOST * self.steering.reach / self.steering.step)

    def judge(self, step: Step, anywhere: Anywhere) -> Verdict:
        """Judge a step; see ``Task.judge``."""
        verdict, unseen = super().judge(step, anywhere), step.memory["unseen"]
        waits = self._looks(unseen) & ~self._free(step.before, step.memory).unsqueeze(1)
        unseen = self._unseen(step.move.state, step.memory, unseen - waits.long())
        return verdict._replace(memory={**verdict.memory, "unseen": unseen})

    def teach(self, state: Tensor, memory: Memory) -> Tensor:
        """Return the actions of a teacher that has to look for the goal, so that a policy can imitate it from images.

        A robot that has not faced in the direction of the goal image for ``lost_after`` steps turns left until it does,
        since only then can it compare the two views. It then takes the shortest path, and faces that way again before
        it stops. Where it may not fit at every heading, it does not look around, and where it has not faced that way
        within ``around`` steps of looking, as it touches something or is moved by its turns to where it may not fit, it
        goes on without, and looks again after ``lost_after`` steps.
        """
        turn, near = self.led(state, memory)
        free, aside, unseen = self._free(state, memory), self._aside(state, memory), memory["unseen"].squeeze(1)
        lost, gave_up = free & self._looks(unseen), unseen >= self.lost_after + self.around
        turn = torch.where(lost, self.steering.angle_between, torch.where(near & free, aside, turn))
        return self.steering.toward(turn, near & ~lost & (self._alike(aside) | ~free | gave_up))

    def _looks(self, unseen: Tensor) -> Tensor:
        """Return whether the teacher looks around where there is room, by ``unseen``."""
        return unseen % (self.lost_after + self.around) >= self.lost_after

    def _free(self, state: Tensor, memory: Memory) -> Tensor:
        """Return whether the body fits at every heading: [B] bool."""
        room = self.geodesics.room(self._place(state), memory["goal_row"].squeeze(1))
        return torch.full_like(room, self.geodesics.round, dtype=torch.bool) | (room > ROOM)

    def _unseen(self, state: Tensor, memory: Memory, before: Tensor) -> Tensor:
        """Update the steps since robots last faced in the direction of the goal image: [B, 1] int64."""
        return torch.where(self._alike(self._aside(state, memory)).unsqueeze(1), 0, before + 1)

    def _aside(self, state: Tensor, memory: Memory) -> Tensor:
        """Return the angle from each robot's heading to its goal's yaw: [B] float32 radians in [-π, π]."""
        return wrapped(memory["goal"][:, 2] - self.motion.planar(state)[:, 2].float())

    def _alike(self, aside: Tensor) -> Tensor:
        """Return whether the angle to the goal's yaw is as small as discrete turns allow: [B] -> [B] bool."""
        return aside.abs() <= 0.5 * self.steering.angle_between + ROUNDING
