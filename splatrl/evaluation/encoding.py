"""Encoding images as a video."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from types import MappingProxyType

from PIL import Image

from splatrl.files import replacing

X264 = {"crf": "18", "preset": "veryfast", "x264-params": "mbtree=0"}
"""Encoder options; macroblock-tree rate control is off, since with it x264's output differs from run to run."""


def encode(
    frames: Iterable[Image.Image], path: Path, fps: int, options: Mapping[str, str] = MappingProxyType({})
) -> None:
    """Encode images of one size with even sides as an mp4: H.264, or MPEG-4 if PyAV lacks that.

    Args:
        frames: at least one image.
        path: the video file.
        fps: frames per second.
        options: further encoder options.
    """
    import av
    from av.video.reformatter import Colorspace

    x264 = "libx264" in av.codecs_available
    # opened by name: FFmpeg then reports disk errors itself
    with replacing(path) as file, av.open(file.name, "w", format="mp4") as container:
        stream = container.add_stream("libx264" if x264 else "mpeg4", rate=fps)
        stream.pix_fmt = "yuv420p"
        stream.codec_context.colorspace = Colorspace.ITU601  # as from_image; unnamed, HD is shown as BT.709
        stream.options = {**(X264 if x264 else {"qscale": "3"}), **options}
        for number, image in enumerate(frames):
            if number == 0:
                stream.width, stream.height = image.size
            container.mux(stream.encode(av.VideoFrame.from_image(image)))
        container.mux(stream.encode(None))
