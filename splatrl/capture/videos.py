"""The frames of a video, upright, and the times at which they are shown."""

import itertools
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from PIL import Image

from splatrl import images
from splatrl.capture.base import CaptureError
from splatrl.decoding import Damage, decoded, interval
from splatrl.hdr import usual_range

if TYPE_CHECKING:
    from av import VideoFrame
    from av.container import InputContainer


MOST_DAMAGED = 0.03
"""Maximum fraction of a video's frames that may be damaged; some bytes are often lost in a transfer."""
JOINED = (
    "; from {:.0f} s on, frames are damaged as where films of several cameras, or of one that was held differently, "
    "were joined: capture one of these alone, or join films of one camera, held the same way"
)
"""What is said where frames cannot be decoded with the settings of the film's first frame."""
BLACK, LIT, THINNEST, EDGE = 24, 0.2, 0.01, 0.005
"""Maximum grey level of a bar, the fraction of images from which on a brighter line is none, a bar's minimum width as a
fraction of the image's side, and the extra fraction that is cut off because the bar's edge is blurred."""


@contextmanager
def open_video(path: Path) -> Iterator["InputContainer"]:
    """Open a video.

    Args:
        path: the video file.

    Raises:
        CaptureError: where it cannot be read, is not a video in one of ``images.CONTAINERS``, or has images that are
            too large.
    """
    try:
        with images.open_video(path) as container:
            yield container
    except ValueError as error:
        raise CaptureError(str(error)) from error


def size(path: Path) -> tuple[int, int]:
    """Return the width and height of a video's images as they are stored, pixels.

    Args:
        path: the video file.

    Raises:
        CaptureError: as ``open_video`` does.
    """
    with open_video(path) as container:
        track = images.video_track(container)
        return track.width, track.height


def aspect_of(path: Path) -> float:
    """Return the width of a video's pixels over their height.

    Args:
        path: the video file.

    Raises:
        CaptureError: as ``open_video`` does.
    """
    with open_video(path) as container:
        return images.pixel_aspect(container)


def packet_times(path: Path) -> np.ndarray:
    """Return when each frame of a video is shown, without decoding any; frames that an edit has cut away are left out.

    Times that go back, as where files were joined, are moved as ``frames`` moves them.

    Args:
        path: the video file.

    Returns:
        [N] float64 seconds, ascending, in the time of the file.

    Raises:
        CaptureError: as ``open_video`` does, or where the file holds no frames or no times.
    """
    with open_video(path) as container:
        stream = images.video_track(container)
        base, step = float(stream.time_base or 0), interval(stream)
        parts: list[list[int]] = [[]]
        last = -math.inf
        for packet in container.demux(stream):
            if packet.pts is None or packet.is_discard or not packet.size:
                continue
            if packet.dts is not None:
                if packet.dts < last:  # the next of several films that were joined
                    parts.append([])
                last = packet.dts
            parts[-1].append(packet.pts)
    times = np.array([time for part in parts for time in sorted(part)], np.float64) * base
    if not len(times) or not base:
        raise CaptureError(f"{path}: expected frames with timestamps, found none")
    return np.array([*itertools.accumulate(times.tolist(), lambda before, time: _after(before, time, step))])


def frames(path: Path, remark: Callable[[str], object] = lambda _: None) -> Iterator[tuple[float, "VideoFrame"]]:
    """Decode a video; a few damaged frames, and those of which the decoder had to make parts up, are left out.

    Args:
        path: the video file.
        remark: called at the end with a sentence that says how many, if any.

    Yields:
        Seconds in the time of the file, ascending, and the frame, not yet turned upright. A time that is not later than
        the one before is moved to one frame after it.

    Raises:
        CaptureError: as ``open_video`` does, where the size of the images changes, or where more than ``MOST_DAMAGED``
            of the frames are damaged, or missing at the end.
    """
    damage, size, last = Damage(), None, -math.inf
    with open_video(path) as container:
        step = interval(images.video_track(container))
        try:
            for frame in decoded(path, container, damage):
                size = size or (frame.width, frame.height)
                if size != (frame.width, frame.height):
                    got = f"{size} and {frame.width, frame.height}"
                    raise CaptureError(f"{path}: expected frames of one size, got {got}")
                if frame.time is not None and not frame.is_corrupt:
                    last = _after(last, frame.time, step)
                    yield last, frame
        except ValueError as error:
            raise CaptureError(str(error)) from error
    if (said := _damaged(path, damage)) is not None:
        remark(said)


def _damaged(path: Path, damage: Damage) -> str | None:
    """Return a sentence that says how many frames are damaged, if any; refuse a video of which too many are."""
    damaged = damage.refused + len(damage.corrupt) + damage.missing
    ends = f"; it breaks off, and the last {damage.missing} are missing" if damage.missing else ""
    if damaged > max(1.0, MOST_DAMAGED * damage.frames):
        if damage.corrupt:
            ends += JOINED.format(damage.corrupt[0])
        raise CaptureError(
            f"{path}: expected at most {100 * MOST_DAMAGED:.0f} % damaged frames, got {damaged} of {damage.frames}"
            f"{ends}"
        )
    return (
        f"{damaged} of {damage.frames} frames of {path.name} are damaged, and are not used{ends}." if damaged else None
    )


def _after(before: float, time: float, step: float) -> float:
    """Return when a frame is shown, which is after the frame before whatever time its file states, seconds."""
    return time if time > before else before + step


def grey(frame: "VideoFrame", longest: int) -> np.ndarray:
    """Return the brightness of a frame, scaled down: [H, W] uint8.

    Args:
        frame: the frame as decoded.
        longest: maximum pixels along the longer side.
    """
    scale = min(1.0, longest / max(frame.width, frame.height))
    size = max(3, round(frame.width * scale)), max(3, round(frame.height * scale))
    if frame.interlaced_frame:
        field = images.one_field(Image.fromarray(frame.reformat(format="gray").to_ndarray()))
        return np.asarray(field.resize(size, Image.Resampling.BOX))
    return frame.reformat(*size, "gray").to_ndarray()


def upright(frame: "VideoFrame", longest: int, aspect: float) -> Image.Image:
    """Return a frame's image as the phone was held, with square pixels, scaled down by area, in standard dynamic range.

    Args:
        frame: the frame as decoded.
        longest: maximum pixels along the longer side.
        aspect: the video's ``aspect_of``.
    """
    return usual_range(shrunk(images.displayed(frame, aspect), longest), frame.color_trc)


def shrunk(image: Image.Image, longest: int) -> Image.Image:
    """Scale an RGB image down, by area, to at most ``longest`` pixels along its longer side; never enlarge it."""
    size = shrunk_size(image.size, longest)
    return image if size == image.size else image.resize(size, Image.Resampling.BOX)


def shrunk_size(size: tuple[int, int], longest: int) -> tuple[int, int]:
    """Return the width and height of an image of this size once it is ``shrunk``, pixels."""
    scale = min(1.0, longest / max(size))
    return max(1, round(size[0] * scale)), max(1, round(size[1] * scale))


def within_bars(rows: np.ndarray, columns: np.ndarray) -> tuple[int, int, int, int]:
    """Return what is left of images without the black bars with which editors and messengers change a film's shape.

    The same width is cut from two opposite sides, so that the middle of the image stays where the lens pointed.

    Args:
        rows: [N, H] brightest grey level of each row of each image.
        columns: [N, W] brightest grey level of each column of each image.

    Returns:
        Left, upper, right and lower edge, pixels.
    """

    def edges(brightest: np.ndarray) -> tuple[int, int]:
        size, lit = brightest.shape[1], np.flatnonzero((brightest > BLACK).mean(0) >= LIT)
        width = int(min(lit[0], size - 1 - lit[-1])) if len(lit) else 0
        cut = width + math.ceil(EDGE * size) if width >= THINNEST * size else 0
        return (cut, size - cut) if size - 2 * cut >= 16 else (0, size)

    (upper, lower), (left, right) = edges(rows), edges(columns)
    return left, upper, right, lower
