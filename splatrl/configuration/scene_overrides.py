"""Settings that a scene's folder proposes for training, as overrides that come before those of the command line."""

from collections.abc import Callable, Mapping
from typing import Any

TARGETS = {
    "robot_height": ("robot.height",),
    "voxel_size": ("collision.occupancy.resolution",),
    "cutoff": ("collision.occupancy.density.cutoff",),
    "goal": ("landmarks.goal",),
    "object": ("landmarks.object",),
    "object_size": ("drawing.size",),
    "antialiased": ("renderer.antialiased",),
    "step": ("task.motion.step", "task.motion.spacing"),
}
"""Keys of a ``scene.yaml``, with the config keys that take their values."""
IN_METRES = "task.success_distance"
"""Config key of tasks whose goal lies within metres, not within steps: the length of their steps is their own."""
CORNERS = ("task.motion.lower", "task.motion.upper")
"""Config keys that take the two corners of ``walk``."""


def scene_overrides(stated: Mapping[str, Any], has: Callable[[str], bool]) -> list[str]:
    """Return the proposals of a ``scene.yaml`` as overrides in Hydra's grammar.

    They contain only numbers, lists of numbers, true and false, so that an untrusted file can neither name a class to
    build nor refer to other values.

    Args:
        stated: keys and values, as read and checked by ``read_description``.
        has: returns whether the config has a key; a robot that circles an object, for example, has no bounds.
    """
    values = {target: stated[key] for key, targets in TARGETS.items() if key in stated for target in targets}
    if has(IN_METRES):
        values.pop("task.motion.step", None)
    values.update(zip(CORNERS, stated.get("walk", ()), strict=False))
    return [f"{key}={_written(value)}" for key, value in values.items() if has(key)]


def _written(value: Any) -> str:
    if isinstance(value, list):
        return f"[{','.join(map(_written, value))}]"
    if isinstance(value, bool):
        return "true" if value else "false"
    return repr(float(value))
