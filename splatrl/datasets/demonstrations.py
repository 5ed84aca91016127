"""Demonstrations as data: the frames of whole episodes, one after another."""

from dataclasses import dataclass

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

AFTER = ("state", "reward", "done", "terminated", "truncated", "outcome")
"""Keys of a step's result that are kept, under ``"next"``."""


@dataclass(frozen=True)
class Demonstrations:
    """N frames of E episodes, in order, under TorchRL's keys; the last view of an episode is not among them.

    Attributes:
        frames: [N] ``episode`` [N] int64, from 0 on; ``frame`` [N] int64, its number in the episode; ``pixels``
            [N, H, W, 3] uint8, one view; ``action`` and ``state``; what sensors sense, and what they and the task
            remember; and under ``"next"`` ``AFTER``. Where the planner showed discrete actions, ``optimal`` [N, A]
            bool: all that would have been right.
        action_names: names of discrete actions, in their order; empty where actions are continuous.
        fps: steps a second, for videos.
    """

    frames: TensorDictBase
    action_names: tuple[str, ...]
    fps: int = 10

    def __len__(self) -> int:
        """The number of frames."""
        return len(self.frames)

    @property
    def starts(self) -> Tensor:
        """The first frame of each episode: [E] int64."""
        return (self.frames["frame"] == 0).nonzero().squeeze(1)

    @property
    def lengths(self) -> Tensor:
        """The number of frames of each episode: [E] int64."""
        return torch.diff(self.starts, append=torch.tensor([len(self)]))

    def stacked(self, views: int) -> Tensor:
        """What a policy of several views sees, with an episode's first view repeated: [N, H, W, 3 · views] uint8."""
        rows = torch.arange(len(self))
        first = rows - self.frames["frame"]
        seen = [self.frames["pixels"][torch.maximum(rows - back, first)] for back in reversed(range(views))]
        return torch.cat(seen, -1)

    def returns(self, gamma: float) -> Tensor:
        """Discounted rewards from each frame to the end of its episode: [N] float32."""
        reward, done = self.frames["next", "reward"].squeeze(1), self.frames["next", "done"].squeeze(1)
        result, after = torch.zeros_like(reward), torch.zeros(())
        for row in range(len(self) - 1, -1, -1):
            after = reward[row] + gamma * torch.where(done[row], 0.0, after)
            result[row] = after
        return result

    def check(self) -> None:
        """Refuse frames that are not whole episodes in order.

        Raises:
            ValueError: says what is wrong.
        """
        episode, frame, done = self.frames["episode"], self.frames["frame"], self.frames["next", "done"].squeeze(1)
        begins = torch.cat([torch.ones(1, dtype=torch.bool), done[:-1]])
        rows = torch.arange(len(self))
        since = rows - torch.where(begins, rows, 0).cummax(0).values
        if not (bool(done[-1]) and torch.equal(episode, begins.cumsum(0) - 1) and torch.equal(frame, since)):
            raise ValueError("expected whole episodes, numbered from 0 and each to its end, got others")


def joined(episodes: list[TensorDictBase]) -> TensorDict:
    """The frames of episodes, [T] each, one after another, with ``episode`` and ``frame``."""
    frames = TensorDict.cat([each.to_tensordict() for each in episodes])
    lengths = torch.tensor([len(each) for each in episodes])
    frames["episode"] = torch.arange(len(episodes)).repeat_interleave(lengths)
    frames["frame"] = torch.cat([torch.arange(len(each)) for each in episodes])
    return frames
