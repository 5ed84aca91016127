"""Sprites: the built-in apple, and image files with alpha."""

import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from splatrl.envs.drawing import Sprite, load_sprite
from splatrl.envs.drawing.apple_picture import apple


def test_the_apple_is_red_and_fills_the_width_of_its_picture() -> None:
    picture = apple(128) / 255.0
    red, green, blue, alpha = np.moveaxis(picture, -1, 0)
    opaque = alpha > 0.98
    clearly_red = (red >= 0.4) & (red >= 1.6 * green) & (red >= 1.6 * blue)
    assert clearly_red[opaque].mean() >= 0.9
    assert (green > 1.2 * red)[opaque].mean() > 0.01  # a leaf
    columns = np.flatnonzero((alpha > 0.5).any(0))
    assert columns[0] <= 3 and columns[-1] >= 124
    assert not alpha[[0, 0, -1, -1], [0, -1, 0, -1]].any()  # its corners are empty
    assert ((alpha > 0.02) & (alpha < 0.98)).sum() > 100  # its edge is soft


def test_every_mip_level_has_the_mean_of_the_picture() -> None:
    picture = torch.randint(0, 256, (16, 32, 4), dtype=torch.uint8, generator=torch.Generator().manual_seed(0))
    sprite = Sprite.of(picture)
    alpha = picture[..., 3:].double() / 255
    mean = torch.cat([picture[..., :3] * alpha, alpha], -1).mean((0, 1))
    assert sprite.heights.tolist() == [16, 8, 4, 2, 1, 1] and sprite.widths.tolist() == [32, 16, 8, 4, 2, 1]
    ends = [*sprite.starts[1:].tolist(), len(sprite.texels)]
    for level, (start, end) in enumerate(zip(sprite.starts.tolist(), ends, strict=True)):
        count = sprite.heights[level] * sprite.widths[level]
        torch.testing.assert_close(sprite.texels[start:end].double().sum(0) / count, mean)


def test_the_finest_level_is_the_picture_without_padding() -> None:
    for height, width in ((8, 4), (1, 2)):
        picture = torch.full((height, width, 4), 255, dtype=torch.uint8)
        assert torch.equal(Sprite.of(picture).finest, torch.tensor([255.0, 255, 255, 1]).expand(height * width, 4))


def test_a_picture_of_any_size_keeps_its_aspect_ratio_and_mean_alpha(tmp_path: Path) -> None:
    picture = np.zeros((90, 200, 4), dtype=np.uint8)
    picture[:, :100] = [200, 30, 30, 255]
    Image.fromarray(picture).save(tmp_path / "half.png")
    sprite = load_sprite(tmp_path / "half.png")
    assert sprite.aspect == pytest.approx(0.45)
    assert sprite.texels[sprite.starts[-1], 3].item() == pytest.approx(0.5, abs=0.01)
    color = sprite.texels[sprite.starts[-1], :3] / sprite.texels[sprite.starts[-1], 3]
    torch.testing.assert_close(color, torch.tensor([200.0, 30.0, 30.0]), atol=1.0, rtol=0)


def test_a_palette_with_a_transparent_colour_has_alpha(tmp_path: Path) -> None:
    image = Image.fromarray(np.arange(16, dtype=np.uint8).reshape(4, 4) % 2).convert("P")
    image.save(tmp_path / "palette.png", transparency=0)
    assert load_sprite(tmp_path / "palette.png").texels[-9, 3].item() == pytest.approx(0.5)


def test_grey_of_16_bits_keeps_its_upper_eight_and_its_transparent_grey(tmp_path: Path) -> None:
    grey = np.full((4, 4), 0x6455, np.uint16)
    grey[:, 2:] = 0x6456
    Image.fromarray(grey).save(tmp_path / "grey.png", transparency=0x6456)
    texels = load_sprite(tmp_path / "grey.png").texels[:16].view(4, 4, 4)
    assert texels[0, 0].tolist() == [0x64, 0x64, 0x64, 1.0]
    assert texels[0, 3].tolist() == [0.0, 0.0, 0.0, 0.0]


def _png(width: int, height: int, data: bytes = b"") -> bytes:
    """Encode a PNG with an RGBA header and the given data."""

    def chunk(name: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))

    header = struct.pack(">IIBBBBB", width, height, 8, 6, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(data)) + chunk(b"IEND", b"")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "not a file"),
        (b"", "expected a PNG"),
        (b"GIF89a" + bytes(100), "expected a PNG"),
        (_png(4, 4, bytes(10)), "expected a PNG"),
        (_png(4, 4)[:40], "expected a PNG"),
        (_png(5000, 10), "at most 4096"),
        (_png(2**31 - 1, 2**31 - 1), "sprite"),
    ],
)
def test_a_file_that_is_not_a_sprite_is_refused(tmp_path: Path, content: bytes | None, message: str) -> None:
    path = tmp_path / "sprite.png"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(ValueError, match=message):
        load_sprite(path)


def test_a_picture_without_alpha_is_refused(tmp_path: Path) -> None:
    Image.new("RGB", (8, 8)).save(tmp_path / "rgb.png")
    with pytest.raises(ValueError, match="alpha"):
        load_sprite(tmp_path / "rgb.png")


@pytest.mark.parametrize("shape", [(4, 4, 3), (4, 4), (0, 4, 4)])
def test_an_array_that_is_not_an_rgba_picture_is_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match="sprite"):
        Sprite.of(torch.zeros(shape, dtype=torch.uint8))
