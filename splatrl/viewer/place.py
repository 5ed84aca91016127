"""The handles of a scene, to be dragged or typed: goal, object, and corners of the walkable area and the bounds."""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

from splatrl.scenes.gaussians import LARGEST
from splatrl.values import split_words

CORNERS = {"walk": 2, "bounds": 3}
"""Keys of a ``scene.yaml`` that hold two corners, with the number of coordinates of each."""
ROUND, ROUND_DEG = 3, 1
"""Decimal digits to which dragged metres and degrees are rounded."""
SUCH_AS = ("-0.5", "1.25", "90")
"""Numbers to show how a handle's are typed."""


class Handle(NamedTuple):
    """A handle that can be dragged.

    Attributes:
        name: ``goal``, ``object``, or a corner such as ``walk 0``.
        position: x, y and z, metres.
        yaw: radians; only the goal has one.
    """

    name: str
    position: tuple[float, float, float]
    yaw: float = 0.0


def handles(values: Mapping[str, Any], height: float) -> list[Handle]:
    """Return the handles of a place.

    Args:
        values: ``goal``, ``object``, ``walk`` and ``bounds`` as in a ``scene.yaml``; None for those without a value.
        height: height of the robots, metres, at which planar handles are shown.
    """
    found = []
    if values.get("goal") is not None:
        x, y, yaw_deg = values["goal"]
        found.append(Handle("goal", (x, y, height), math.radians(yaw_deg)))
    if values.get("object") is not None:
        x, y, z = values["object"]
        found.append(Handle("object", (x, y, z)))
    for key in CORNERS:
        for number, corner in enumerate(values.get(key) or ()):
            x, y, z = (*corner, height)[:3]
            found.append(Handle(f"{key} {number}", (x, y, z)))
    return found


def numbers_of(values: Mapping[str, Any], name: str) -> list[float]:
    """Return the numbers that a handle stands for, in the units of ``scene.yaml``.

    Args:
        values: see ``handles``.
        name: name of the handle.
    """
    key, _, number = name.partition(" ")
    return list(values[key][int(number)] if number else values[key])


def listed(numbers: list[float]) -> str:
    """Write numbers without loss, such as ``-0.72, 1.17, 270``."""
    return ", ".join(repr(float(number)).removesuffix(".0") for number in numbers)


def dragged(values: Mapping[str, Any], handle: Handle, step: float | None = None) -> dict[str, Any]:
    """Return the values after a handle was dragged.

    Args:
        values: see ``handles``.
        handle: the handle at its new position.
        step: step size to which the corners of ``walk`` snap, metres, as lattices need; None leaves them free.
    """
    key, old = handle.name.partition(" ")[0], numbers_of(values, handle.name)
    new = [round(value, ROUND) for value in handle.position[: CORNERS.get(key, 3)]]
    if key == "goal":
        new[2] = round(math.degrees(handle.yaw), ROUND_DEG)
    if key == "walk" and step:
        new = [round(low + step * round((at - low) / step), 6) for low, at in zip(old, new, strict=True)]
    return _with(values, handle.name, new)


def typed(values: Mapping[str, Any], name: str, text: str) -> dict[str, Any]:
    """Return the values after the numbers of a handle were typed, which are not rounded.

    Args:
        values: see ``handles``.
        name: name of the handle.
        text: its numbers, separated by commas or blanks.

    Raises:
        ValueError: names the handle, the numbers that it takes and what was typed.
    """
    count = len(numbers_of(values, name))
    try:
        numbers = [float(word) for word in split_words(text)]
    except ValueError:
        numbers = []
    if len(numbers) != count or not all(abs(number) <= LARGEST for number in numbers):
        raise ValueError(f"{name}: expected {count} numbers such as {', '.join(SUCH_AS[:count])}, got {text or 'none'}")
    return _with(values, name, numbers)


def _with(values: Mapping[str, Any], name: str, numbers: list[float]) -> dict[str, Any]:
    """Return the values with other numbers for one handle."""
    key, _, number = name.partition(" ")
    if not number:
        return {**values, key: numbers}
    corners = [list(corner) for corner in values[key]]
    corners[int(number)] = numbers
    return {**values, key: corners}


def changes(before: Mapping[str, Any], after: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values that differ from before."""
    return {key: value for key, value in after.items() if value != before.get(key)}
