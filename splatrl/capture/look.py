"""Second stage: a quick look at the images, which tells in seconds that a capture cannot work, and why."""

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from splatrl.capture.around import around
from splatrl.capture.base import CaptureError, Photos
from splatrl.capture.matches import Features, Pair, features, related
from splatrl.capture.progress import Progress, silent

FRAMES = 60
GROUP = 6
"""Neighbours per group that is looked at in a long video: images a second apart may share little in a good film."""
APART = 0.34
"""Maximum time between neighbours, seconds, where the video has enough images."""
LATER = 3
"""How many places later the image is with which each is compared, where neighbours are at most ``APART``; where the
images of a longer film lie farther apart, it is as many as are in that time, but at least one."""
FEW = 40
"""Maximum number of images of which all pairs are compared."""
MIN_BRIGHTNESS, DIM = 25.0, 60.0
"""Mean grey level that images must have, and below which the dark may be why they show few points: phones smooth away
what little they see.
"""
MIN_KEYPOINTS = 60
"""Minimum number of distinct points. A film of bare walls has 0; one that turns fast close to walls has 119, and 85 %
of its images find a pose."""
BARE, MAX_BARE = 100, 0.4
"""Number of points, faint ones included, below which an image is bare and says nothing of the speed (fast films have
hundreds); and the maximum fraction of bare images."""
MIN_VERIFIED, OTHERS = 0.8, 2
"""Minimum fraction of images that must share points, and the number of others with which each photo must."""
MAX_TURNED = 0.85
"""Maximum fraction of pairs that turning alone explains. Films that pan for seven seconds at each of four or five
places, with some steps between, have 0.65 to 0.8 and are captured well; one that only turned has 0.97."""
MIN_SHIFT = 0.02
MIN_ANGLE = math.radians(3)


@dataclass(frozen=True)
class Look:
    """Result of a look at the images.

    Attributes:
        images: number of images looked at.
        brightness: median over the images of their mean grey level, 0 to 255.
        keypoints: number of distinct points in the better images (75th percentile), at most 1,500.
        verified: fraction of images in which enough points of the image ``later`` places on are found again, counting
            pairs without bare images only; for ``unordered`` images, fraction that share points with two others.
        turned: among pairs that share points and lie at least ``later`` images apart (for at most ``FEW`` images, at
            any distance), the fraction that a camera which only turned explains.
        shift: median displacement of a point between such images, as a fraction of the image's longer side.
        angle: angle under which the camera saw the same point from two places, radians, 90th percentile.
        unordered: whether the images are photos, whose order may mean nothing, or few.
        bare: fraction of images with fewer than ``BARE`` points.
        apart: time from one of these images to the next in a film, seconds; 0 for photos.
        around: whether the images show all directions, as those of a 360° camera do.
    """

    images: int
    brightness: float
    keypoints: float
    verified: float
    turned: float
    shift: float
    angle: float
    unordered: bool = False
    bare: float = 0.0
    apart: float = 0.0
    around: bool = False

    @property
    def later(self) -> int:
        """How many places later the image is with which each is compared."""
        return _later(self.apart)

    def cause(self) -> str | None:
        """Return why this capture cannot work, with figures and advice; None where it can work."""
        if self.images < 3:
            return f"too few images: {self.images}, but at least 3 are needed. Take 50 to 200, or a one-minute video."
        if self.around:
            what = "film" if self.apart else "photos"
            return (
                f"360° {what}: the images are twice as wide as high, and their right edge continues at their left. No "
                "pinhole camera sees all directions: export a flat view of one direction from the camera's app, and "
                "capture that."
            )
        if self.brightness < MIN_BRIGHTNESS:
            return (
                f"too dark: the mean grey level of the images is {self.brightness:.0f} of 255, but at least "
                f"{MIN_BRIGHTNESS:.0f} is needed. Switch on lights, or set a longer exposure and move more slowly."
            )
        found = self._texture() or self._speed()
        if found and self.brightness < DIM:
            return (
                f"perhaps too dark: the mean grey level of the images is {self.brightness:.0f} of 255. Switch on "
                f"lights. Or {found}"
            )
        return found or self._motion()

    def refuse(self) -> None:
        """Refuse a capture that cannot work.

        Raises:
            CaptureError: with the cause.
        """
        cause = self.cause()
        if cause:
            raise CaptureError(cause)

    def _texture(self) -> str | None:
        if self.keypoints < MIN_KEYPOINTS:
            found = (
                f"even the better images show {self.keypoints:.0f} distinct points, but at least {MIN_KEYPOINTS} are"
            )
        elif self.bare > MAX_BARE:
            found = f"{self.bare:.0%} of the images show fewer than {BARE} points, but at least that many are"
        else:
            return None
        return (
            f"textureless: {found} needed. Film things with patterns and edges, not blank walls; put up posters or "
            "newspaper where there are none, and make sure that the images are sharp."
        )

    def _speed(self) -> str | None:
        if self.verified >= MIN_VERIFIED:
            return None
        images, needed = f"only {self.verified:.0%} of the images", f"but at least {MIN_VERIFIED:.0%} must"
        if self.unordered:
            return (
                f"photos too far apart: {images} share enough points with two others, {needed}. Take more photos, "
                "each showing at least two thirds of the one before."
            )
        if self.later < LATER:
            return (
                f"too long or too fast: {images} share enough points with the image {self.later * self.apart:.1f} s "
                f"later, {needed}; so long a film gives images that lie {self.apart:.1f} s apart. Cut it to a minute, "
                "capture its parts, or move and turn more slowly."
            )
        return (
            f"moved too fast: {images} share enough points with the image three places later, {needed}. Move at a slow "
            "walk, turn slowly, or add light."
        )

    def _motion(self) -> str | None:
        if self.turned > MAX_TURNED and self.shift >= MIN_SHIFT:
            return (
                f"only turned on the spot: turning alone explains {self.turned:.0%} of the image pairs, but it may "
                f"explain at most {MAX_TURNED:.0%}. Depth can be found only from different positions: walk sideways "
                "and around things while you film."
            )
        if self.turned > MAX_TURNED or self.angle < MIN_ANGLE:
            return (
                f"hardly moved: the camera saw a point from directions only {math.degrees(self.angle):.1f}° apart, but "
                f"at least {math.degrees(MIN_ANGLE):.0f}° are needed; points move by {self.shift:.1%} of the image. "
                "Walk through the place and around things while you film."
            )
        return None


def look(photos: Photos, progress: Progress = silent) -> Look:
    """Look at some of the images and compare them.

    Args:
        photos: photos of one place, in the order in which they were taken.
        progress: called for every image and pair.

    Returns:
        The figures, from which ``Look.cause`` draws its conclusions.

    Raises:
        ImportError: without the extra ``capture``.
    """
    chosen, group = _chosen(photos.seconds.numpy())
    seen: list[Features] = []
    for number in chosen.tolist():
        progress("look", len(seen), 5 * len(chosen))
        seen.append(features(photos.paths[number], photos.mask))
    unordered = bool(photos.files) or len(seen) <= FEW
    near = list(_pairs(len(seen), group))
    pairs = [*near, *itertools.combinations(range(len(seen)), 2)] if unordered else near
    found: dict[tuple[int, int], Pair] = {}
    others = np.zeros(len(seen), int)  # with which each shares points
    for done, (first, second) in enumerate(pairs):
        needless = done >= len(near) and len(seen) > FEW and min(others[first], others[second]) >= OTHERS
        if (first, second) in found or needless:
            continue
        progress("look", len(seen) + 4 * len(seen) * done // len(pairs), 5 * len(seen))
        found[first, second] = related(seen[first], seen[second])
        others[[first, second]] += found[first, second].kind != "none"
    progress("look", 1, 1)
    apart = 0.0 if photos.files or len(chosen) < 2 else float(np.median(np.diff(photos.seconds.numpy()[chosen])))
    all_around = around([photos.paths[number] for number in chosen.tolist()], (photos.width, photos.height))
    return replace(summed(seen, found, unordered, apart), around=all_around)


def summed(seen: list[Features], found: dict[tuple[int, int], Pair], unordered: bool, apart: float = 0.0) -> Look:
    """Compute the figures of a look.

    Args:
        seen: features of the images.
        found: relations of pairs of images, by their two indices, the smaller one first.
        unordered: whether the images are photos, or few.
        apart: time from one image to the next, seconds; 0 for photos.
    """
    later = _later(apart)
    sharing = {pair: how for pair, how in found.items() if how.kind != "none"}
    bare = [len(image.points) < BARE for image in seen]
    if unordered:
        others = [sum(number in pair for pair in sharing) for number in range(len(seen))]
        joined = [count >= OTHERS for count in others]
    else:
        joined = [pair in sharing for pair in found if pair[1] - pair[0] == later and not any(bare[n] for n in pair)]
    far = [how for pair, how in sharing.items() if len(seen) <= FEW or pair[1] - pair[0] >= later]
    return Look(
        images=len(seen),
        brightness=float(np.median([image.brightness for image in seen])),
        keypoints=float(np.percentile([image.distinct for image in seen], 75)),
        verified=float(np.mean(joined)) if joined else 0.0,
        turned=float(np.mean([how.kind == "turned" for how in far])) if far else 0.0,
        shift=float(np.median([how.shift for how in far])) if far else 0.0,
        angle=float(np.percentile([how.angle for how in far], 90)) if far else 0.0,
        unordered=unordered,
        bare=float(np.mean(bare)),
        apart=apart,
    )


def _chosen(seconds: np.ndarray) -> tuple[np.ndarray, int]:
    """Choose images to look at by their times [N]; return their indices, and the number of neighbours per group."""
    count = len(seconds)
    evenly = np.unique(np.linspace(0, count - 1, min(FRAMES, count)).round().astype(int))
    interval = float(seconds[-1] - seconds[0]) / max(count - 1, 1)
    if count <= FRAMES or interval * (count - 1) / (FRAMES - 1) <= APART:
        return evenly, len(evenly)
    step = max(1, int(APART / interval)) if interval > 0 else 1
    starts = np.linspace(0, count - 1 - (GROUP - 1) * step, FRAMES // GROUP).round().astype(int)
    return (starts[:, None] + step * np.arange(GROUP)).reshape(-1), GROUP


def _later(apart: float) -> int:
    return min(LATER, max(1, int(LATER * APART / apart))) if apart > 0 else LATER


def _pairs(count: int, group: int) -> Iterator[tuple[int, int]]:
    for offset in range(1, LATER + 1):
        yield from ((first, first + offset) for first in range(count - offset) if first % group + offset < group)
    yield from ((first, second) for first in range(0, count, 5) for second in range(first + 5, count, 5))
