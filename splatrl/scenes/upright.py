"""Guesses which way is up in a splat file, where its floor is, and what its units are."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from splatrl.geometry import quats_to_rotations
from splatrl.scenes.gaussians import Gaussians
from splatrl.scenes.layers import ALIGNED, Layer, heavy_layers, layer_at, leaning_layer
from splatrl.scenes.scene import captured
from splatrl.scenes.sides import LIKELY_FROM, SURE_FROM, upper_side
from splatrl.scenes.storeys import find_storeys
from splatrl.scenes.walls import CLEAR, find_walls

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

SURE, LIKELY, GUESS, GIVEN = "fairly sure", "likely", "only a guess", "given"
UNKNOWN = "unknown"
IF_WRONG = "; if wrong, pass --up"

_SAMPLE = 20_000
_THICKNESS = 0.02
"""Thickness of a layer on either side of its plane, in diagonals of the scene."""
_MIN_OPACITY = 0.3
_SNAP = math.cos(math.radians(1.0))
"""Cosine of the angle within which up counts as an axis of the file."""
_NEAR_AXIS = math.cos(math.radians(15.0))
_PREFERENCE = 2.0
"""Factor on the evidence of a layer whose normal is within 15° of a file axis: most files stand nearly upright."""
_STATED = 3.0
"""Factor on that of a layer whose normal is within 15° of the axis that the file itself calls vertical."""
_CORRIDOR = (0.4, 2.0)
"""Minimum ratio of a corridor's width to its height, or the reverse, and of its length to the larger of both."""
_BARE = 0.05
"""Added to the fraction that stands upright on a layer, so that a bare floor counts as a floor."""
_ACROSS = math.cos(math.radians(78.0))
"""Maximum cosine between up and the normal of a Gaussian that stands upright."""
_SURE, _LIKELY = 2.5, 1.5
"""Minimum ratios of a layer's evidence to the next direction's for ``SURE`` and ``LIKELY``."""
_ROOM = (2.2, 3.0)
"""Range of the heights of most rooms, metres."""
_ROOM_HEIGHT = 2.5
_ALIKE = 0.6
"""Minimum ratio of flat surfaces at one end of a corridor to those at the other."""
_END = 0.15
"""Fraction of a corridor's height or width, from either end, within which surfaces belong to floor, ceiling or wall."""


@dataclass(frozen=True)
class Guess:
    """A conclusion drawn from the Gaussians alone.

    Attributes:
        confidence: level of confidence, in words.
        reason: evidence for the conclusion.
    """

    confidence: str
    reason: str

    def __str__(self) -> str:
        return f"{self.confidence}: {self.reason}"


@dataclass(frozen=True, eq=False)
class Upright:
    """A guess at how a scene stands in its file.

    Attributes:
        up: [3] unit vector in the file's frame.
        floor: height of the floor along ``up`` from ``origin``, file units.
        ceiling: height of the ceiling along ``up`` from ``origin``, file units; None if there is none.
        metres_per_unit: scale of the file; 1 if nothing indicates another value.
        axis_guess: confidence in the axis of ``up``, without its sign.
        sign_guess: confidence in the sign of ``up``.
        floor_guess: confidence in the floor.
        units_guess: confidence in the units.
        walls: [3] unit vector along the longest wall, in the file's frame; None where no walls are clear.
        origin: [3] point of the file that becomes x = y = 0 of the world; not the file's own origin in a georeferenced
            file.
    """

    up: Floats
    floor: float
    ceiling: float | None
    metres_per_unit: float
    axis_guess: Guess
    sign_guess: Guess
    floor_guess: Guess
    units_guess: Guess
    walls: Floats | None = None
    origin: Sequence[float] = (0.0, 0.0, 0.0)

    def __str__(self) -> str:
        rows = [
            f"up          {axis_name(self.up) or np.round(self.up, 4).tolist()}",
            f"  axis      {self.axis_guess}",
            f"  sign      {self.sign_guess}",
            f"floor       at {self.floor:.3g} units along up; {self.floor_guess}",
            *(["walls       x and y run along them"] if self.walls is not None else []),
            f"units       {self.metres_per_unit:.4g} metres per unit; {self.units_guess}",
        ]
        return "\n".join(rows)


def axis_name(direction: ArrayLike) -> str | None:
    """Return the signed axis within 1° of a direction, such as "-y", or None."""
    vector = np.asarray(direction, np.float64)
    axis = int(np.abs(vector).argmax())
    if abs(vector[axis]) < _SNAP * np.linalg.norm(vector):
        return None
    return ("-" if vector[axis] < 0 else "") + "xyz"[axis]


def guess_upright(
    gaussians: Gaussians,
    up: ArrayLike | None = None,
    roughly: bool = False,
    vertical: ArrayLike | None = None,
) -> Upright:
    """Guess up, the floor, the walls and the units from the positions and orientations of opaque Gaussians.

    The ground is the layer that holds the most Gaussians, mainly those that lie flat in it, and on which the most
    stands upright; the floors and ceilings of several storeys count together, and directions near a file axis are
    preferred. Rival layers lower the confidence. Which way along the normal of the ground is up, what stands on it or
    on the floors above and below it tells (``sides.py``). The guess fails for scenes without ground. A layer is as
    thick as the captured place suggests, without sky and other surroundings that are far larger. In what could be a
    corridor, which looks much the same on its side, the axis is only a guess unless the file states which one is
    vertical.

    Args:
        gaussians: Gaussians in the file's frame.
        up: [3] the up direction, if it is known; then only the floor and the units are guessed.
        roughly: whether ``up`` is known only to about 15°; it is then refined to fit floors and walls.
        vertical: [3] direction that the file states to be up or down, which decides between similar layers.
    """
    points, normals, weights = _surfaces(gaussians)
    place = captured(gaussians).means.detach().double().cpu().numpy()
    near = ((points >= place.min(0)) & (points <= place.max(0))).all(1)
    size = float(np.linalg.norm(np.subtract(*np.quantile(points[near], [0.99, 0.01], axis=0)))) or 1.0
    if up is None:
        layer, axis_guess = _ground(points, normals, weights, near, _THICKNESS * size, vertical)
    else:
        given = np.asarray(up, np.float64)
        layer = layer_at(points, normals, weights, given / np.linalg.norm(given), _THICKNESS * size)
        axis_guess = Guess(GIVEN, "up is stated, not guessed")
        if roughly:
            layer, leans = _snapped(points, normals, weights, layer), layer.normal
            angle = math.degrees(math.acos(min(1.0, float(leans @ layer.normal))))
            axis_guess = Guess(GIVEN, f"up is stated; floor and walls lean by {angle:.1f}° from it")
    heights = points @ layer.normal
    if near[np.abs(heights - layer.height) <= layer.thickness].mean() < 0.5:  # the place is an object on wide ground
        near = np.ones_like(near)
    storeys = find_storeys(points[near], normals[near], weights[near], layer.normal)
    if up is None and not _along(layer, vertical):
        axis_guess = _doubted(axis_guess, points[near], normals[near], layer)
    evidence, reason = upper_side(heights, weights, layer, storeys, size)
    sign_guess = axis_guess
    if up is None:
        strength = abs(evidence)
        sign_guess = Guess(SURE if strength > SURE_FROM else LIKELY if strength > LIKELY_FROM else GUESS, reason)
    sign = -1 if up is None and evidence < 0 else 1
    floor, ceiling = sign * layer.height, None
    share = float(weights[np.abs(heights - layer.height) <= layer.thickness].sum())
    told = f"{share:.0%} of the opacity lies in this flat layer"
    if len(storeys.levels) > 1:
        lowest, second = storeys.levels[::sign][:2]
        floor, ceiling = sign * lowest.height, min(sign * second.bottom, sign * second.top)
        told += " or in one above it"
    floor_guess = Guess(
        SURE if share > 0.3 and sign_guess.confidence in (SURE, GIVEN) else LIKELY if share > 0.15 else GUESS, told
    )
    if ceiling is None and sign * evidence < -LIKELY_FROM:
        floor = float(np.quantile(heights[near], 0.02))
        floor_guess = Guess(GUESS, "the main layer lies above the rest, so this is only the bottom of the scene")
    scale, units_guess = _units(None if ceiling is None else ceiling - floor)
    up = sign * layer.normal
    above, below = floor + layer.thickness, math.inf if ceiling is None else ceiling
    walls = _walls(points[near & (points @ up > above) & (points @ up < below)], up)
    return Upright(up, floor, ceiling, scale, axis_guess, sign_guess, floor_guess, units_guess, walls)


def _ground(
    points: Floats, normals: Floats, weights: Floats, near: Mask, thickness: float, vertical: ArrayLike | None
) -> tuple[Layer, Guess]:
    """Return the layer with the most evidence of being the ground, and how clearly it beats its rivals."""
    layers = [
        leaning_layer(points, normals, weights, layer) for layer in heavy_layers(points, normals, weights, thickness)
    ]
    evidence = [
        _evidence(normals, weights, layer, _floors(points[near], normals[near], weights[near], layer), vertical)
        for layer in layers
    ]
    order = np.argsort(evidence)[::-1]
    ratio = evidence[order[0]] / max(evidence[order[1]] if len(order) > 1 else 0.0, 1e-9)
    guess = Guess(
        SURE if ratio > _SURE else LIKELY if ratio > _LIKELY else GUESS,
        f"evidence for a ground layer is {min(ratio, 99):.1f} times that of the next direction"
        f"{', also because the file calls it vertical' if _along(layers[order[0]], vertical) else ''}{IF_WRONG}",
    )
    return _snapped(points, normals, weights, layers[order[0]], lean=False), guess


def _along(layer: Layer, vertical: ArrayLike | None) -> bool:
    """Return whether a layer's normal is within 15° of the direction that a file calls vertical, if it does."""
    if vertical is None:
        return False
    stated = np.asarray(vertical, np.float64)
    return bool(abs(layer.normal @ stated) > _NEAR_AXIS * np.linalg.norm(stated))


def _doubted(guess: Guess, points: Floats, normals: Floats, layer: Layer) -> Guess:
    """Return a guess at the axis, lowered where the layer and its opposite bound a corridor, perhaps on its side."""
    across = points @ np.linalg.svd(layer.normal[None])[2][1:].T
    across -= across.mean(0)
    across = across @ np.linalg.eigh(across.T @ across)[1]
    heights = points @ layer.normal
    bottom, top = np.quantile(heights, [0.02, 0.98])
    width, length = np.subtract(*np.quantile(across, [0.98, 0.02], axis=0))
    narrow, wide = sorted((float(width), float(top - bottom)))
    if narrow == 0.0 or narrow < _CORRIDOR[0] * wide or length < _CORRIDOR[1] * wide:
        return guess
    share = (heights[np.abs(normals @ layer.normal) > ALIGNED] - bottom) / (top - bottom)
    fewer, more = sorted((int((share < _END).sum()), int((share > 1.0 - _END).sum())))
    if fewer < _ALIKE * more:
        return guess
    return Guess(GUESS, f"this could be a corridor, whose floor and walls are alike{IF_WRONG}")


def _floors(points: Floats, normals: Floats, weights: Floats, layer: Layer) -> float:
    """Return the weight of a layer or, if that is more, the one of a mean level for each storey between the levels.

    A floor and its ceiling are one storey, as two opposite walls would be, and say no more than one layer.
    """
    levels = find_storeys(points, normals, weights, layer.normal).levels
    if len(levels) < 2:
        return layer.weight
    heights, flat = points @ layer.normal, np.abs(normals @ layer.normal) > ALIGNED
    ends = [(level.bottom - layer.thickness, level.top + layer.thickness) for level in levels]
    within = np.any([(heights >= bottom) & (heights <= top) for bottom, top in ends], axis=0)
    return max(layer.weight, (1 - 1 / len(levels)) * float(weights[flat & within].sum()))


def _evidence(normals: Floats, weights: Floats, layer: Layer, floors: float, vertical: ArrayLike | None) -> float:
    """Return the evidence that a layer is the ground.

    It comes from the weights of the layer, of all ``_floors`` together, and of the surfaces perpendicular to it.
    """
    flatness = np.linalg.norm(normals, axis=1)
    across = (np.abs(normals @ layer.normal) < _ACROSS * flatness) & (flatness > 0.5)
    prefers = _PREFERENCE if np.abs(layer.normal).max() > _NEAR_AXIS else 1.0
    prefers *= _STATED if _along(layer, vertical) else 1.0
    return prefers * layer.weight * floors * (_BARE + float(weights[across].sum()))


def _walls(points: Floats, up: Floats) -> Floats | None:
    """Return the direction of the longest wall among points above the floor, [3]; None if it is not clear."""
    across = np.linalg.svd(up[None])[2][1:]
    walls = find_walls(points @ across.T)
    return np.array([math.cos(walls.yaw), math.sin(walls.yaw)]) @ across if walls.gap > CLEAR else None


def _snapped(points: Floats, normals: Floats, weights: Floats, layer: Layer, lean: bool = True) -> Layer:
    """Tilt a layer to fit the surfaces, then align it with an axis of the file if it is within 1° of one."""
    layer = leaning_layer(points, normals, weights, layer) if lean else layer
    if (name := axis_name(layer.normal)) is None:
        return layer
    axis = np.eye(3)["xyz".index(name[-1])]
    return layer_at(points, normals, weights, -axis if name[0] == "-" else axis, layer.thickness)


def _surfaces(gaussians: Gaussians) -> tuple[Floats, Floats, Floats]:
    """Return means, short axes (length: flatness, 0 to 1) and weights of at most 40,000 opaque Gaussians."""
    opaque = gaussians.opacities >= _MIN_OPACITY
    chosen = gaussians[opaque] if int(opaque.sum()) >= 10 else gaussians
    chosen = chosen[:: max(1, len(chosen.means) // _SAMPLE)]
    means, scales, opacities = (
        values.detach().double().cpu().numpy() for values in (chosen.means, chosen.scales, chosen.opacities)
    )
    axes = quats_to_rotations(chosen.quats).detach().double().cpu().numpy()
    normals = np.take_along_axis(axes, scales.argmin(1)[:, None, None], 2)[..., 0]
    short, middle, _ = np.sort(scales, 1).T
    # Weighted by area, a few large and blurred background Gaussians would outweigh a finely captured floor.
    return means, normals * (1 - short / middle)[:, None], opacities / opacities.sum()


def _units(room: float | None) -> tuple[float, Guess]:
    if room is None:
        return 1.0, Guess(UNKNOWN, "there is no ceiling to judge by; measure something and pass --distance")
    if _ROOM[0] <= room <= _ROOM[1]:
        return 1.0, Guess(LIKELY, f"floor and ceiling are {room:.2f} units apart, a usual room height in metres")
    return _ROOM_HEIGHT / room, Guess(
        GUESS, f"floor and ceiling are {room:.3g} units apart, assumed to be {_ROOM_HEIGHT} m"
    )
