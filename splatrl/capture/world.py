"""World stage: turn a reconstruction upright, scale it to metres, and put it on its floor."""

import math
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from splatrl.capture.base import CaptureError, Reconstruction
from splatrl.capture.beneath import Footing, much_below, stood_on, sunk
from splatrl.capture.carrying import weakest
from splatrl.capture.ground import MIN_INLIERS, NEAR, Ground, UpFrom, find_ground, leaning
from splatrl.capture.jerks import TORN, camera_leaps, jerks
from splatrl.capture.marker import MARKER_SIDE, scale_by_marker
from splatrl.capture.progress import Progress, silent
from splatrl.capture.quarters import quarters
from splatrl.capture.scale import Distance, ScaleFrom, contradiction, scale_by_distance, scale_by_gps
from splatrl.capture.upright_check import doubt_of_up
from splatrl.scenes.walls import find_walls
from splatrl.values import require_number

Floats = NDArray[np.float64]

USUAL_HEIGHT = 1.5
"""Height at which people hold a camera, metres; a place of unknown scale is scaled as if they had."""
SCALE_ERROR = {"recorded": 0.01, "distance": 0.03, "camera_height": 0.05}
"""Largest relative errors found in trials, by the source of the scale; a marker's own views tell its error."""
LEVELS_ERROR = 0.12
"""The same for the camera's height above ground with steps or a slope."""
SLOPING = 4.0
"""Slope of the floor, degrees, from which the report mentions it."""
FEWEST = 20
"""Minimum number of points among which a floor is sought."""
UNEVEN = 3.0
"""Maximum time from one image of a film to the next, in usual times; the sharpest images lie unevenly."""
OUTERMOST = (0.05, 0.95)
"""Quantiles of the cameras' heights beyond which heights count as wrong."""


@dataclass(frozen=True, eq=False)
class Placed:
    """A reconstruction in the world: z up, floor at z = 0, x along the longest wall, x = y = 0 in mid-walk.

    The floor is the lowest one on which people stood.

    Attributes:
        reconstruction: cameras and points in that frame, in metres where ``metric``.
        world_from_capture: [4, 4] float64 similarity that brought it there.
        scale_from: source of the scale.
        scale_error: possible relative error of the scale; None where it is unknown, as without a scale, with the
            camera's height above a floor that was hardly seen or has much below it near the path, or where up is
            unknown, parts may be joined wrongly or something else that was stated contradicts it.
        up_from: source of the upward direction.
        up_error_deg: possible error of the upward direction, degrees; None where the camera leaps or is below the
            floor, where parts may differ in scale, where the camera may have been turned by a quarter, or where
            ``doubt`` says so.
        camera_height: mean height of the cameras above the ground beneath them, as defined by ``mean_height``, metres.
        floor_points: number of points of the reconstruction that lie on the floor.
        contradicted: how a stated height or distance contradicts the source of the scale, in sentences; None where
            nothing does.
        doubt: why up may be wrong by a quarter or half turn, in sentences; None where nothing suggests it.
        remarks: what is unusual about the ground, one sentence each.
    """

    reconstruction: Reconstruction
    world_from_capture: Tensor
    scale_from: ScaleFrom
    scale_error: float | None
    up_from: UpFrom
    up_error_deg: float | None
    camera_height: float
    floor_points: int
    contradicted: str | None = None
    doubt: str | None = None
    remarks: tuple[str, ...] = ()

    @property
    def metric(self) -> bool:
        """Whether lengths are metres; otherwise they are scaled as if the camera had been 1.5 m above the floor."""
        return self.scale_from != "unknown"


def place(
    reconstruction: Reconstruction,
    up: Tensor | None = None,
    metric: bool = False,
    marker: float | None = MARKER_SIDE,
    distance: Distance | None = None,
    camera_height: float | None = None,
    progress: Progress = silent,
) -> Placed:
    """Place a reconstruction in the world.

    The scale comes from the first of: recorded poses, a printed marker, a known distance, a known camera height, GPS.
    A distance or height that does not set it is compared with it.

    Args:
        reconstruction: a reconstruction in any frame and unit.
        up: [3], the upward direction (away from the earth) in its frame, where it was recorded.
        metric: whether its unit is the metre already.
        marker: side of the printed markers to look for in the images, metres; None looks for none.
        distance: two clicked points with the metres between them.
        camera_height: mean height of the cameras above the floor over the time of the film, metres.
        progress: called for every image in which markers are looked for.

    Raises:
        CaptureError: for too few cameras or points, or a distance that cannot be measured.
        ImportError: where markers are looked for without the extra ``capture``.
        ValueError: for a height or a side that is not above 0.
    """
    for name, value in (("camera_height", camera_height), ("marker", marker)):
        if value is not None:
            require_number(name, value, above=0.0, unit="metres")
    poses, points = _enough(reconstruction)
    turned = quarters(reconstruction)
    held = turned.undone(poses)
    lowest = find_ground(held, points, None if up is None else up.double().numpy())
    footing = stood_on(lowest, poses[:, :3, 3], points)
    ground = footing.ground
    missing = len(poses) * reconstruction.missing / (1.0 - reconstruction.missing)
    above = mean_height(poses[:, :3, 3] @ ground.up - footing.beneath, reconstruction.seconds, missing)
    if not above > 0:
        raise CaptureError("expected a floor below the cameras, found none; film so that the floor is visible")
    above += ground.below
    scale, scale_from, error = _scale(reconstruction, footing, above, metric, marker, distance, camera_height, progress)
    doubt = None if up is not None else doubt_of_up(held, points, ground.up, level=scale_from == "gps")
    sure = up is not None or (turned.sure and doubt is None)
    deep = much_below(ground, poses[:, :3, 3], points, above)
    floor = ground.up_from != "cameras" and ground.inliers >= MIN_INLIERS and not deep and sure
    if scale_from == "camera_height" and not floor:
        error = None
    torn = not metric and _torn(reconstruction, ground, above)
    if torn:  # parts may have any scale, and contradict each other in what is up
        error = None
    compared = camera_height if floor else None  # otherwise the height above what may be no floor
    contradicted = contradiction(reconstruction, scale, scale_from, scale * above, distance, compared)
    transform = _world_from_capture(poses, points, ground, scale)
    return Placed(
        moved(reconstruction, transform),
        torch.from_numpy(transform),
        scale_from,
        error if contradicted is None else None,
        ground.up_from,
        ground.error_deg if sure and not torn else None,
        scale * above,
        ground.inliers,
        contradicted,
        doubt,
        _remarks(lowest, footing, scale, above, deep),
    )


def _enough(reconstruction: Reconstruction) -> tuple[Floats, Floats]:
    """Return poses [N, 4, 4] and points [M, 3], after refusing too few of either with a ``CaptureError``."""
    poses, points = reconstruction.camera_to_world.numpy(), reconstruction.points.numpy()
    if len(poses) < 2 or len(points) < FEWEST:
        raise CaptureError(
            f"expected at least 2 cameras and {FEWEST} points to find the floor, got {len(poses)} and {len(points)}"
        )
    return poses, points


def _torn(reconstruction: Reconstruction, ground: Ground, above: float) -> bool:
    """Return whether parts of the film may be joined wrongly: the camera leaps, or goes below the floor."""
    places, points = reconstruction.camera_to_world[:, :3, 3].numpy(), reconstruction.points.numpy()
    return (
        jerks(camera_leaps(reconstruction)) >= TORN
        or weakest(reconstruction) is not None
        or bool(sunk(places, points, ground.up, ground.height, above).any())
    )


def mean_height(heights: Floats, seconds: Tensor | None, missing: float = 0) -> float:
    """Return the mean height of the cameras over the time of the film.

    Between images with poses, the camera counts as having moved evenly: the median of these images' heights is several
    per cent off where somebody raises and lowers the camera. A few heights that are far off are clamped to the
    outermost of the others. A time without images that is longer than those without a pose explain is a pause of the
    recorder, and counts no longer than they do.

    Args:
        heights: [N] heights of the cameras.
        seconds: [N] times at which they took their images, ascending; None where unknown.
        missing: number of images without a pose.
    """
    held = np.clip(heights, *np.quantile(heights, OUTERMOST))
    if seconds is None or not seconds[-1] > seconds[0]:
        return float(held.mean())
    steps = np.diff(seconds.numpy())
    steps = np.minimum(steps, (UNEVEN + missing) * np.median(steps[steps > 0]))
    return float((0.5 * (held[1:] + held[:-1])) @ steps / steps.sum())


def moved(reconstruction: Reconstruction, transform: Floats) -> Reconstruction:
    """Transform a reconstruction to another frame by a similarity, [4, 4] float64."""
    scale = float(np.linalg.det(transform[:3, :3]) ** (1 / 3))
    linear, shift = torch.from_numpy(transform[:3, :3]), torch.from_numpy(transform[:3, 3])
    poses = reconstruction.camera_to_world.clone()
    poses[:, :3, :3] = (linear / scale) @ poses[:, :3, :3]
    poses[:, :3, 3] = poses[:, :3, 3] @ linear.T + shift
    points = reconstruction.points @ linear.T + shift
    return replace(reconstruction, camera_to_world=poses, points=points, depth_unit=scale * reconstruction.depth_unit)


def _scale(
    reconstruction: Reconstruction,
    footing: Footing,
    above: float,
    metric: bool,
    marker: float | None,
    distance: Distance | None,
    camera_height: float | None,
    progress: Progress,
) -> tuple[float, ScaleFrom, float | None]:
    """Return metres per unit, their source, and their possible relative error."""
    if metric:
        return 1.0, "recorded", SCALE_ERROR["recorded"]
    found = None if marker is None else scale_by_marker(reconstruction, marker, progress)
    if found is not None:
        return found.metres_per_unit, "marker", found.error
    if distance is not None:
        return scale_by_distance(reconstruction, distance), "distance", SCALE_ERROR["distance"]
    if camera_height is not None:
        error = LEVELS_ERROR if footing.rise > NEAR * above else SCALE_ERROR["camera_height"]
        centers = reconstruction.camera_to_world[:, :3, 3].numpy()
        error += footing.unsure + leaning(footing.ground, centers, reconstruction.points.numpy())
        return camera_height / above, "camera_height", error if footing.seen else None
    by_gps = scale_by_gps(
        reconstruction.gps, (reconstruction.camera_to_world[:, :3, 3].numpy() @ _standing(footing.ground.up).T)[:, :2]
    )
    if by_gps is not None:
        return by_gps[0], "gps", by_gps[1]
    return USUAL_HEIGHT / above, "unknown", None


def _remarks(lowest: Ground, footing: Footing, scale: float, above: float, deep: bool) -> tuple[str, ...]:
    """Return what is unusual about the ground, one sentence each."""
    slope, rise, lower = lowest.slope_deg, footing.rise, footing.ground.height - lowest.height
    remarks = {
        f"The floor seems to slope by {slope:.0f}° or more, judging by how the camera was held. Up is perpendicular to "
        "it: what stands upright there leans in the scene.": slope > SLOPING,
        f"The ground beneath the camera rises by {scale * rise:.2f} m, by steps or a slope: z = 0 is where it is "
        "lowest, and the camera's height counts from the ground beneath it.": rise > NEAR * above,
        f"There is lower ground in view, {scale * lower:.1f} m down; z = 0 is the floor where the camera was.": lower
        > 0,
        "Much lies below what was taken for the floor, near the path: it may be a table. Film the floor, or set the "
        "scale by a printed marker or a distance.": deep,
    }
    return tuple(said for said, true in remarks.items() if true)


def _world_from_capture(poses: Floats, points: Floats, ground: Ground, scale: float) -> Floats:
    turn = _standing(ground.up)
    cameras, flat = poses[:, :3, 3] @ turn.T, points @ turn.T
    heights = flat[:, 2] - ground.height
    above = float(np.median(cameras[:, 2])) - ground.height
    yaw = find_walls(flat[(heights > 0.1 * above) & (heights < 1.5 * above), :2]).yaw
    spin = np.array([[math.cos(yaw), math.sin(yaw), 0.0], [-math.sin(yaw), math.cos(yaw), 0.0], [0.0, 0.0, 1.0]])
    turn = spin @ turn
    if (turn @ poses[0, :3, 2])[0] < 0:  # of the two ways along the wall, the one in which the first camera looks
        turn = np.diag([-1.0, -1.0, 1.0]) @ turn
    walked = poses[:, :3, 3] @ turn.T
    middle = 0.5 * (walked.min(0) + walked.max(0))
    middle[2] = ground.height
    transform = np.eye(4)
    transform[:3, :3] = scale * turn
    transform[:3, 3] = -scale * middle
    return transform


def _standing(up: Floats) -> Floats:
    """Return the smallest rotation [3, 3] that turns ``up`` to +z."""
    if up[2] < -0.999999:
        return np.diag([1.0, -1.0, -1.0])
    x, y, z = up
    slant = -x * y / (1 + z)
    return np.array([[1 - x * x / (1 + z), slant, -x], [slant, 1 - y * y / (1 + z), -y], [x, y, z]])
