"""What can be dragged in a place: goal, thing, and the corners of where robots walk and of what counts."""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

CORNERS = {"walk": 2, "bounds": 3}
"""Keys of a ``scene.yaml`` that are two corners, and how many numbers each has."""
ROUND, ROUND_DEG = 3, 1
"""Digits to which dragged metres and degrees are rounded."""


class Handle(NamedTuple):
    """Something to drag.

    Attributes:
        name: ``goal``, ``object``, or a corner such as ``walk 0``.
        position: x, y and z, metres.
        yaw: radians; only the goal has one.
    """

    name: str
    position: tuple[float, float, float]
    yaw: float = 0.0


def handles(values: Mapping[str, Any], height: float) -> list[Handle]:
    """The handles of a place.

    Args:
        values: ``goal``, ``object``, ``walk`` and ``bounds`` as a ``scene.yaml`` says them; None is not there.
        height: of robots, metres: where what lies in the plane is shown.
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
    """The values after a handle was dragged.

    Args:
        values: as for ``handles``.
        handle: where it is now.
        step: the corners of ``walk`` move by whole steps, metres, which lattices need; None leaves them free.
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
    """The values that are others than before."""
    return {key: value for key, value in after.items() if value != before.get(key)}
