"""Printed ArUco markers that give a capture its scale: their detection in images, and a page to print."""

from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from splatrl.capture.base import CaptureError, Reconstruction
from splatrl.capture.photo_files import read_photo
from splatrl.capture.progress import Progress, silent
from splatrl.capture.scale import triangulate
from splatrl.extras import require
from splatrl.files import replacing

Floats = NDArray[np.float64]

MARKER_SIDE = 0.16
"""Default side of a marker's black square, as on the printed page, metres."""
LEAST_ERROR = 0.01
"""Minimum relative error: white paper outshines the black beside it, so that markers look up to 1 % too small."""
MIN_VIEWS = 3
MAX_ERROR = 2.0
"""Maximum reprojection error of a marker's corners, pixels, as the median over its views."""
MAX_UNEVEN = 0.06
"""Maximum relative deviation of a marker's lengths; beyond it, something else was detected, or the poses are bad."""
_DPI = 300
_PAGE = (210.0, 297.0)
"""Width and height of an A4 page, millimetres."""


@dataclass(frozen=True)
class MarkerScale:
    """The scale according to markers.

    Attributes:
        metres_per_unit: metres per unit of the reconstruction.
        error: possible relative error.
        markers: number of markers that were measured.
        views: total number of their views.
    """

    metres_per_unit: float
    error: float
    markers: int
    views: int


def scale_by_marker(
    reconstruction: Reconstruction, side: float = MARKER_SIDE, progress: Progress = silent
) -> MarkerScale | None:
    """Measure the markers in a reconstruction's images; return None where none can be trusted.

    Args:
        reconstruction: cameras and images; the images must be without lens distortion.
        side: side of the markers' black squares, metres.
        progress: called for every image.

    Raises:
        ImportError: without the extra ``capture``.
    """
    return scale_by_corners(reconstruction, find_markers(reconstruction.paths, progress), side)


def find_markers(paths: list[Path], progress: Progress = silent) -> dict[int, dict[int, Floats]]:
    """Look for markers in images.

    Returns:
        By marker id and then by image index, the corners [4, 2] of the marker in that image, pixels from the image's
        upper left corner, clockwise from the marker's own upper left.

    Raises:
        ImportError: without the extra ``capture``.
    """
    cv2 = _opencv()
    parameters = cv2.aruco.DetectorParameters()
    quick = cv2.aruco.ArucoDetector(_dictionary(cv2), parameters)
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_APRILTAG
    # This method measures corners from the image's corner, as the intrinsics do. The others measure from the centre of
    # the first pixel, and were two to six times as biased on video.
    exact = cv2.aruco.ArucoDetector(_dictionary(cv2), parameters)
    found: dict[int, dict[int, Floats]] = {}
    for number, path in enumerate(paths):
        progress("markers", number, len(paths))
        grey = np.array(read_photo(path).convert("L"))
        if quick.detectMarkers(grey)[1] is None:
            continue
        corners, ids, _ = exact.detectMarkers(grey)
        for marker, square in zip([] if ids is None else np.ravel(ids).tolist(), corners, strict=True):
            found.setdefault(marker, {})[number] = np.reshape(square, (4, 2)).astype(np.float64)
    return found


def scale_by_corners(
    reconstruction: Reconstruction, found: dict[int, dict[int, Floats]], side: float
) -> MarkerScale | None:
    """Return the scale from the corners that ``find_markers`` found; a marker's weight is the square of its views."""
    lengths, views = [], []
    for squares in found.values():
        measured = _lengths(reconstruction, squares)
        if measured is not None:
            lengths.append(measured)
            views.append(len(squares))
    if not lengths:
        return None
    units = np.average([np.mean(values) for values in lengths], weights=np.square(views))
    deviation = np.concatenate([values / units - 1.0 for values in lengths])
    return MarkerScale(
        float(side / units),
        float(np.clip(2 * deviation.std() / np.sqrt(len(deviation)), LEAST_ERROR, MAX_UNEVEN)),
        len(lengths),
        sum(views),
    )


def _lengths(reconstruction: Reconstruction, squares: dict[int, Floats]) -> Floats | None:
    """Return a marker's four sides and its diagonals / √2, in units; None unless it is square and seen often enough."""
    poses, K = reconstruction.camera_to_world.numpy(), reconstruction.K.numpy()
    images = sorted(squares)
    for _ in range(3):
        if len(images) < MIN_VIEWS:
            return None
        pixels = np.stack([squares[image] for image in images])  # [V, 4, 2]
        try:
            corners = np.stack([triangulate(poses[images], K, pixels[:, corner]) for corner in range(4)])
        except CaptureError:
            return None
        local = np.einsum("vji,vcj->vci", poses[images, :3, :3], corners - poses[images, None, :3, 3]) @ K.T
        errors = np.linalg.norm(local[..., :2] / local[..., 2:] - pixels, axis=2).max(1)
        limit = max(MAX_ERROR, 3 * float(np.median(errors)))
        if (local[..., 2] <= 0).any() or not np.isfinite(errors).all():
            return None
        kept = [image for image, error in zip(images, errors, strict=True) if error <= limit]
        if len(kept) == len(images):
            break
        images = kept
    if np.median(errors) > MAX_ERROR:
        return None
    sides = np.linalg.norm(corners - np.roll(corners, -1, 0), axis=1)
    diagonals = np.linalg.norm(corners[:2] - corners[2:], axis=1) / np.sqrt(2.0)
    lengths = np.concatenate([sides, diagonals])
    return lengths if np.ptp(lengths) <= 2 * MAX_UNEVEN * lengths.mean() else None


def write_marker_page(path: Path, marker: int = 0, side: float = MARKER_SIDE) -> None:
    """Write an A4 page with a marker to print, as PDF.

    Args:
        path: the file to write; must end in .pdf.
        marker: id of the marker, 0 to 49.
        side: side of the black square, metres.

    Raises:
        ImportError: without the extra ``capture``.
        ValueError: for a path with another suffix, an id out of range, or a side that does not fit the page.
    """
    if path.suffix.lower() != ".pdf":
        raise ValueError(f"{path}: expected a name that ends in .pdf")
    if not 0 <= marker < 50:
        raise ValueError(f"marker: expected a number from 0 to 49, got {marker}")
    if not 0.02 <= side <= 0.18:
        raise ValueError(f"side: expected 0.02 to 0.18 m, so that it fits an A4 page, got {side}")
    cv2 = _opencv()
    width, height = (round(length / 25.4 * _DPI) for length in _PAGE)
    edge = round(side * 1000 / 25.4 * _DPI)
    page = Image.new("L", (width, height), 255)
    squares = Image.fromarray(cv2.aruco.generateImageMarker(_dictionary(cv2), marker, 6))
    corner = ((width - edge) // 2, round(0.4 * height) - edge // 2)
    page.paste(squares.resize((edge, edge), Image.Resampling.NEAREST), corner)
    pen, below = ImageDraw.Draw(page), corner[1] + edge + round(0.06 * height)
    for line, size in (
        (f"The black square is {1000 * side:.0f} mm wide when this page is printed at 100 %.", 48),
        ("Lay it flat where your film shows all of it, from several sides.", 42),
        (f"splatrl-capture, marker {marker} of DICT_4X4_50", 32),
    ):
        pen.text((width // 2, below), line, fill=0, anchor="mm", font=ImageFont.load_default(size))
        below += 2 * size
    with replacing(path) as stream:
        page.save(stream, "PDF", resolution=_DPI)


def _dictionary(cv2: ModuleType) -> object:
    return cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)


def _opencv() -> ModuleType:
    return require("cv2", "capture", "markers need OpenCV", ", or set the scale in another way (marker=None)")
