"""The frames of videos from strangers, and what of these is damaged."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from splatrl.images import pixel_aspect, require_small, square_size, video_track

if TYPE_CHECKING:
    from av import VideoFrame
    from av.container import InputContainer
    from av.video.stream import VideoStream

UNSAID = 0, 2
"""FFmpeg's numbers of an unspecified transfer function."""
USUAL_RATE = 30
"""Frames per second of a video that does not tell."""


@dataclass
class Damage:
    """What is damaged in a video, complete once all of its frames have been read.

    Attributes:
        frames: number of frames in the file, with those that it lacks.
        refused: number of frames that could not be decoded.
        corrupt: times of the frames of which the decoder had to make parts up, seconds from the film's beginning.
        silent: number of frames at the beginning that the decoder left out without an error, as where those are missing
            to which they refer.
        missing: number of frames that a file which breaks off lacks.
    """

    frames: int = 0
    refused: int = 0
    corrupt: list[float] = field(default_factory=list)
    silent: int = 0
    missing: int = 0


def decoded(path: Path, container: "InputContainer", damage: Damage) -> Iterator["VideoFrame"]:
    """Decode a video, and count what is damaged.

    Args:
        path: path of the file, for messages.
        container: the file, as ``open_video`` opens it.
        damage: a new count, which is filled in.

    Yields:
        Every frame that the decoder shows, corrupt ones as well.

    Raises:
        ValueError: for a frame that is too large; the size may change within a video.
    """
    import av

    stream, aspect, begun = video_track(container), pixel_aspect(container), False
    stream.thread_type = "AUTO"  # with threads for slices alone, no frame counts as corrupt
    transfer = stream.codec_context.color_trc  # of the file, which its frames need not repeat; decoding replaces it
    start, base = stream.start_time or 0, float(stream.time_base or 0)
    end, before = start, list[int]()
    for packet in container.demux(stream):
        damage.frames += packet.size > 0
        if packet.pts is not None and not packet.is_discard:
            end = max(end, packet.pts + (packet.duration or 0))
        try:
            frames = packet.decode()
        except av.InvalidDataError:
            damage.refused += 1
            continue
        if not begun and packet.pts is not None and not packet.is_discard:
            before.append(packet.pts)
        for frame in frames:
            require_small(path, *square_size(frame.width, frame.height, aspect))
            if not begun and frame.pts is not None:
                damage.silent = sum(pts < frame.pts for pts in before)
            begun = True
            if frame.color_trc in UNSAID:
                frame.color_trc = transfer
            if frame.is_corrupt:
                damage.corrupt.append(((frame.pts or 0) - start) * base)
            yield frame
    damage.missing = _missing(stream, damage.frames, end)
    damage.frames += damage.missing


def interval(stream: "VideoStream") -> float:
    """Return the usual time from frame to frame, seconds."""
    return 1.0 / float(stream.average_rate or USUAL_RATE)


def _missing(stream: "VideoStream", count: int, end: int) -> int:
    """Return how many frames a file that breaks off lacks; 0 where it does not tell.

    Frames that an edit has cut away are counted, but not shown, so number and duration must both say so.

    Args:
        stream: the video, after all of its packets were read.
        count: number of packets that were read.
        end: end of the last frame that is shown, in the time base of the stream.
    """
    if not stream.frames or stream.duration is None:
        return 0
    left = (stream.duration + (stream.start_time or 0) - end) * float(stream.time_base or 0) / interval(stream)
    return max(0, min(stream.frames - count, round(left)))
