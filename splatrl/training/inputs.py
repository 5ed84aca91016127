"""Inputs of a network: images and vectors, by key."""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torchrl.data import Composite

from splatrl.training.correlation import CorrelationTrunk
from splatrl.training.heads import orthogonal
from splatrl.training.trunk import GAIN, PoolPixels, Trunk

ENCODINGS = ("image", "plain", "angle", "polar")


class Input(NamedTuple):
    """An observation that a network reads.

    Attributes:
        encoding: ``image``: [H, W, C], uint8 or floats in [0, 1], joined with other images as channels; ``plain``:
            numbers as they are; ``angle``: radians, as cosine and sine; ``polar``: rho and phi, as log(1 + rho), cosine
            and sine.
        shape: shape of one robot's observation.
    """

    encoding: str
    shape: tuple[int, ...]

    @property
    def size(self) -> int:
        """Number of values that a vector is encoded as."""
        return math.prod(self.shape) * {"plain": 1, "angle": 2}.get(self.encoding, 1) + (self.encoding == "polar")


def inputs_of(named: Mapping[str, str], spec: Composite, group: str = "inputs") -> dict[str, Input]:
    """Return the inputs that a config names, with the shapes that an env gives them.

    Args:
        named: encoding by key.
        spec: observation spec of the env, batched.
        group: name of the config group, for messages.

    Raises:
        ValueError: for a key that is not observed, an unknown encoding or one that does not fit the shape, or images of
            different sizes.
    """
    found = {}
    for key, encoding in named.items():
        if encoding not in ENCODINGS:
            raise ValueError(f"{group}.{key}: expected one of {', '.join(ENCODINGS)}, got {encoding}")
        if key not in spec.keys():  # noqa: SIM118, a spec is no dict
            raise ValueError(f"{group}.{key}: expected an observation, found none of that name; type sensors=[...]")
        shape = tuple(spec[key].shape[1:])
        fits = {"image": len(shape) == 3, "polar": shape == (2,)}.get(encoding, len(shape) == 1)
        if not fits:
            raise ValueError(f"{group}.{key}: expected a shape that suits {encoding} encoding, got {list(shape)}")
        found[key] = Input(encoding, shape)
    sides = {one.shape[:2] for one in found.values() if one.encoding == "image"}
    if len(sides) > 1:
        raise ValueError(f"{group}: expected images of the same size, got {sorted(sides)}")
    return found


class Prepare(nn.Module):
    """The weight-free part of a network: pools and joins images, and encodes vectors.

    Args:
        inputs: the inputs, in the order of the arguments of ``forward``.
        pool: side of the cells over which images are averaged, pixels.
    """

    def __init__(self, inputs: Mapping[str, Input], pool: int):
        super().__init__()
        self.encodings = [one.encoding for one in inputs.values()]
        self.pool = PoolPixels(pool)

    def forward(self, *observed: Tensor) -> tuple[Tensor, ...]:
        """Return the joined image [..., H // pool, W // pool, C] in [-0.5, 0.5] and the vector [..., V], if present."""
        images = [one for one, how in zip(observed, self.encodings, strict=True) if how == "image"]
        pooled = [self.pool(one) for one in images]
        vectors = [_encoded(one, how) for one, how in zip(observed, self.encodings, strict=True) if how != "image"]
        joined = [torch.cat(pooled, -1)] if pooled else []
        return (*joined, *([torch.cat(vectors, -1)] if vectors else []))


def _encoded(values: Tensor, how: str) -> Tensor:
    """Encode a vector for a network: [..., n] -> [..., size]."""
    values = values.float()
    if how == "angle":
        return torch.cat([values.cos(), values.sin()], -1)
    if how == "polar":
        rho, phi = values[..., :1], values[..., 1:]
        return torch.cat([rho.log1p(), phi.cos(), phi.sin()], -1)
    return values


class JoinedTrunk(nn.Module):
    """Convolutions over the image and a dense layer over the vector, if present, joined by another dense layer.

    Args:
        image_shape: (H, W, C) after pooling; None reads only the vector.
        vector: size of the vector; 0 reads only the image.
        channels: see ``Trunk``.
        features: size of each part and of the output.
        trunk: class of the trunk that reads the image.
    """

    def __init__(
        self,
        image_shape: tuple[int, int, int] | None,
        vector: int,
        channels: Sequence[int],
        features: int,
        trunk: type[Trunk] | type[CorrelationTrunk] = Trunk,
    ):
        super().__init__()
        self.seen = None if image_shape is None else trunk(*image_shape, channels, features)
        self.told = _dense(vector, features) if vector else None
        self.joined = _dense(((self.seen is not None) + (self.told is not None)) * features, features)

    def forward(self, *prepared: Tensor) -> Tensor:
        """Encode the output of ``Prepare``: -> [..., features] float32."""
        layers = [layer for layer in (self.seen, self.told) if layer is not None]
        return self.joined(torch.cat([layer(one) for layer, one in zip(layers, prepared, strict=True)], -1))


def _dense(given: int, features: int) -> nn.Sequential:
    return nn.Sequential(orthogonal(nn.Linear(given, features), GAIN), nn.ReLU(inplace=True))
