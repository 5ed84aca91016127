"""Materials of surfaces: noise, bricks, boards and plaster."""

import numpy as np

from splatrl.scenes.yard.surfels import Array, Rectangle, Surfels, join

Rng = np.random.Generator
Color = tuple[float, float, float]


def waves(points: Array, rng: Rng, wavelength: float, count: int = 10) -> Array:
    """Return smooth noise of zero mean and unit variance: a sum of plane waves with random directions and phases.

    Args:
        points: [N, 3] positions, metres.
        rng: generator of the waves; every call draws new ones.
        wavelength: nominal wavelength, metres.
        count: number of waves.

    Returns:
        [N] noise at the points.
    """
    directions = rng.normal(size=(count, 3))
    directions *= (
        2 * np.pi / wavelength * rng.uniform(0.6, 1.6, (count, 1)) / np.linalg.norm(directions, axis=1, keepdims=True)
    )
    return np.sin(points @ directions.T + rng.uniform(0, 2 * np.pi, count)).sum(1) * np.sqrt(2 / count)


def shades(color: Color | Array, brightness: Array) -> Array:
    """Brighten or darken a colour, sRGB, [3] or [N, 3]: [N] relative changes -> [N, 3] in [0, 1]."""
    return np.clip(np.asarray(color) * (1 + brightness)[:, None], 0.0, 1.0)


def mixed(first: Color, second: Color, share: Array) -> Array:
    """Mix two colours: fraction [N] of the second, clipped to [0, 1] -> [N, 3]."""
    part = np.clip(share, 0.0, 1.0)[:, None]
    return (1 - part) * np.asarray(first) + part * np.asarray(second)


def plaster(rectangle: Rectangle, rng: Rng, color: Color, step: float, stain: float = 0.06) -> Surfels:
    """Build an even surface with stains."""
    st, size = rectangle.cells(step)
    points = rectangle.points(st)
    brightness = stain * waves(points, rng, 12 * step) + 0.5 * stain * rng.normal(size=len(st))
    return rectangle.surfels(st, size, shades(color, brightness))


def brickwork(
    rectangle: Rectangle,
    rng: Rng,
    brick: tuple[float, float],
    splits: tuple[int, int],
    palette: tuple[Color, Color],
    mortar: Color = (0.70, 0.67, 0.62),
) -> Surfels:
    """Build bricks in running bond, with lines of mortar drawn over their edges.

    Args:
        rectangle: face to cover.
        rng: generator of the colours.
        brick: width and height of a brick with one joint each, metres.
        splits: number of surfels in a brick, along and up.
        palette: two colours between which bricks vary.
        mortar: colour of the mortar.
    """
    bricks = bond(rectangle, brick)
    joint = 0.16 * brick[1]
    s, t, width, height = (part[:, None] for part in bricks.T)
    along, up = (part.ravel() for part in np.meshgrid(*((np.arange(n) + 0.5) / n - 0.5 for n in splits)))
    share = np.repeat(rng.normal(0.5, 0.35, len(bricks)), len(along))
    tone = np.repeat(0.13 * rng.normal(size=len(bricks)), len(along)) + 0.06 * rng.normal(size=len(share))
    places = np.stack([s + width * along, t + height * up], -1).reshape(-1, 2)
    sizes = np.repeat(bricks[:, 2:] / splits, len(along), axis=0)
    parts = [rectangle.surfels(places, sizes, mixed(*palette, share) * (1 + tone)[:, None])]
    pieces = (np.arange(splits[0]) + 0.5) / splits[0] - 0.5
    beds = np.stack(np.broadcast_arrays(s + width * pieces, t - 0.5 * height), -1).reshape(-1, 2)
    bed_sizes = np.repeat(bricks[:, 2:], splits[0], axis=0) * (1 / splits[0], 0.0) + (0.0, joint)
    inner = bricks[:, 0] - 0.5 * bricks[:, 2] > joint
    heads = bricks[inner, :2] - bricks[inner, 2:] * (0.5, 0.0)
    head_sizes = bricks[inner, 2:] * (0.0, 0.8) + (joint, 0.0)
    for places, sizes in ((beds, bed_sizes), (heads, head_sizes)):
        colors = shades(mortar, 0.06 * rng.normal(size=len(places)))
        parts.append(rectangle.surfels(places, sizes, colors, 0.06 * brick[0]))
    return join(parts)


def bond(rectangle: Rectangle, brick: tuple[float, float]) -> Array:
    """Lay bricks in running bond: every other row is shifted by half a brick, and rows end with cut bricks.

    Returns:
        [N, 4] centre along and up, width and height of each brick, metres on the rectangle.
    """
    rows = round(rectangle.height / brick[1])
    tall = rectangle.height / rows
    bricks = []
    for row in range(rows):
        edges = np.arange(-0.5 * (row % 2) * brick[0], rectangle.width + brick[0], brick[0])
        low, high = np.clip(edges[:-1], 0, rectangle.width), np.clip(edges[1:], 0, rectangle.width)
        middle = np.full(len(low), (row + 0.5) * tall)
        bricks.append(np.stack([(low + high) / 2, middle, high - low, np.full(len(low), tall)], -1)[high - low > 0.01])
    return np.concatenate(bricks)


def boards(
    rectangle: Rectangle,
    rng: Rng,
    color: Color,
    board: float,
    cell: tuple[float, float],
    upright: bool = True,
    contrast: float = 1.0,
) -> Surfels:
    """Build wooden boards side by side, each with its own tone and grain along it, and dark gaps between them.

    Args:
        rectangle: face to cover.
        rng: generator of tones and grain.
        color: colour of the wood.
        board: width of a board, metres.
        cell: size of a surfel across and along the grain, metres.
        upright: whether boards run up the rectangle rather than along it.
        contrast: scales the differences between boards and in the grain.
    """
    if not upright:
        rectangle = turned(rectangle)
    count = max(1, round(rectangle.width / board))
    wide = rectangle.width / count
    st, size = rectangle.cells(wide / max(1, round(wide / cell[0])), cell[1])
    index = np.minimum((st[:, 0] / wide).astype(int), count - 1)
    across = st[:, 0] / wide - index
    tone = 0.13 * rng.normal(size=count)[index]
    grain = 0.1 * np.sin(st[:, 0] * 2 * np.pi / (0.31 * wide) + 7.0 * tone * st[:, 1] + 40 * tone)
    grain += 0.06 * rng.normal(size=len(st))
    gap = np.where((across < 0.5 * size[0] / wide + 1e-6) & (count > 1), -0.38, 0.0)
    return rectangle.surfels(st, size, shades(color, contrast * (tone + grain) + gap))


def turned(rectangle: Rectangle) -> Rectangle:
    """Return the same rectangle described from its lower right corner: up becomes right, and left becomes up."""
    corner = np.asarray(rectangle.corner) + rectangle.width * np.asarray(rectangle.right)
    x, y, z = (float(v) for v in -np.asarray(rectangle.right))
    a, b, c = (float(v) for v in corner)
    return Rectangle((a, b, c), rectangle.up, (x, y, z), rectangle.height, rectangle.width)
