"""Training settings that a ``scene.yaml`` can propose for its scene: their keys and valid values."""

import sys
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

ERRORS = {"up": "up_error_deg", "its scale": "scale_error"}
"""The figures of a capture's ``quality`` that are null where nothing limits the error."""


def check_proposals(source: object, stated: Mapping[str, Any]) -> None:
    """Refuse values that are invalid for their key; keys that are not in ``PROPOSALS`` are ignored.

    Args:
        source: origin of the values, for error messages.
        stated: keys and values of a ``scene.yaml``; none is null.

    Raises:
        ValueError: if a value is invalid; the message names the key, what was expected and what came.
    """
    for key, (expected, fits) in PROPOSALS.items():
        if key in stated and not fits(stated[key]):
            raise ValueError(f"{source}: {key}: expected {expected}, got {stated[key]!r}")


def warn_of_unknowns(place: Path, stated: Mapping[str, Any]) -> None:
    """Warn about a scene that states ``metric: false``, or whose capture does not know how far up or the scale is off.

    Args:
        place: the scene's folder.
        stated: keys and values of its ``scene.yaml``.
    """
    metric, quality = stated.get("metric", True), stated.get("quality", {})
    unknown = [name for name, key in ERRORS.items() if quality.get(key, 0) is None and (metric or name != "its scale")]
    if not metric:
        warnings.warn(
            f"{place}: not metric: its scale is unknown or only a guess, so its lengths are not metres", stacklevel=3
        )
    if unknown:
        warnings.warn(f"{place}: {' and '.join(unknown)} may be far off; see the capture's report.html", stacklevel=3)


def _number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= sys.float_info.max


def _positive(value: Any) -> bool:
    return _number(value) and value > 0


def _numbers(count: int) -> Callable[[object], bool]:
    return lambda value: isinstance(value, list) and len(value) == count and all(map(_number, value))


def _area(value: object) -> bool:
    if not (isinstance(value, list) and len(value) == 2 and all(map(_numbers(2), value))):
        return False
    return all(low < high for low, high in zip(*value, strict=True))


def _file(value: object) -> bool:
    return isinstance(value, str) and bool(value) and Path(value).name == value


def _figures(value: object) -> bool:
    plain = isinstance(value, dict) and all(isinstance(key, str) for key in value)
    return plain and all(v is None or isinstance(v, bool | str) or _number(v) for v in value.values())  # type: ignore[attr-defined]


PROPOSALS: dict[str, tuple[str, Callable[[Any], bool]]] = {
    "robot_height": ("a positive, finite number of metres", _positive),
    "voxel_size": ("a positive, finite number of metres", _positive),
    "cutoff": ("a fraction of the light above 0 and below 1", lambda value: _positive(value) and value < 1),
    "walk": ("[[x, y], [x, y]] in metres, the lower corner first", _area),
    "step": ("a positive, finite number of metres", _positive),
    "free": ("the name of a file in this folder", _file),
    "goal": ("[x, y, yaw], x and y in metres and yaw in degrees", _numbers(3)),
    "object": ("[x, y, z] in metres", _numbers(3)),
    "object_size": ("a positive, finite number of metres", _positive),
    "antialiased": ("true or false", lambda value: isinstance(value, bool)),
    "metric": ("true or false", lambda value: isinstance(value, bool)),
    "source": ("text", lambda value: isinstance(value, str)),
    "quality": ("measures by name, each a number, text, true or false", _figures),
}
"""For each key, its valid values in words, and a function that tests whether a value is valid."""
