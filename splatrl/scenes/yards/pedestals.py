"""Things to put the egg on, at a place of the yard."""

from dataclasses import replace

import numpy as np

from splatrl.scenes.yard.furniture import log, plinth
from splatrl.scenes.yard.layout import Solid
from splatrl.scenes.yard.materials import Rng, brickwork, plaster, shades, waves
from splatrl.scenes.yard.surfels import Surfels, faces, join, lathe, painted
from splatrl.scenes.yards.style import Style


def stump(x: float, y: float, height: float, style: Style, rng: Rng) -> Surfels:
    """Build an upright log to put an egg on."""
    upright = log((0.0, 0.0, 0.0), 0.11, height, rng)
    turn = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])  # x becomes z
    return replace(
        upright,
        means=upright.means @ turn.T + np.array([x, y, 0.0]),
        axes=turn @ upright.axes,
        normals=upright.normals @ turn.T,
    )


def stone(x: float, y: float, height: float, style: Style, rng: Rng) -> Surfels:
    """Build a stone to put an egg on."""
    return plinth(x, y, height, style.stone, rng)


def upturned(x: float, y: float, height: float, style: Style, rng: Rng) -> Surfels:
    """Build an upside-down pot to put an egg on."""
    outline = [(0.125, 0.0), (0.125, 0.05), (0.112, 0.05), (0.085, height), (0.003, height)]
    clay = lathe((x, y, 0.0), outline, 0.018)
    return painted(
        clay, shades(style.paint[0], 0.06 * waves(clay.means, rng, 0.15) + 0.04 * rng.normal(size=len(clay)))
    )


def pillar(x: float, y: float, height: float, style: Style, rng: Rng) -> Surfels:
    """Build a pillar of four courses of bricks to put an egg on."""
    solid = Solid("pillar", (x - 0.1, y - 0.1, 0.0), (x + 0.1, y + 0.1, height))
    sides = [
        brickwork(face, rng, (0.1, height / 4), (3, 2), style.brick)
        for face in faces(solid.low, solid.high, "+x-x+y-y")
    ]
    return join([*sides, plaster(faces(solid.low, solid.high, "+z")[0], rng, style.stone, 0.02)])


UNDER_THE_EGG = (stump, stone, upturned, pillar)
