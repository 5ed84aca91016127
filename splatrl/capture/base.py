"""Data that the stages of a capture pass to one another, and how they refuse one that cannot work."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from splatrl.capture.lens import Lens


class CaptureError(ValueError):
    """Raised where a capture cannot become a scene; the message says what is wrong, with figures, and what to do."""


def unless_forced(cause: str, force: bool, stage: str, say: Callable[[str], object]) -> str:
    """Refuse a capture for this cause, or with ``force`` print the cause and return it for the report."""
    if not force:
        raise CaptureError(f"{cause} Pass --force to continue anyway.")
    say(f"{stage:<11} {cause}")
    return cause


@dataclass(frozen=True)
class Photos:
    """Upright images of one place, in the order in which they were taken.

    Attributes:
        paths: N image files, all of one size.
        width: width of every image, pixels.
        height: height of every image, pixels.
        seconds: [N] float64, time at which each image was taken, from 0; the image's index where that is unknown.
        K: [3, 3] float64 intrinsics of these images, pixels; None where they are still to be found.
        camera_to_world: [N, 4, 4] float64 known poses, metres where ``metric``, OpenCV camera axes; None where they are
            still to be found.
        up: [3] float64, the upward direction (away from the earth) in the frame of ``camera_to_world``; None where
            unknown.
        depths: N depth images of a sensor, uint16 PNG in millimetres, 0 where there is no depth; empty without a
            sensor.
        metric: whether the unit of ``camera_to_world`` is the metre.
        gps: [N, 2] float64, latitude and longitude of each image in degrees, NaN where unknown; None where no image has
            them.
        turned: [N] bool, whether an image was turned a quarter clockwise, onto its side, to have the size of the
            others; None where none was.
        remarks: what of the source was not used although it should have been, one sentence each.
        files: N names of the source's files, for messages; empty where the images are known by their ``seconds``.
        cuts: times at which another take begins in a film that was put together from several, in those of ``seconds``.
        mask: image of the same size, black where all images show the same (see ``unchanging``); None where they do not.
        moving: folder of images of the same size, each with the name of one of ``paths`` and ``.png`` after it, black
            where that shows what moved (see ``masks``); None where that was not sought.
    """

    paths: list[Path]
    width: int
    height: int
    seconds: Tensor
    K: Tensor | None = None
    camera_to_world: Tensor | None = None
    up: Tensor | None = None
    depths: tuple[Path, ...] = ()
    metric: bool = False
    gps: Tensor | None = None
    turned: Tensor | None = None
    remarks: tuple[str, ...] = ()
    files: tuple[str, ...] = ()
    cuts: tuple[float, ...] = ()
    mask: Path | None = None
    moving: Path | None = None


@dataclass(frozen=True)
class Reconstruction:
    """Cameras with known poses, and the points that they saw.

    Attributes:
        paths: N image files without lens distortion, in the order in which they were taken.
        width: width of every image, pixels.
        height: height of every image, pixels.
        K: [3, 3] float64 intrinsics, pixels.
        camera_to_world: [N, 4, 4] float64, OpenCV camera axes; any frame and unit until the world stage.
        points: [P, 3] float64, in the same frame.
        colors: [P, 3] uint8.
        seen_point: [T] int64, index of the point in each observation of a point by a camera.
        seen_by: [T] int64, index of the camera in each observation.
        missing: fraction of the given images whose pose was not found.
        lost: the longest stretches of these images, each in words: by the names of their files or their times.
        depths: N depth images of a sensor, as in ``Photos``; empty without a sensor.
        depth_unit: length of one count in these images, in the unit of the frame.
        seconds: [N] float64, time at which each image was taken, as in ``Photos``; None where unknown.
        gps: [N, 2] float64, as in ``Photos``.
        turned: [N] bool, as in ``Photos``.
        cuts: times at which another take begins, as in ``Photos``.
        focal_lengths: [N] float64, focal length of each image of a film, pixels, where its parts have their own (see
            ``zoom``); None where these were not sought.
        carried: [N] float64, how well the scale of a film is carried past each image (see ``carrying``); None for
            photos, whose order may mean nothing, and for poses that were known.
        mask: as in ``Photos``, without lens distortion.
        numbers: [N] int64, which of the given photos the images are; None where unknown.
        lens: lens of the photos before its distortion was removed; None where it had none.
    """

    paths: list[Path]
    width: int
    height: int
    K: Tensor
    camera_to_world: Tensor
    points: Tensor
    colors: Tensor
    seen_point: Tensor
    seen_by: Tensor
    missing: float = 0.0
    lost: tuple[str, ...] = ()
    depths: tuple[Path, ...] = ()
    depth_unit: float = 0.001
    seconds: Tensor | None = None
    gps: Tensor | None = None
    turned: Tensor | None = None
    cuts: tuple[float, ...] = ()
    focal_lengths: Tensor | None = None
    carried: Tensor | None = None
    mask: Path | None = None
    numbers: Tensor | None = None
    lens: Lens | None = None

    def K_at(self, width: int, height: int) -> Tensor:
        """Return the intrinsics [3, 3] float64 for these images at another size."""
        scale = [[width / self.width], [height / self.height], [1.0]]
        return self.K.double() * torch.tensor(scale, dtype=torch.float64)
