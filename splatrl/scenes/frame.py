"""The similarity from a splat file's own frame to the world, as people write it in YAML."""

import sys
from collections.abc import Mapping, Sequence
from typing import Any

import torch
from torch import Tensor

from splatrl.values import require_number

AXES = {f"{sign}{axis}": (i, value) for i, axis in enumerate("xyz") for sign, value in (("", 1.0), ("-", -1.0))}


FRAME_KEYS = ("axes", "scale", "translation", "matrix")
"""Names of the arguments of ``similarity``."""


def stated_similarity(stated: object) -> Tensor | None:
    """Build the similarity that a file states as arguments of ``similarity`` by name; None if it states nothing.

    Args:
        stated: keys and values, or None for no keys; a value of None stands for the default.

    Returns:
        [4, 4] float64, from splat coordinates to world metres.

    Raises:
        ValueError: for unknown keys, and as in ``similarity``.
    """
    if stated is not None and not isinstance(stated, Mapping):
        raise ValueError(f"world_from_splat: expected keys and values, got {stated!r:.80}")
    given = {key: value for key, value in (stated or {}).items() if value is not None}
    unknown = [str(key) for key in given if key not in FRAME_KEYS]
    if unknown:
        raise ValueError(f"world_from_splat: expected the keys {', '.join(FRAME_KEYS)}, got {', '.join(unknown):.80}")
    return similarity(**given) if given else None


def overridden(own: Mapping[str, Any], typed: Mapping[str, Any]) -> Tensor | None:
    """Build the similarity that a file states, with those of its parts replaced that are typed.

    The two need not have the same form: a typed matrix replaces everything, and typed axes, scale and translation each
    replace that part of a stated matrix.

    Args:
        own: arguments of ``similarity`` by name, as the file states them; a value of None stands for the default.
        typed: arguments that take precedence; a value of None leaves that part as the file states it.

    Returns:
        [4, 4] float64; None if neither states anything.

    Raises:
        ValueError: as in ``stated_similarity``.
    """
    own, typed = ({key: value for key, value in one.items() if value is not None} for one in (own, typed))
    if "matrix" in typed or not ("matrix" in own and typed):
        return stated_similarity(typed if "matrix" in typed else {**own, **typed})
    old, new = stated_similarity(own), stated_similarity(typed)
    assert old is not None and new is not None
    scale = (new if "scale" in typed else old)[:3, 0].norm()
    axes = (new if "axes" in typed else old)[:3, :3]
    result = (new if "translation" in typed else old).clone()
    result[:3, :3] = scale * axes / axes[:, 0].norm()
    return result


def similarity(
    axes: Sequence[str] = ("x", "y", "z"),
    scale: float = 1.0,
    translation: Sequence[float] = (0.0, 0.0, 0.0),
    matrix: Sequence[Sequence[float]] | Tensor | None = None,
) -> Tensor:
    """Build ``world_from_splat``: a rotation, a uniform positive scale and a translation.

    Args:
        axes: the signed splat axes that give world x, y and z: ``["x", "-z", "y"]`` stands a y-up file upright,
            ``["x", "z", "-y"]`` a −y-up one.
        scale: metres per splat unit, above 0.
        translation: [3] metres, added last.
        matrix: [4, 4], in place of the other three arguments.

    Returns:
        [4, 4] float64, from splat coordinates to world metres.

    Raises:
        ValueError: for a reflection, a non-uniform scale, or values that are neither axes nor finite numbers.
    """
    if not _is_list(axes, 3) or not all(isinstance(axis, str) and axis in AXES for axis in axes):
        raise ValueError(f"world_from_splat.axes: expected 3 of {', '.join(AXES)}, got {axes!r:.80}")
    if not _is_list(translation, 3):
        raise ValueError(f"world_from_splat.translation: expected 3 numbers, got {translation!r:.80}")
    if matrix is not None:
        if list(axes) != ["x", "y", "z"] or scale != 1.0 or list(translation) != [0.0, 0.0, 0.0]:
            raise ValueError("world_from_splat: expected either a matrix or axes, scale and translation, got both")
        return checked_similarity(matrix)
    if sorted(AXES[axis][0] for axis in axes) != [0, 1, 2]:
        raise ValueError(f"world_from_splat.axes: expected each of x, y and z once, got {list(axes)}")
    require_number("world_from_splat.scale", _number("scale", scale), above=0.0)
    transform = torch.zeros(4, 4, dtype=torch.float64)
    for row, axis in enumerate(axes):
        column, sign = AXES[axis]
        transform[row, column] = sign * scale
    transform[:3, 3] = torch.tensor([_number("translation", v) for v in translation], dtype=torch.float64)
    transform[3, 3] = 1.0
    return checked_similarity(transform)


def checked_similarity(matrix: Sequence[Sequence[float]] | Tensor) -> Tensor:
    """Return a matrix as float64 in main memory, if it is a similarity.

    Args:
        matrix: [4, 4], from splat coordinates to world metres.

    Raises:
        ValueError: says why the matrix is not a rotation, a positive scale and a translation.
    """
    if not isinstance(matrix, Tensor) and not (_is_list(matrix, 4) and all(_is_list(row, 4) for row in matrix)):
        raise ValueError(f"world_from_splat.matrix: expected 4 rows of 4, got {matrix!r:.80}")
    rows = matrix if isinstance(matrix, Tensor) else [[_number("matrix", v) for v in row] for row in matrix]
    transform = torch.as_tensor(rows, dtype=torch.float64).cpu()
    if transform.shape != (4, 4) or not transform.isfinite().all():
        raise ValueError(f"world_from_splat.matrix: expected 4 by 4 finite numbers, got {transform.tolist()}")
    if transform[3].tolist() != [0.0, 0.0, 0.0, 1.0]:
        raise ValueError(f"world_from_splat.matrix: expected a last row of 0, 0, 0, 1, got {transform[3].tolist()}")
    linear = transform[:3, :3]
    lengths = linear.norm(dim=0)
    if lengths.min() <= 0.0 or not torch.allclose(lengths, lengths.mean(), rtol=1e-4):
        raise ValueError(f"world_from_splat: expected one positive scale for all axes, got {lengths.tolist()}")
    rotation = linear / lengths.mean()
    if not torch.allclose(rotation.T @ rotation, torch.eye(3, dtype=torch.float64), atol=1e-4):
        raise ValueError(f"world_from_splat: expected axes at right angles, got {linear.tolist()}")
    if rotation.det() < 0:
        raise ValueError(
            f"world_from_splat: expected a rotation, got a reflection: {linear.tolist()}; flip the sign of one axis"
        )
    return transform


def _is_list(values: object, count: int) -> bool:
    """Return whether a value is a sequence of ``count`` items and not a string."""
    return isinstance(values, Sequence) and not isinstance(values, str) and len(values) == count


def _number(name: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f"world_from_splat.{name}: expected numbers, got {value!r}")
    if isinstance(value, int) and abs(value) > sys.float_info.max:
        raise ValueError(f"world_from_splat.{name}: expected finite numbers, got {str(value)[:20]}…")
    return float(value)
