"""The handles that can be dragged in a scene: goal, object, and the corners of the walking area and the bounds."""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

CORNERS = {"walk": 2, "bounds": 3}
"""Keys of a ``scene.yaml`` that hold two corners, with the number of coordinates of each."""
ROUND, ROUND_DEG = 3, 1
"""Decimal digits to which dragged metres and degrees are rounded."""


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


def dragged(values: Mapping[str, Any], handle: Handle, step: float | None = None) -> dict[str, Any]:
    """Return the values after a handle was dragged.

    Args:
        values: see ``handles``.
        handle: the handle at its new position.
        step: step size to which the corners of ``walk`` snap, metres, as lattices need; None leaves them free.
    """
    result, (key, _, number) = dict(values), handle.name.partition(" ")
    rounded = [round(value, ROUND) for value in handle.position]
    if key == "goal":
        result["goal"] = [*rounded[:2], round(math.degrees(handle.yaw), ROUND_DEG)]
    elif key == "object":
        result["object"] = rounded
    else:
        corners = [list(corner) for corner in values[key]]
        old = corners[int(number)]
        new = rounded[: CORNERS[key]]
        if key == "walk" and step:
            new = [round(low + step * round((at - low) / step), 6) for low, at in zip(old, new, strict=True)]
        corners[int(number)] = new
        result[key] = corners
    return result


def changes(before: Mapping[str, Any], after: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values that differ from before."""
    return {key: value for key, value in after.items() if value != before.get(key)}
