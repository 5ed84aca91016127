"""An object that is not in the scene."""

import math
from collections.abc import Iterable, Sequence
from pathlib import Path

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Bounded, Composite
from torchrl.envs import Transform

from splatrl.envs.transforms.billboard import overlay
from splatrl.envs.transforms.reset_rows import transform_reset_rows
from splatrl.envs.transforms.sprite import Sprite, load_sprite


class SpriteOverlay(Transform):
    """Draws a picture at a place in the world over ``pixels``, hidden where the scene is nearer (``overlay``).

    It reads ``pixels`` [B, H, W, 3] uint8, ``depth`` [B, H, W], ``camera_to_world`` [B, 4, 4] and, without a
    ``position``, ``target`` [B, 3]; it writes ``pixels`` and ``sprite_share`` [B, 1] float32, the share of the image
    that the sprite covers, which is 0 where nothing of it is seen.

    Args:
        K: [3, 3] intrinsics of the env's camera, pixels.
        sprite: ``"apple"``, the path of a PNG with alpha, or a ``Sprite``.
        size: of the picture across its width, metres.
        position: x, y and z of its centre, world, metres; None takes the env's ``target``.
        near: a sprite nearer than this along the optical axis is not drawn, metres.

    Raises:
        ValueError: for values other than these, or an env that does not show what is read.
    """

    K: Tensor  # [3, 3] float32

    def __init__(
        self,
        K: Tensor,
        sprite: str | Path | Sprite = "apple",
        size: float = 0.16,
        position: Sequence[float] | None = None,
        near: float = 0.05,
    ):
        place = ["target"] if position is None else []
        super().__init__(
            in_keys=["pixels", "depth", "camera_to_world", *place],
            out_keys=["pixels", "sprite_share"],
        )
        if K.shape != (3, 3):
            raise ValueError(f"sprite.K: expected shape [3, 3], got {list(K.shape)}")
        for name, value in {"size": size, "near": near}.items():
            if not (math.isfinite(value) and value > 0):
                raise ValueError(f"sprite.{name}: expected positive metres, got {value}")
        if position is not None and not (len(position) == 3 and all(math.isfinite(value) for value in position)):
            raise ValueError(f"sprite.position: expected finite x, y and z in metres, got {list(position)}")
        self.sprite = sprite if isinstance(sprite, Sprite) else load_sprite(sprite)
        self.size, self.near = size, near
        fixed = None if position is None else torch.tensor([float(value) for value in position])
        self.register_buffer("position", fixed, persistent=False)
        self.register_buffer("K", K.detach().clone().float(), persistent=False)

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        td = next_tensordict
        if self.sprite.texels.device != self.K.device:
            self.sprite = self.sprite.to(self.K.device)
        target = td["target"] if self.position is None else self.position
        view = (td["pixels"], td["depth"], td["camera_to_world"], self.K)
        pixels, share = overlay(*view, target, self.sprite, self.size, self.near)
        return td.set("pixels", pixels).set("sprite_share", share)

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        return transform_reset_rows(self, self._call, tensordict, tensordict_reset)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Draw over images that are not an env's."""
        return self._call(tensordict)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add ``sprite_share``."""
        for key in self.in_keys:
            if key not in observation_spec.keys():  # noqa: SIM118, a spec is no dict
                hint = ": give sprite.position" if key == "target" else ": make the env with depth=True"
                raise ValueError(f"SpriteOverlay: expected an env that shows {key}, got {list(observation_spec)}{hint}")
        spec = observation_spec.clone()
        shape = (*spec.shape, 1)
        spec["sprite_share"] = Bounded(0.0, 1.0, shape=shape, dtype=torch.float32, device=spec.device)
        return spec


def sprite_among(transforms: Iterable[Transform]) -> SpriteOverlay | None:
    """The overlay among some transforms, at any depth of nesting; None where there is none."""
    parts = (part for transform in transforms for part in transform.modules())
    return next((part for part in parts if isinstance(part, SpriteOverlay)), None)
