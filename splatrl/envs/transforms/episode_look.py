"""Base class of transforms that change the look of images by parameters drawn for each episode."""

from abc import abstractmethod
from typing import ClassVar

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite, Unbounded

from splatrl.envs.transforms.randomness import RandomTransform


class EpisodeLook(RandomTransform):
    """Changes ``pixels`` by a row of parameters, drawn for each episode and observed under ``KEY``.

    A row given to a reset is kept, except by robots that are reset after an episode to a start of the env's own.
    Without an env, as in a replay buffer, one is drawn for each image that does not come with one.

    Args:
        seed: seed of the transform's own generator (``RandomTransform``).
    """

    KEY: ClassVar[str]
    SIZE: ClassVar[int]
    """Number of parameters in a row."""
    DEPTH: ClassVar[str | None] = None
    """Key of the depth, which is read and then removed from the observation; None if depth is not needed."""

    def __init__(self, seed: int = 0):
        super().__init__(seed, in_keys=["pixels"], out_keys=["pixels", self.KEY])
        self.remembered = (self.KEY,)

    @abstractmethod
    def _draw(self, batch: torch.Size, level: Tensor | None = None) -> Tensor:
        """Draw rows of parameters, [*batch, SIZE] float32, for episodes that begin at a level, [*batch, 1] int64."""

    @abstractmethod
    def _changed(self, images: Tensor, look: Tensor, depth: Tensor | None) -> Tensor:
        """Apply parameters to images: [N, H, W, 3] uint8, [N, SIZE] and [N, H, W] float32 -> [N, H, W, 3] uint8."""

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        level = tensordict_reset.get("level", None)
        drawn = self._draw(tensordict_reset.batch_size, level)  # always, so that later draws do not depend on it
        given, mask = tensordict.get(self.KEY, None), tensordict.get("_reset", None)
        if given is not None:  # a masked reset may hand over all that the last episode left; level -1: a given state
            drawn = given.clone() if mask is None or level is None else torch.where(level == -1, given, drawn)
        return self._change(tensordict_reset.set(self.KEY, drawn), _wanted(mask))

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        return self._change(next_tensordict.set(self.KEY, tensordict[self.KEY].clone()))

    def _change(self, tensordict: TensorDictBase, rows: Tensor | None = None) -> TensorDictBase:
        """Change the images selected by ``rows``, [N] bool, or all; TorchRL keeps the old ones of robots not reset."""
        pixels = tensordict["pixels"]
        depth = None if self.DEPTH is None else tensordict.get(self.DEPTH, None)
        images, look = pixels.reshape(-1, *pixels.shape[-3:]), tensordict[self.KEY].reshape(-1, self.SIZE)
        far = None if depth is None else depth.reshape(images.shape[:3])
        if rows is None:
            changed = self._changed(images, look, far)
        else:
            changed = images.clone()
            changed[rows] = self._changed(images[rows], look[rows], None if far is None else far[rows])
        tensordict.set("pixels", changed.view(pixels.shape))
        return tensordict if depth is None else tensordict.exclude(self.DEPTH, inplace=True)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Change images that do not come from an env."""
        if tensordict.get(self.KEY, None) is None:
            tensordict.set(self.KEY, self._draw(tensordict["pixels"].shape[:-3], tensordict.get("level", None)))
        return self._change(tensordict)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add the row of parameters to the observation."""
        return self._with_row(observation_spec)

    def transform_state_spec(self, state_spec: Composite) -> Composite:
        """Read the row of parameters from the input of a step or a reset."""
        return self._with_row(state_spec)

    def _with_row(self, spec: Composite) -> Composite:
        spec = spec.clone()
        spec[self.KEY] = Unbounded(shape=(*spec.shape, self.SIZE), dtype=torch.float32, device=spec.device)
        return spec


def _wanted(mask: Tensor | None) -> Tensor | None:
    """Return which images a reset must change, [N] bool; None for all, since selecting some would synchronise a GPU."""
    return None if mask is None or mask.device.type != "cpu" else mask.flatten()
