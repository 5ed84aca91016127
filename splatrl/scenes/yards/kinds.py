"""Kinds of things in generated yards: those in the robots' way, and those at the edge."""

from collections.abc import Callable
from dataclasses import dataclass

from splatrl.scenes.yard.materials import Rng
from splatrl.scenes.yard.surfels import Surfels
from splatrl.scenes.yards.buildings import kennel, shed, wall
from splatrl.scenes.yards.furniture import (
    barrel,
    bench,
    bench_solids,
    boulder,
    column,
    crates,
    pile,
    sandbox,
    sandbox_solids,
    table,
    table_solids,
)
from splatrl.scenes.yards.greenery import bush, clipped, planter, potted, screen
from splatrl.scenes.yards.solids import Size, Solids, whole
from splatrl.scenes.yards.style import Style


@dataclass(frozen=True)
class Kind:
    """A kind of thing.

    Attributes:
        build: function that builds its surfels.
        least: smallest size, metres.
        most: largest size, metres.
        solids: function that returns the solid parts of a thing of a given size.
        round: whether it fills the ellipse in its box rather than the box; it is then as wide as it is deep.
        pad: distance by which its surfels reach beyond its size on each side, metres.
    """

    build: Callable[[Size, Style, Rng], Surfels]
    least: Size
    most: Size
    solids: Callable[[Size], Solids] = whole
    round: bool = False
    pad: float = 0.025


IN_THE_WAY = {
    "wall": Kind(wall, (0.8, 0.08, 0.5), (1.5, 0.1, 0.7)),
    "clipped": Kind(clipped, (0.6, 0.26, 0.55), (1.3, 0.36, 0.75), pad=0.085),
    "planter": Kind(planter, (0.5, 0.32, 0.56), (0.9, 0.42, 0.68), pad=0.04),
    "potted": Kind(potted, (0.3, 0.3, 0.66), (0.4, 0.4, 0.8), round=True, pad=0.05),
    "bush": Kind(bush, (0.5, 0.5, 0.55), (0.75, 0.75, 0.85), round=True, pad=0.05),
    "table": Kind(table, (0.45, 0.3, 0.43), (0.8, 0.4, 0.43), table_solids),
    "bench": Kind(bench, (0.7, 0.36, 0.75), (1.1, 0.42, 0.85), bench_solids, pad=0.045),
    "pile": Kind(pile, (0.44, 0.28, 0.5), (0.8, 0.32, 0.62), pad=0.02),
    "crates": Kind(crates, (0.34, 0.3, 0.5), (0.46, 0.4, 0.6)),
    "boulder": Kind(boulder, (0.4, 0.4, 0.5), (0.6, 0.6, 0.6), round=True),
    "barrel": Kind(barrel, (0.36, 0.36, 0.6), (0.46, 0.46, 0.75), round=True),
    "screen": Kind(screen, (0.8, 0.06, 0.9), (1.4, 0.08, 1.3), pad=0.045),
    "kennel": Kind(kennel, (0.46, 0.5, 0.6), (0.56, 0.6, 0.7)),
    "column": Kind(column, (0.32, 0.32, 0.48), (0.4, 0.4, 0.53), round=True, pad=0.015),
}
"""Kinds that stand where robots walk; each reaches the height of the robots' bodies."""
AT_THE_EDGE = {
    **{name: IN_THE_WAY[name] for name in ("planter", "potted", "bench", "pile", "boulder", "barrel", "crates")},
    "bush": Kind(bush, (0.7, 0.7, 0.7), (1.2, 1.2, 1.3), round=True, pad=0.05),
    "shed": Kind(shed, (1.3, 1.1, 1.7), (1.9, 1.5, 2.0)),
    "sandbox": Kind(sandbox, (1.0, 1.0, 0.2), (1.4, 1.2, 0.26), sandbox_solids),
    "big table": Kind(table, (1.1, 0.7, 0.7), (1.5, 0.85, 0.75), table_solids),
}
