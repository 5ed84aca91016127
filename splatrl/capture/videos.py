"""The frames of a video, upright, and the times at which they are shown."""

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from PIL import Image

from splatrl import images
from splatrl.capture.base import CaptureError
from splatrl.capture.high_range import UNKNOWN, usual_range

if TYPE_CHECKING:
    from av import VideoFrame
    from av.container import InputContainer


MOST_DAMAGED = 0.03
"""Maximum fraction of a video's frames that may be damaged; some bytes are often lost in a transfer."""
BLACK, THINNEST, EDGE = 24, 0.01, 0.005
"""Maximum grey level of a bar, its minimum width as a fraction of the image's side, and the extra fraction that is cut
off because the bar's edge is blurred."""


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
        return container.streams.video[0].width, container.streams.video[0].height


class Encoding(NamedTuple):
    """How a video's images are to be shown.

    Attributes:
        transfer: FFmpeg's number of the transfer function, by which values stand for light.
        aspect: width of a pixel over its height.
    """

    transfer: int = UNKNOWN
    aspect: float = 1.0


def encoding_of(path: Path) -> Encoding:
    """Return how a video's images are to be shown.

    Args:
        path: the video file.

    Raises:
        CaptureError: as ``open_video`` does.
    """
    with open_video(path) as container:
        transfer = int(container.streams.video[0].codec_context.color_trc)
        return Encoding(transfer, images.pixel_aspect(container))


def packet_times(path: Path) -> np.ndarray:
    """Return when each frame of a video is shown, without decoding any; frames that an edit has cut away are left out.

    Args:
        path: the video file.

    Returns:
        [N] float64 seconds, ascending, in the time of the file.

    Raises:
        CaptureError: as ``open_video`` does, or where the file holds no frames or no times.
    """
    with open_video(path) as container:
        stream = container.streams.video[0]
        packets = (packet for packet in container.demux(stream) if packet.size and not packet.is_discard)
        times = [packet.pts for packet in packets if packet.pts is not None]
        base = float(stream.time_base or 0)
    if not times or not base:
        raise CaptureError(f"{path}: expected frames with timestamps, found none")
    return np.sort(np.asarray(times, np.float64)) * base


def frames(path: Path, remark: Callable[[str], object] = lambda _: None) -> Iterator[tuple[float, "VideoFrame"]]:
    """Decode a video; a few damaged frames are left out.

    Args:
        path: the video file.
        remark: called at the end with a sentence that says how many, if any.

    Yields:
        Seconds in the time of the file, and the frame, not yet turned upright.

    Raises:
        CaptureError: as ``open_video`` does, where the size of the images changes, or where more than ``MOST_DAMAGED``
            of the frames are damaged.
    """
    import av

    with open_video(path) as container:
        stream = container.streams.video[0]
        stream.thread_type = "AUTO"
        size, aspect, count, damaged = None, images.pixel_aspect(container), 0, 0
        for packet in container.demux(stream):
            count += packet.size > 0
            try:
                decoded = packet.decode()
            except av.InvalidDataError:
                damaged += 1
                continue
            for frame in decoded:
                images.require_small(path, *images.square_size(frame.width, frame.height, aspect))
                if frame.time is None:
                    continue
                size = size or (frame.width, frame.height)
                if size != (frame.width, frame.height):
                    raise CaptureError(
                        f"{path}: expected frames of one size, got {size} and {frame.width, frame.height}"
                    )
                yield frame.time, frame
        if damaged > max(1.0, MOST_DAMAGED * count):
            raise CaptureError(
                f"{path}: expected at most {100 * MOST_DAMAGED:.0f} % damaged frames, got {damaged} of {count}"
            )
        if damaged:
            remark(f"{damaged} of {count} frames of {path.name} are damaged, and are not used.")


def grey(frame: "VideoFrame", longest: int) -> np.ndarray:
    """Return the brightness of a frame, scaled down: [H, W] uint8.

    Args:
        frame: the frame as decoded.
        longest: maximum pixels along the longer side.
    """
    scale = min(1.0, longest / max(frame.width, frame.height))
    small = frame.reformat(max(3, round(frame.width * scale)), max(3, round(frame.height * scale)), "gray")
    return small.to_ndarray()


def upright(frame: "VideoFrame", longest: int, encoding: Encoding) -> Image.Image:
    """Return a frame's image as the phone was held, with square pixels, scaled down by area, in standard dynamic range.

    Args:
        frame: the frame as decoded.
        longest: maximum pixels along the longer side.
        encoding: encoding of the video.
    """
    return usual_range(shrunk(images.displayed(frame, encoding.aspect), longest), encoding.transfer)


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
        rows: [H] brightest grey level of each row, over all images.
        columns: [W] brightest grey level of each column, over all images.

    Returns:
        Left, upper, right and lower edge, pixels.
    """

    def edges(brightest: np.ndarray) -> tuple[int, int]:
        size, lit = len(brightest), np.flatnonzero(brightest > BLACK)
        width = int(min(lit[0], size - 1 - lit[-1])) if len(lit) else 0
        cut = width + math.ceil(EDGE * size) if width >= THINNEST * size else 0
        return (cut, size - cut) if size - 2 * cut >= 16 else (0, size)

    (upper, lower), (left, right) = edges(rows), edges(columns)
    return left, upper, right, lower
