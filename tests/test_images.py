"""Videos from strangers: what their images say holds, not what the file says of them."""

from pathlib import Path

import av
import numpy as np
import pytest

from splatrl import images
from splatrl.evaluation.clip_files import film_images


def _coded(side: int) -> list[av.Packet]:
    """An image in MPEG-2, which says its own size."""
    coder = av.CodecContext.create("mpeg2video", "w")
    coder.width, coder.height, coder.pix_fmt, coder.framerate = side, side, "yuv420p", 25
    frame = av.VideoFrame.from_ndarray(np.full((side, side, 3), 90, np.uint8))
    return [*coder.encode(frame), *coder.encode(None)]


def decoded(packet: av.Packet) -> list[av.VideoFrame]:
    try:
        return packet.decode()
    except av.error.FFmpegError:
        return []


def test_an_image_that_is_larger_than_its_file_says_is_not_decoded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "film.mkv"
    with av.open(str(path), "w") as container:
        track = container.add_stream("mpeg2video", rate=25)
        track.width, track.height, track.pix_fmt = 32, 32, "yuv420p"
        for number, packet in enumerate([*_coded(32), *_coded(32), *_coded(256)]):
            packet.stream, packet.pts, packet.dts = track, number, number
            container.mux(packet)
    monkeypatch.setattr(images, "MAX_PIXELS", 64 * 64)
    with images.open_video(path) as film:
        assert {frame.width for packet in film.demux(video=0) for frame in decoded(packet)} == {32}
    with pytest.raises(ValueError, match=r"film\.mkv: expected"):
        list(film_images(path))
    monkeypatch.setattr(images, "MAX_PIXELS", 256 * 256)
    assert {image.size for image in film_images(path)} == {(32, 32), (256, 256)}
