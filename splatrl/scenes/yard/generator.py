"""Assembles the backyard: things, then light, then sky."""

import numpy as np
import torch

from splatrl.geometry import rotations_to_quats
from splatrl.scenes.gaussians import Gaussians
from splatrl.scenes.yard.enclosure import enclosure
from splatrl.scenes.yard.furniture import furniture
from splatrl.scenes.yard.ground import bed, country, stones, turf
from splatrl.scenes.yard.layout import HALF_WIDTH, HOUSE, solids, trees
from splatrl.scenes.yard.light import lit, occluders
from splatrl.scenes.yard.materials import Rng
from splatrl.scenes.yard.plants import tree
from splatrl.scenes.yard.sky import sky
from splatrl.scenes.yard.surfels import Surfels, join
from splatrl.spherical_harmonics import C0


def backyard_gaussians(seed: int = 0, clutter: int = 0) -> Gaussians:
    """Generate a sunny backyard of 6 × 6 m: lawn, hedge, fence, brick wall, shed, trees, obstacles and a red egg.

    The task in it is the same for every seed; leaves, grain, clouds and the places of the trees vary. The same
    arguments give the same bytes.

    Args:
        seed: seed of the yard, at least 0.
        clutter: number of the arrangement, at least 0; any number above 0 moves pots, wood pile, barrel and bench, none
            of them towards the robots.

    Returns:
        About 50,000 Gaussians, spherical harmonics of degree 0, world frame, metres, ground at z = 0.
    """
    rng = np.random.default_rng([seed, 0])
    things = [
        turf(rng),
        stones(rng),
        *beds(rng),
        furniture(rng, clutter),
        enclosure(rng),
        *orchard(seed, rng),
        country((-HALF_WIDTH, -HALF_WIDTH, HALF_WIDTH, HALF_WIDTH), rng, offset=0.5),
    ]
    blockers = occluders([*solids(seed, clutter), HOUSE], trees(seed))
    return to_gaussians(join([lit(join(things), blockers), sky(rng)]))


def beds(rng: Rng) -> list[Surfels]:
    """Build beds of yellow and white flowers in front of the fence, and violet and white ones by the brick wall."""
    yellow, white, violet = (0.96, 0.79, 0.16), (0.95, 0.94, 0.90), (0.55, 0.35, 0.78)
    north = bed((-2.6, 1.6), (2.6, 2.97), (yellow, yellow, white), 19, rng)
    west = bed((-2.97, -2.65), (0.4, 2.4), (violet, violet, white), 10, rng)
    return [north, west]


def orchard(seed: int, rng: Rng) -> list[Surfels]:
    """Build the two trees of the yard, an apple tree and a darker one, and the trees beyond it."""
    apple, dark = ((0.28, 0.43, 0.14), (0.52, 0.64, 0.25)), ((0.16, 0.33, 0.14), (0.36, 0.52, 0.24))
    far = ((0.24, 0.38, 0.17), (0.42, 0.54, 0.28))
    kinds = [(2100, apple), (1700, dark)] + [(420, far)] * 6
    return [tree(spec, count, palette, rng) for spec, (count, palette) in zip(trees(seed), kinds, strict=True)]


def to_gaussians(part: Surfels) -> Gaussians:
    """Convert surfels with baked light to Gaussians."""
    sh = torch.from_numpy((part.colors - 0.5) / C0).float().unsqueeze(1)
    return Gaussians(
        means=torch.from_numpy(part.means).float(),
        quats=rotations_to_quats(torch.from_numpy(part.axes)).float(),
        scales=torch.from_numpy(part.scales).float(),
        opacities=torch.from_numpy(part.opacities).float(),
        sh=sh,
        batch_size=[len(part)],
    )
