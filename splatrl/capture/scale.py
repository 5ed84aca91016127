"""Metres per unit of a reconstruction, from two clicked points or from GPS, compared with what else was stated."""

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from splatrl.capture.base import CaptureError, Reconstruction
from splatrl.values import require_number

Floats = NDArray[np.float64]
ScaleFrom = Literal["recorded", "marker", "distance", "camera_height", "gps", "unknown"]

NEAREST = 12
"""Number of points around a click that determine how far away it is."""
CLICK_ERROR = 6.0
"""Largest error of a click, pixels."""
FARTHEST = 0.1
"""Maximum distance of the points around a click, as a fraction of the image's width."""

DEGREE = 111_195.0
"""Metres per degree of latitude."""
LEAST_PLACES, MOST_ERROR = 5, 0.1
"""Minimum number of photos with a GPS position, and maximum relative error of GPS, for it to set the scale."""

AGREE = 1.2
"""Maximum ratio of a stated length to the same length by the source of the scale."""
SCALED_BY = {
    "recorded": ("recorded", "Check what you stated, or leave it out."),
    "marker": ("from the marker", "Was the page printed at 100 %? Give --marker-side as measured."),
    "distance": ("from --distance", "Measure both again."),
}
"""How the scale is known, in words, and what to check where a stated length contradicts it."""


@dataclass(frozen=True)
class Click:
    """A position in an image of a reconstruction, pixels from its upper left corner.

    Attributes:
        image: the image's file name, or its index.
        x: pixels from the left edge.
        y: pixels from the upper edge.
    """

    image: int | str
    x: float
    y: float


@dataclass(frozen=True)
class Distance:
    """Two points that are a known distance apart, each clicked in one image, or in several for more accuracy.

    Attributes:
        start: clicks on one point.
        end: clicks on the other.
        metres: distance between them.

    Raises:
        ValueError: for a point without a click, or a distance that is not above 0.
    """

    start: tuple[Click, ...]
    end: tuple[Click, ...]
    metres: float

    def __post_init__(self) -> None:
        if not (self.start and self.end):
            raise ValueError("distance: expected at least one click for each point, got none")
        require_number("distance", self.metres, above=0.0, unit="metres")

    @classmethod
    def between(cls, start: Click, end: Click, metres: float) -> "Distance":
        """Return the distance between two points clicked once each, in one image or in two."""
        return cls((start,), (end,), metres)


def scale_by_distance(reconstruction: Reconstruction, distance: Distance) -> float:
    """Return metres per unit from two clicked points.

    Raises:
        CaptureError: where a click has no depth, or the two are one point.
    """
    start, end = (clicked_point(reconstruction, clicks) for clicks in (distance.start, distance.end))
    apart = float(np.linalg.norm(end - start))
    if apart < 1e-9:
        raise CaptureError(
            "distance: expected two different points, got the same one twice; click points that are far apart"
        )
    return distance.metres / apart


def scale_by_gps(gps: Tensor | None, plan: Floats) -> tuple[float, float] | None:
    """Return metres per unit from the photos' GPS, by the similarity that fits the cameras' plan best.

    Heights do not count: those of GPS are several times worse.

    Args:
        gps: [N, 2], as in ``Reconstruction``.
        plan: [N, 2] positions of the cameras from above, in any unit.

    Returns:
        The scale and its possible relative error: the residuals of the fit over the positions' distances from their
        mean (root mean squares). None where that is too large, or too few photos have a position.
    """
    if gps is None:
        return None
    known = ~gps.isnan().any(1).numpy()
    if known.sum() < LEAST_PLACES:
        return None
    latitude, longitude = gps.numpy()[known].T
    east = np.mod(longitude - longitude[0] + 180.0, 360.0) - 180.0  # also across the date line
    told = DEGREE * np.stack([east * math.cos(math.radians(latitude[0])), latitude - latitude[0]], 1)
    a, b = plan[known] @ [1, 1j], told @ [1, 1j]  # a rotation and a scale are one complex factor
    a, b = a - a.mean(), b - b.mean()
    if not (a.any() and b.any()):
        return None
    factor = np.vdot(a, b) / np.vdot(a, a)
    error = float(np.linalg.norm(b - factor * a) / np.linalg.norm(b))
    return (float(abs(factor)), error) if error <= MOST_ERROR else None


def contradiction(
    reconstruction: Reconstruction,
    scale: float,
    scale_from: ScaleFrom,
    height: float,
    distance: Distance | None,
    camera_height: float | None,
) -> str | None:
    """Return how a stated distance or height differs from what it is by the source of the scale; None if it does not.

    Args:
        reconstruction: cameras and points in any frame.
        scale: metres per unit.
        scale_from: source of the scale.
        height: height of the cameras above the floor by that scale, metres.
        distance: two clicked points with the metres between them, if stated.
        camera_height: the height that was stated, metres; None where it cannot be compared.
    """
    told = []
    if camera_height is not None:
        told.append((f"the camera was {height:.2f} m above the floor; --camera-height", height, camera_height))
    if distance is not None:
        apart = distance.metres * scale / scale_by_distance(reconstruction, distance)
        told.append((f"the two clicked points are {apart:.2f} m apart; --distance", apart, distance.metres))
    for words, measured, stated in told:
        if max(measured / stated, stated / measured) > AGREE:
            source, advice = SCALED_BY[scale_from]
            return f"The scale is {source}, by which {words} said {stated:g} m. {advice}"
    return None


def clicked_point(reconstruction: Reconstruction, clicks: Sequence[Click]) -> Floats:
    """Return the clicked point [3], from the depth of the points around it and from where rays of several images meet.

    Raises:
        CaptureError: for an image that does not exist, rays that do not meet, or a click without points around it.
    """
    rows = [_row(reconstruction, click.image) for click in clicks]
    if len(set(rows)) == 1:
        return _by_points(reconstruction, rows[0], clicks[0])
    poses = reconstruction.camera_to_world[rows].numpy()
    met = triangulate(poses, reconstruction.K.numpy(), np.array([[click.x, click.y] for click in clicks]))
    estimates = [met]
    reach = _uncertainty(poses[:, :3, 3], met, float(reconstruction.K[0, 0]))
    for row, click in zip(rows, clicks, strict=True):
        with suppress(CaptureError):  # without points around it, only the rays count
            point = _by_points(reconstruction, row, click)
            if np.linalg.norm(point - met) <= reach:  # otherwise they lie in front of or behind it
                estimates.append(point)
    middle: Floats = np.median(estimates, axis=0)
    return middle


def _row(reconstruction: Reconstruction, image: int | str) -> int:
    """Return the index of an image that is given by its file name or its index."""
    paths = reconstruction.paths
    if isinstance(image, str):
        names = [path.name for path in paths]
        if image not in names:
            raise CaptureError(
                f"distance: expected an image with a pose in {paths[0].parent}, such as {names[0]}, got {image}"
            )
        return names.index(image)
    if not 0 <= image < len(paths):
        raise CaptureError(f"distance: expected an image index from 0 to {len(paths) - 1}, got {image}")
    return image


def _uncertainty(centers: Floats, point: Floats, focal: float) -> float:
    """Return how far clicks that are ``CLICK_ERROR`` off may move the point where their rays meet, along these rays."""
    ways = point - centers
    lengths = np.linalg.norm(ways, axis=1)
    cosine = float(((ways / lengths[:, None]) @ (ways / lengths[:, None]).T).min())
    sine = math.sqrt(max(1.0 - cosine**2, 1e-12))
    return float(np.median(lengths)) * max(0.02, CLICK_ERROR / (focal * sine))


def triangulate(camera_to_world: Floats, K: Floats, pixels: Floats) -> Floats:
    """Return the point [3] with the least squared reprojection error in V cameras, pixels.

    Args:
        camera_to_world: [V, 4, 4].
        K: [3, 3].
        pixels: [V, 2].

    Raises:
        CaptureError: where the rays are parallel.
    """
    centers = camera_to_world[:, :3, 3]
    rays = rays_through(camera_to_world, K, pixels)
    across = np.eye(3) - rays[:, :, None] * rays[:, None]
    system = across.sum(0)
    if np.linalg.eigvalsh(system)[0] < 1e-6 * len(rays):
        raise CaptureError(
            "distance: expected a point seen from different directions, got parallel rays; click it in another image"
        )
    point = np.linalg.solve(system, (across @ centers[..., None])[..., 0].sum(0))
    for _ in range(5):  # Gauss-Newton
        seen = np.einsum("vji,vj->vi", camera_to_world[:, :3, :3], point - centers) @ K.T
        error = seen[:, :2] / seen[:, 2:] - pixels
        turned = np.einsum("ij,vkj->vik", K, camera_to_world[:, :3, :3])
        slope = (turned[:, :2] - (seen[:, :2] / seen[:, 2:])[..., None] * turned[:, 2:]) / seen[:, 2:, None]
        point = point - np.linalg.lstsq(slope.reshape(-1, 3), error.reshape(-1), rcond=None)[0]
    return point


def rays_through(camera_to_world: Floats, K: Floats, pixels: Floats) -> Floats:
    """Return the unit directions [V, 3], in the world, of the rays through pixels [V, 2], one per camera."""
    local = np.concatenate([pixels, np.ones((len(pixels), 1))], 1) @ np.linalg.inv(K).T
    rays = np.einsum("vij,vj->vi", camera_to_world[:, :3, :3], local)
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)


def _by_points(reconstruction: Reconstruction, row: int, click: Click) -> Floats:
    """Return the point [3] where the ray of a click in the image ``row`` meets the surface through the points there."""
    pose, K = reconstruction.camera_to_world[row].numpy(), reconstruction.K.numpy()
    seen = reconstruction.seen_point[reconstruction.seen_by == row].unique()
    local = (reconstruction.points[seen].numpy() - pose[:3, 3]) @ pose[:3, :3]
    local = local[local[:, 2] > 0]
    offsets = (local @ K.T)[:, :2] / local[:, 2:] - [click.x, click.y]
    apart = np.linalg.norm(offsets, axis=1)
    order = np.argsort(apart, kind="stable")[:NEAREST]
    order = order[apart[order] <= FARTHEST * reconstruction.width]
    if len(order) < 3:
        raise CaptureError(
            f"distance: expected at least 3 points of the reconstruction around ({click.x:g}, {click.y:g}) in image "
            f"{click.image}, found {len(order)}; click where there is texture, or click the point in a second image too"
        )
    inverse = _plane_at_zero(offsets[order], 1.0 / local[order, 2])
    ray = np.linalg.inv(K) @ [click.x, click.y, 1.0]
    point: Floats = pose[:3, 3] + pose[:3, :3] @ (ray / inverse)
    return point


def _plane_at_zero(offsets: Floats, inverse: Floats) -> float:
    """Return the inverse depth at the click, from a plane (linear in pixels) that is reweighted against outliers."""
    middle = float(np.median(inverse))
    width = np.median(np.linalg.norm(offsets, axis=1)) + 1e-9
    near = 1.0 / (1.0 + (np.linalg.norm(offsets, axis=1) / width) ** 2)
    terms = np.concatenate([offsets / width, np.ones((len(offsets), 1))], 1)
    pull = np.diag([0.3, 0.3, 0.0])  # regularises towards a plane that faces the camera
    weights = near / (1.0 + ((inverse - middle) / (0.1 * middle)) ** 2)
    value = middle
    for _ in range(10):
        normal = (terms * weights[:, None]).T @ terms + 0.1 * weights.sum() * pull
        solved = np.linalg.solve(normal, terms.T @ (weights * inverse))
        value = float(solved[2])
        residual = np.abs(terms @ solved - inverse)
        weights = near / (1.0 + (residual / (np.median(residual) + 0.005 * middle)) ** 2)
    return value if value > 0.2 * middle else middle
