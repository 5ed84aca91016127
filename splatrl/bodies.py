"""Shapes of robot bodies, in the body frame, centred at its origin."""

import math
from collections.abc import Iterable
from dataclasses import dataclass

from splatrl.values import require_number

LARGEST = 1e6
"""Largest length of a body, metres: small enough to be counted in voxels without overflow."""


def _check_length(name: str, value: float) -> None:
    require_number(name, value, high=LARGEST, above=0.0, unit="metres")


@dataclass(frozen=True)
class Box:
    """A box.

    Attributes:
        size: full extents along x, y and z, metres.
    """

    size: tuple[float, float, float]

    def __post_init__(self) -> None:
        extents = tuple(self.size) if isinstance(self.size, Iterable) else ()
        if len(extents) != 3:
            raise ValueError(f"Box.size: expected 3 full extents along x, y and z in metres, got {self.size}")
        for axis, extent in zip("xyz", extents, strict=True):
            _check_length(f"Box.size.{axis}", extent)
        object.__setattr__(self, "size", tuple(float(extent) for extent in extents))

    @property
    def radius(self) -> float:
        """Radius of the sphere about the origin that contains the body, metres."""
        return 0.5 * math.hypot(*self.size)

    @property
    def half_width(self) -> float:
        """Distance from the vertical line through its origin to its nearest side, metres."""
        return 0.5 * min(self.size[:2])

    @property
    def half_height(self) -> float:
        """How far the body reaches above and below its origin along its own z, metres."""
        return 0.5 * self.size[2]


@dataclass(frozen=True)
class Sphere:
    """A sphere of ``radius`` metres."""

    radius: float

    def __post_init__(self) -> None:
        _check_length("Sphere.radius", self.radius)

    @property
    def half_width(self) -> float:
        """Distance from the vertical line through its origin to its nearest side, metres."""
        return self.radius

    @property
    def half_height(self) -> float:
        """How far the body reaches above and below its origin along its own z, metres."""
        return self.radius


@dataclass(frozen=True)
class Capsule:
    """A cylinder along z with a half-sphere at each end.

    Attributes:
        cap_radius: radius of the cylinder and of its caps, metres.
        length: length of the cylinder without its caps, metres.
    """

    cap_radius: float
    length: float

    def __post_init__(self) -> None:
        _check_length("Capsule.cap_radius", self.cap_radius)
        _check_length("Capsule.length", self.length)

    @property
    def radius(self) -> float:
        """Radius of the sphere about the origin that contains the body, metres."""
        return 0.5 * self.length + self.cap_radius

    @property
    def half_width(self) -> float:
        """Distance from the vertical line through its origin to its nearest side, metres."""
        return self.cap_radius

    @property
    def half_height(self) -> float:
        """How far the body reaches above and below its origin along its own z, metres."""
        return self.radius


Body = Box | Sphere | Capsule
