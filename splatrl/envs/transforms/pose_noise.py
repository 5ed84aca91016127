"""Camera pose noise: the camera is not exactly where the robot assumes it to be."""

import math
from typing import Any, Literal

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Composite, Unbounded

from splatrl.envs.transforms.randomness import RandomTransform
from splatrl.values import require_number

EDGE = 1 - 1e-6
"""Fraction of its range that a uniform offset may use, so that the underlying normal variable stays finite."""


class PoseNoise(RandomTransform):
    """Moves the camera but not the robot by noise in height, roll and pitch, and optionally in x, y and yaw.

    It writes ``camera_offset`` before the env renders, and adds it to the observation: [B, 6] float32, metres along
    world x, y and z, then radians of pitch, roll and yaw about the camera's own right, forward and down axes. Every
    reset draws a new offset, unless it is given a ``camera_offset``, which it keeps: an observation can be reproduced
    from its ``state`` and ``camera_offset``.

    With ``smooth=0`` the offsets of all steps are independent. Otherwise they drift like those of a camera in an
    unsteady hand: each is driven by a first-order autoregressive process, z' = ρ z + √(1 − ρ²) n with ρ =
    exp(−1 / smooth), which is an Ornstein-Uhlenbeck process sampled once per step. z is always standard normal, and
    uniform noise maps it through the normal cumulative distribution function, so that each single offset is distributed
    as with ``smooth=0``. The process has no state other than ``camera_offset``.

    Without an env it changes nothing, since recorded images cannot be rendered again.

    Args:
        height: size of the noise in the camera's height, metres: the maximum offset of uniform noise, or the standard
            deviation of normal noise.
        roll_deg: size of the noise about the camera's forward axis, degrees.
        pitch_deg: size of the noise about the camera's right axis, degrees.
        x: size of the noise along world x, metres.
        y: size of the noise along world y, metres.
        yaw_deg: size of the noise about the camera's down axis, degrees.
        distribution: uniform or normal.
        smooth: correlation time in steps; 0 for independent offsets.
        seed: seed of the transform's own generator (``RandomTransform``).

    Raises:
        ValueError: for a size or time that is negative or not finite, or any other distribution.
    """

    sizes: Tensor  # [6] float32, in the order and units of ``camera_offset``

    def __init__(
        self,
        height: float = 0.02,
        roll_deg: float = 5.0,
        pitch_deg: float = 5.0,
        x: float = 0.0,
        y: float = 0.0,
        yaw_deg: float = 0.0,
        distribution: Literal["uniform", "normal"] = "uniform",
        smooth: float = 0.0,
        seed: int = 0,
    ):
        super().__init__(seed, out_keys=["camera_offset"])
        given = {"x": x, "y": y, "height": height, "pitch_deg": pitch_deg, "roll_deg": roll_deg, "yaw_deg": yaw_deg}
        for name, value in {**given, "smooth": smooth}.items():
            require_number(f"pose_noise.{name}", value, 0.0)
        if distribution not in ("uniform", "normal"):
            raise ValueError(f"pose_noise.distribution: expected uniform or normal, got {distribution!r}")
        self.distribution = distribution
        self.memory = math.exp(-1 / smooth) if smooth > 0 else 0.0
        sizes = [math.radians(value) if name.endswith("_deg") else value for name, value in given.items()]
        self.register_buffer("sizes", torch.tensor(sizes, dtype=torch.float32), persistent=False)

    def _reset_env_preprocess(self, tensordict: TensorDictBase | None) -> TensorDictBase:
        env = self.container
        if tensordict is None:
            tensordict = TensorDict(batch_size=env.batch_size, device=env.device)
        drawn = self._draw(tensordict.batch_size)  # always, so that later draws do not depend on it
        given = tensordict.get("camera_offset", None)
        return tensordict.set("camera_offset", drawn if given is None else given.clone())

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        if self.env is None:
            return tensordict
        if not self.memory:
            return tensordict.set("camera_offset", self._draw(tensordict.batch_size))
        return tensordict.set("camera_offset", self._drift(tensordict["camera_offset"]))

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        return tensordict_reset.set("camera_offset", tensordict["camera_offset"])

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        return next_tensordict.set("camera_offset", tensordict["camera_offset"])

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Change nothing: a camera cannot be moved once its image has been rendered."""
        return tensordict

    def _draw(self, batch: torch.Size) -> Tensor:
        """Draw offsets that are independent of earlier ones: [*batch, 6]."""
        options: dict[str, Any] = {"generator": self.generator, "device": self.sizes.device}
        if self.distribution == "normal":
            return torch.randn(*batch, 6, **options) * self.sizes
        return (2 * torch.rand(*batch, 6, **options) - 1) * self.sizes

    def _drift(self, offset: Tensor) -> Tensor:
        """Draw the next offsets of the autoregressive process: [..., 6]."""
        fresh = torch.randn(offset.shape, generator=self.generator, device=self.sizes.device)
        share = torch.where(self.sizes > 0, offset / self.sizes, 0.0)
        uniform = self.distribution == "uniform"
        normal = math.sqrt(2) * share.clamp(-EDGE, EDGE).erfinv() if uniform else share
        normal = self.memory * normal + math.sqrt(1 - self.memory**2) * fresh
        return self.sizes * (torch.erf(normal / math.sqrt(2)) if uniform else normal)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add ``camera_offset`` to the observation."""
        return self._with_offset(observation_spec)

    def transform_state_spec(self, state_spec: Composite) -> Composite:
        """Read ``camera_offset`` from the input of a step or a reset."""
        return self._with_offset(state_spec)

    def _with_offset(self, spec: Composite) -> Composite:
        spec = spec.clone()
        spec["camera_offset"] = Unbounded(shape=(*spec.shape, 6), dtype=torch.float32, device=spec.device)
        return spec
