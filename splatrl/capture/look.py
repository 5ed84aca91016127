"""Second stage: a quick look at the images, which tells in seconds that a capture cannot work, and why."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from splatrl.capture.base import CaptureError, Photos
from splatrl.capture.matches import Features, Pair, features, related
from splatrl.capture.progress import Progress, silent

FRAMES = 60
GROUP = 6
"""Neighbours per group that is looked at in a long video: images a second apart may share little in a good film."""
APART = 0.34
"""Maximum time between neighbours, seconds, where the video has enough images."""
FEW = 40
"""Maximum number of photos of which all pairs are compared, since their order may mean nothing."""
MIN_BRIGHTNESS = 25.0
MIN_KEYPOINTS = 60
"""Minimum number of distinct points. A film of bare walls has 0; one that turns fast close to walls has 119, and 85 %
of its images find a pose."""
BARE, MAX_BARE = 100, 0.4
"""Number of points, faint ones included, below which an image is bare and says nothing of the speed (fast films have
hundreds); and the maximum fraction of bare images."""
MIN_VERIFIED = 0.8
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
        verified: fraction of images in which enough points of the third next image are found again, counting pairs
            without bare images only; for few photos, fraction that share points with at least two others.
        turned: among pairs that share points and lie at least three images apart (for few photos, at any distance), the
            fraction that a camera which only turned explains.
        shift: median displacement of a point between such images, as a fraction of the image's longer side.
        angle: angle under which the camera saw the same point from two places, radians, 90th percentile.
        few: whether these are few photos, with all pairs compared.
        bare: fraction of images with fewer than ``BARE`` points.
    """

    images: int
    brightness: float
    keypoints: float
    verified: float
    turned: float
    shift: float
    angle: float
    few: bool = False
    bare: float = 0.0

    def cause(self) -> str | None:
        """Return why this capture cannot work, with figures and advice; None where it can work."""
        if self.images < 3:
            return f"too few images: {self.images}, but at least 3 are needed. Take 50 to 200, or a one-minute video."
        if self.brightness < MIN_BRIGHTNESS:
            return (
                f"too dark: the mean grey level of the images is {self.brightness:.0f} of 255, but at least "
                f"{MIN_BRIGHTNESS:.0f} is needed. Switch on lights, or set a longer exposure and move more slowly."
            )
        for found in (self._texture(), self._speed(), self._motion()):
            if found:
                return found
        return None

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
        if self.few:
            return (
                f"photos too far apart: {images} share enough points with two others, {needed}. Take more photos, "
                "each showing at least two thirds of the one before."
            )
        return (
            f"moved too fast: {images} share enough points with the image three places later, {needed}. Move at a slow "
            "walk, turn slowly, add light, or take more frames."
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
        seen.append(features(photos.paths[number]))
    few = len(photos.paths) <= FEW
    pairs = list(_pairs(len(seen), few, group))
    found = {}
    for done, (first, second) in enumerate(pairs):
        progress("look", len(seen) + 4 * len(seen) * done // len(pairs), 5 * len(seen))
        found[first, second] = related(seen[first], seen[second])
    progress("look", 1, 1)
    return summed(seen, found, few)


def summed(seen: list[Features], found: dict[tuple[int, int], Pair], few: bool) -> Look:
    """Compute the figures of a look.

    Args:
        seen: features of the images.
        found: relations of pairs of images, by their two indices, the smaller one first.
        few: whether these are few photos, with all pairs compared.
    """
    sharing = {pair: how for pair, how in found.items() if how.kind != "none"}
    bare = [len(image.points) < BARE for image in seen]
    if few:
        others = [sum(number in pair for pair in sharing) for number in range(len(seen))]
        verified = float(np.mean([count >= 2 for count in others])) if others else 0.0
    else:
        third = [pair in sharing for pair in found if pair[1] - pair[0] == 3 and not any(bare[n] for n in pair)]
        verified = float(np.mean(third)) if third else 0.0
    apart = [how for pair, how in sharing.items() if few or pair[1] - pair[0] >= 3]
    return Look(
        images=len(seen),
        brightness=float(np.median([image.brightness for image in seen])),
        keypoints=float(np.percentile([image.distinct for image in seen], 75)),
        verified=verified,
        turned=float(np.mean([how.kind == "turned" for how in apart])) if apart else 0.0,
        shift=float(np.median([how.shift for how in apart])) if apart else 0.0,
        angle=float(np.percentile([how.angle for how in apart], 90)) if apart else 0.0,
        few=few,
        bare=float(np.mean(bare)),
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


def _pairs(count: int, few: bool, group: int) -> Iterator[tuple[int, int]]:
    if few:
        yield from ((first, second) for first in range(count) for second in range(first + 1, count))
        return
    for offset in (1, 2, 3):
        yield from ((first, first + offset) for first in range(count - offset) if first % group + offset < group)
    yield from ((first, second) for first in range(0, count, 5) for second in range(first + 5, count, 5))
