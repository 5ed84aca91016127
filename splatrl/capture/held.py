"""How cameras were held: which way is up by their axes and path, and whether these leave a doubt."""

import math

import numpy as np
from numpy.typing import NDArray

from splatrl.capture.upright import Held

Floats = NDArray[np.float64]

LARGEST_LEAN = math.radians(35.0)
"""How far people look up or down, and so how far off the cameras' own up may be where all of them look one way."""
ASKEW = 0.9
"""Fraction of what the right axes have in common along up that counts as a roll of all images, as by a crooked mount.
Cameras that turn to one side only do not tell such a roll from a lean, and the rest keeps their up near their own."""
LYING = (3.0, 0.1)
"""Minimum ratio between the spreads in a plane (second eigenvalues) of the cameras' up axes and of their right axes,
and minimum spread of the up axes, for a film that lies on its side; upright films have ratios of 0.03 to 0.4 and
spreads of up to 0.13."""
LOOKS_UP = math.radians(5.0)
"""Minimum mean tilt above the horizon of cameras that look up. People hold cameras level or look down, by 0° to 28° in
trials."""
RISES = 0.6
"""Share of a path along up from which up must be wrong, or the camera rose; where up is right and people walk, it is
0.1 at most, and 0.32 on stairs."""
FLAT_PATH = 0.1
"""Maximum share of a path along the direction in which it is narrowest, of those perpendicular to the images' right
axes, if that is up. In trials it is 0.03 for cameras that sweep up and down, and 0.35 to 0.67 in walks around a place
whose images lie on their side."""
ALONG_OWN = (0.2, 0.65)
"""Minimum shares of a path along the images' own up axes, of its whole extent and of that perpendicular to their right
axes, for cameras that look steeply down and one way, or rise. On level ground the latter is the sine of the angle by
which cameras look down, and where they rise its cosine, so both may be true: what is seen of a floor decides."""
STRAIGHT_DOWN = (0.2, 0.7)
"""Maximum cosine between up and the images' own up axes (78°), and minimum cosine between it and the viewing
directions, for a camera that looks straight down: its own up axes hardly say which of the two ways is up."""


def cameras_up(camera_to_world: Floats) -> Held:
    """Return the direction to which the cameras' right axes all have one angle, near a right angle.

    Of its two ways, the one nearer to the cameras' own up axes is taken. Where all cameras look the same way, their
    right axes agree, and only the mean of their own up axes is left to decide. Cameras that look straight down have up
    behind them.

    Args:
        camera_to_world: [N, 4, 4], OpenCV camera axes.
    """
    right = camera_to_world[:, :3, 0]
    own, forward = -camera_to_world[:, :3, 1].mean(0), camera_to_world[:, :3, 2].mean(0)
    weights, up, side, lean = np.ones(len(right)), own, own, 0.0
    for _ in range(10):  # reweighted against a few cameras that are rolled unlike the rest
        weights = weights / weights.sum()
        spread, common = (right * weights[:, None]).T @ right, weights @ right
        values, axes = np.linalg.eigh(spread)
        side = axes[:, 2]
        if values[1] < 4 * values[0] or values[1] < 0.003:
            up, lean = own - side * (own @ side), LARGEST_LEAN
            break
        left, vectors = np.linalg.eigh(spread - ASKEW * np.outer(common, common))
        up = vectors[:, 0]
        lean = math.atan(math.sqrt(max(left[0], 0.0) / values[1]))
        weights = 1.0 / np.maximum(np.abs((right - ASKEW * common) @ up), 0.02)
    up = up / np.linalg.norm(up)
    straight_down = abs(up @ own) < STRAIGHT_DOWN[0] and abs(up @ forward) > STRAIGHT_DOWN[1]
    return Held(up if up @ (-forward if straight_down else own) >= 0 else -up, side, lean)


def share_along(centers: Floats, direction: Floats) -> float:
    """Return how much of the extent of a path lies along a unit vector, 0 to 1 (root mean squares); 0 without extent.

    People walk on level ground, so little lies along up.

    Args:
        centers: [N, 3] positions of the cameras.
        direction: [3].
    """
    off = centers - centers.mean(0)
    whole = float(np.linalg.norm(off))
    return float(np.linalg.norm(off @ direction)) / whole if whole > 0.0 else 0.0


def _runs_along(centers: Floats, own: Floats, side: Floats) -> bool:
    """Return whether a path runs along the images' own up axis, and is flat perpendicular to their right axis."""
    along, across = share_along(centers, own), share_along(centers, side)
    return _is_flat(centers, side) and along > max(ALONG_OWN[0], ALONG_OWN[1] * math.sqrt(max(0.0, 1.0 - across**2)))


def _is_flat(centers: Floats, side: Floats) -> bool:
    """Return whether a path is flat in one of the directions perpendicular to ``side``."""
    return share_along(centers, _narrowest(centers, side)) <= FLAT_PATH


def _narrowest(centers: Floats, side: Floats) -> Floats:
    """Return the unit vector perpendicular to ``side`` along which a path extends least."""
    plane = np.linalg.svd(side[None])[2][1:]
    return np.asarray(np.linalg.eigh(np.cov(plane @ centers.T))[1][:, 0] @ plane)


def on_its_side(camera_to_world: Floats) -> bool:
    """Return whether the images lie on their side, as in a film that a phone began while it pointed downwards.

    People walk on level ground, with turns. So the path is broad in all directions perpendicular to the right axes of
    such images, but flat in one of them where an upright camera ``sweeps`` up and down.

    Args:
        camera_to_world: [N, 4, 4], OpenCV camera axes, in any frame.
    """
    return sweeps(camera_to_world) and not _is_flat(camera_to_world[:, :3, 3], cameras_up(camera_to_world).side)


def sweeps(camera_to_world: Floats) -> bool:
    """Return whether the images turn about their right axes, rather than about their up axes.

    A person who turns around with an upright camera sweeps its right axis through the horizontal plane, and hardly
    moves its up axis. So such images lie on their side, or were taken by one who swept an upright camera up and down.

    Args:
        camera_to_world: [N, 4, 4], OpenCV camera axes, in any frame.
    """
    right, own = (
        float(np.linalg.eigvalsh(axes.T @ axes / len(axes))[1])
        for axes in (camera_to_world[:, :3, 0], camera_to_world[:, :3, 1])
    )
    return own > max(LYING[0] * right, LYING[1])


def if_steeply_down(camera_to_world: Floats) -> Held | None:
    """Return which way is up if cameras that look one way look steeply down; None if they clearly do not.

    In a drone's survey, a camera that looks straight down and is always turned one way has the axes and the path of one
    that looks ahead and rises along the front of a house: only what it sees tells one from the other.

    Args:
        camera_to_world: [N, 4, 4], OpenCV camera axes, in any frame.
    """
    held, centers = cameras_up(camera_to_world), camera_to_world[:, :3, 3]
    if held.lean < LARGEST_LEAN or not _runs_along(centers, held.up, held.side):
        return None
    up, forward = _narrowest(centers, held.side), camera_to_world[:, :3, 2].mean(0)
    return held._replace(up=up if up @ forward < 0 else -up)


def looks_up(camera_to_world: Floats, points: Floats, up: Floats, overhead: float) -> bool:
    """Return whether cameras look up on average, at a place more than a fraction of which is above them.

    Args:
        camera_to_world: [N, 4, 4], OpenCV camera axes.
        points: [P, 3].
        up: [3], what is taken for up.
        overhead: the fraction of the points.
    """
    looks = float((camera_to_world[:, :3, 2] @ up).mean())
    above = float((points @ up > np.median(camera_to_world[:, :3, 3] @ up)).mean())
    return looks > math.sin(LOOKS_UP) and above > overhead
