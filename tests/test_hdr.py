"""Films of high dynamic range are converted to the colours that they represent."""

from pathlib import Path

import av
import numpy as np
import pytest
from PIL import Image

from splatrl.capture.frames import read_photos
from splatrl.evaluation.clip_files import film_images
from splatrl.hdr import HLG, PQ, usual_range

FROM_SRGB = np.array([[0.6274, 0.3293, 0.0433], [0.0691, 0.9195, 0.0114], [0.0164, 0.0880, 0.8956]])
MEANT = np.array([[200, 60, 60], [60, 180, 60], [60, 60, 200], [255, 255, 255], [60, 60, 60], [200, 150, 110]])


def _signal(light: np.ndarray, transfer: int) -> np.ndarray:
    """Return the signal that a camera writes for light, where 1 is paper white (ITU-R BT.2100)."""
    if transfer == PQ:
        root = (light * 203 / 10_000) ** 0.1593017578125
        return ((0.8359375 + 18.8515625 * root) / (1 + 18.6875 * root)) ** 78.84375
    scene = light * 0.26496
    above = 0.17883277 * np.log(np.maximum(12 * scene - 0.28466892, 1e-9)) + 0.55991073
    return np.where(scene <= 1 / 12, np.sqrt(3 * scene), above)


@pytest.mark.parametrize("transfer", [HLG, PQ])
def test_high_dynamic_range_is_converted_to_the_intended_colours(transfer: int) -> None:
    written = _signal((MEANT / 255.0) ** 2.2 @ FROM_SRGB.T, transfer)
    image = Image.fromarray((255 * written).round().astype(np.uint8)[None])
    assert np.abs(np.asarray(usual_range(image, transfer))[0].astype(int) - MEANT).max() <= 8
    assert np.abs(np.asarray(image)[0].astype(int) - MEANT).max() > 40
    assert usual_range(image, 1) is image


@pytest.mark.parametrize(
    ("transfer", "codec", "shown"), [(2, "h264", 173), (HLG, "h264", 220), (HLG, "prores_ks", 220)]
)
def test_the_dynamic_range_of_a_film_is_read_from_its_metadata(
    transfer: int, codec: str, shown: int, tmp_path: Path
) -> None:
    film = tmp_path / "a.mov"
    with av.open(str(film), "w") as container:
        stream = container.add_stream(codec, rate=10)
        stream.width, stream.height = 64, 48
        stream.pix_fmt = "yuv420p" if codec == "h264" else "yuv422p10le"
        if codec != "h264":
            stream.codec_context.open()  # its frames then name no colours, only the file does
            stream.codec_context.color_primaries = stream.codec_context.colorspace = 9  # BT.2020
        stream.codec_context.color_trc = transfer
        for _ in range(3):
            grey = np.full((48, 64, 3), 173, np.uint8)  # slightly darker than paper white in HLG
            container.mux(stream.encode(av.VideoFrame.from_ndarray(grey, format="rgb24")))
        container.mux(stream.encode())
    photos = read_photos(film, tmp_path / "out", count=(3, 3))
    for image in (Image.open(photos.paths[0]), *film_images(film)):
        assert np.asarray(image).mean() == pytest.approx(shown, abs=6)  # one stored level is two and a half shown ones
