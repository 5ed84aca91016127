"""Demonstrations as data: the frames of complete episodes, concatenated."""

import warnings
from dataclasses import dataclass

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from splatrl.envs.world import World, Worlds

AFTER = ("state", "reward", "done", "terminated", "truncated", "outcome", "success")
"""Keys of a step's result that are stored, under ``"next"``."""

FASTEST = 1000
"""Maximum number of frames per second."""


@dataclass(frozen=True)
class Demonstrations:
    """N frames of E episodes, in order, under TorchRL's keys; the view after an episode's last action is not stored.

    Attributes:
        frames: batch of size [N] with ``episode`` [N] int64, numbered from 0; ``frame`` [N] int64, the number within
            the episode; ``pixels`` [N, H, W, 3] uint8, a single view; ``action`` and ``state``; the sensor readings and
            what sensors, task and transforms remember; and the keys in ``AFTER`` under ``"next"``. Where the planner
            demonstrated discrete actions, also ``optimal`` [N, A] bool, which marks every action that would have been
            right.
        action_names: names of the discrete actions, in order; empty for continuous actions.
        fps: frames per second, a whole number: of simulated time, rounded, if there is physics.
        repeats: number of times that the robot carried out each action; see ``FrameSkip``.
        scene: fingerprint of the scene, the ``digest`` of its world; None if it is not known.
    """

    frames: TensorDictBase
    action_names: tuple[str, ...]
    fps: int = 10
    repeats: int = 1
    scene: str | None = None

    def __len__(self) -> int:
        """Number of frames."""
        return len(self.frames)

    @property
    def starts(self) -> Tensor:
        """Row of each episode's first frame: [E] int64."""
        return (self.frames["frame"] == 0).nonzero().squeeze(1)

    @property
    def lengths(self) -> Tensor:
        """Number of frames in each episode: [E] int64."""
        return torch.diff(self.starts, append=torch.tensor([len(self)]))

    def stacked(self, views: int) -> Tensor:
        """Stack the last views of each frame, repeating an episode's first view: [N, H, W, 3 · views] uint8."""
        rows = torch.arange(len(self))
        first = rows - self.frames["frame"]
        seen = [self.frames["pixels"][torch.maximum(rows - back, first)] for back in reversed(range(views))]
        return torch.cat(seen, -1)

    def returns(self, gamma: float) -> Tensor:
        """Return the discounted sum of rewards from each frame to the end of its episode: [N] float32."""
        reward, done = self.frames["next", "reward"].squeeze(1), self.frames["next", "done"].squeeze(1)
        result, after = torch.zeros_like(reward), torch.zeros(())
        for row in range(len(self) - 1, -1, -1):
            after = reward[row] + gamma * torch.where(done[row], 0.0, after)
            result[row] = after
        return result

    def warn_of_another_scene(self, world: World | Worlds) -> None:
        """Warn if the scene is none of a world's: another one, or one whose files have changed since."""
        if self.scene is not None and self.scene not in [one.digest for one in world.worlds]:
            warnings.warn(
                f"demos: recorded in another scene than {world.name} as it is now; its Gaussians or free space differ",
                stacklevel=2,
            )

    def check(self) -> None:
        """Refuse frames that are not complete episodes in order.

        Raises:
            ValueError: for incomplete or wrongly numbered episodes.
        """
        episode, frame, done = self.frames["episode"], self.frames["frame"], self.frames["next", "done"].squeeze(1)
        begins = torch.cat([torch.ones(1, dtype=torch.bool), done[:-1]])
        rows = torch.arange(len(self))
        since = rows - torch.where(begins, rows, 0).cummax(0).values
        if not (bool(done[-1]) and torch.equal(episode, begins.cumsum(0) - 1) and torch.equal(frame, since)):
            raise ValueError("expected complete episodes, numbered from 0 and in order, got others")


def joined(episodes: list[TensorDictBase]) -> TensorDict:
    """Concatenate the frames of episodes, [T] each, and number them under ``episode`` and ``frame``."""
    frames = TensorDict.cat([each.to_tensordict() for each in episodes])
    lengths = torch.tensor([len(each) for each in episodes])
    frames["episode"] = torch.arange(len(episodes)).repeat_interleave(lengths)
    frames["frame"] = torch.cat([torch.arange(len(each)) for each in episodes])
    return frames
