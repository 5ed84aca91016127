import struct
import warnings
import zlib
from pathlib import Path

import av
import numpy as np
import pytest
import torch
from PIL import Image

from splatrl import images
from splatrl.evaluation import clip_files
from splatrl.evaluation.clip_files import film_images, read_clips, write_clip
from splatrl.files import new_folder
from tests.capture.ray_cast import damage_frame, write_video

NAMES = ("forward", "back", "left", "right")


def gray(level: int, size: tuple[int, int] = (10, 6)) -> Image.Image:
    return Image.new("RGB", size, (level, level, level))


def folder_clip(folder: Path, table: str = "frame,action\n0,left\n", names: tuple[str, ...] = ("000.png",)) -> Path:
    folder.mkdir(parents=True)
    for number, name in enumerate(names):
        gray(20 * number).save(folder / name)
    (folder / "actions.csv").write_text(table)
    return folder


def video_clip(path: Path, levels: list[int], table: str) -> None:
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=10)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        for level in levels:
            container.mux(stream.encode(av.VideoFrame.from_image(gray(level, (64, 48)))))
        container.mux(stream.encode(None))
    path.with_suffix(".csv").write_text(table)


def levels(clip: clip_files.Clip) -> list[int]:
    return [int(np.asarray(image).mean()) for image in clip.images()]


def test_a_written_clip_is_read_back_unchanged(tmp_path: Path) -> None:
    images = torch.randint(0, 256, (3, 5, 7, 3), dtype=torch.uint8)
    allowed = torch.tensor([[True, False, False, True], [False] * 4, [False, True, False, False]])
    write_clip(tmp_path / "walk", images, allowed, NAMES)
    (clip,) = read_clips(tmp_path, NAMES)
    assert clip.name == "walk"
    assert clip.labels == {0: {0, 3}, 2: {1}}
    assert (tmp_path / "walk" / "actions.csv").read_text().split() == ["frame,action", "0,forward|right", "2,back"]
    for image, written in zip(clip.images(), images, strict=True):
        assert torch.equal(torch.from_numpy(np.array(image)), written)


def test_a_failed_clip_leaves_no_files_and_an_existing_clip_is_left_alone(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="zip"):
        write_clip(tmp_path / "walk", torch.zeros(1, 2, 2, 3), torch.ones(1, 3, dtype=torch.bool), NAMES)
    with pytest.raises(RuntimeError, match="half way"), new_folder(tmp_path / "walk") as made:
        (made / "000.png").write_bytes(b"a part")
        assert made.parent == tmp_path and made.name.startswith(".")
        raise RuntimeError("half way")
    assert list(tmp_path.iterdir()) == []
    folder_clip(tmp_path / "walk")
    with pytest.raises(ValueError, match="expected a new folder"):
        write_clip(tmp_path / "walk", torch.zeros(1, 2, 2, 3), torch.ones(1, 4, dtype=torch.bool), NAMES)
    assert len(list((tmp_path / "walk").iterdir())) == 2


def test_images_are_ordered_by_number_and_other_files_are_ignored(tmp_path: Path) -> None:
    folder = folder_clip(tmp_path / "a", names=("2.png", "10.jpg", "f1-9.JPEG", "f1-10.png"))
    (folder / ".hidden.png").write_bytes(b"")
    (folder / "notes.txt").write_bytes(b"")
    folder_clip(tmp_path / ".b.1234.tmp")
    (tmp_path / "clips.md").write_text("")
    (clip,) = read_clips(tmp_path, NAMES)
    assert levels(clip) == [0, 20, 40, 60]


def test_a_video_is_read_with_the_table_beside_it(tmp_path: Path) -> None:
    video_clip(tmp_path / "walk.mp4", [10, 90, 200], "frame,action\n0,left\n2, forward | left \n , \n")
    folder_clip(tmp_path / "another")
    another, walk = read_clips(tmp_path, NAMES)
    assert (another.name, walk.name) == ("another", "walk")
    assert walk.labels == {0: {2}, 2: {0, 2}}
    assert levels(walk) == pytest.approx([10, 90, 200], abs=3)


def test_a_photo_is_turned_upright_as_its_exif_data_says(tmp_path: Path) -> None:
    folder = folder_clip(tmp_path / "a")
    exif = Image.Exif()
    exif[0x0112] = 6  # orientation 6: the image lies on its side
    gray(9, (30, 20)).save(folder / "000.jpg", exif=exif)
    (folder / "000.png").unlink()
    assert [image.size for image in read_clips(tmp_path, NAMES)[0].images()] == [(20, 30)]


@pytest.mark.parametrize("separator", [",", ";", "\t"])
def test_a_table_exported_from_a_spreadsheet_is_read(tmp_path: Path, separator: str) -> None:
    folder = folder_clip(tmp_path / "a", names=("0.png", "1.png"))
    table = "\ufeffframe, action\r\n1,left\r\n\r\n".replace(",", separator)
    (folder / "actions.csv").write_bytes(table.encode())
    assert read_clips(tmp_path, NAMES)[0].labels == {1: {2}}


@pytest.mark.parametrize(
    ("table", "message"),
    [
        (
            "frame,action\n0,fly\n",
            r"actions\.csv, line 2: expected one or more of forward, back, left, right, got 'f",
        ),
        ("frame,action\n0,left|\n", "line 2: expected one or more of .* got ''"),
        ("frame,action\n0,left\n0,left\n", "line 3: expected each frame once, got 0, already on line 2"),
        ("frame,action\n-1,left\n", "line 2: expected a frame number \\(0 or more\\), got '-1'"),
        ("frame,action\n²,left\n", "line 2: expected a frame number"),
        ("frame,action\n" + "9" * 5000 + ",left\n", "line 2: expected a frame number"),
        ("frame,action\n0,left,right\n", "line 2: expected a frame number and an action, got 3 cells"),
        ("frame;action\n0,0;left\n", "line 2: expected a frame number \\(0 or more\\), got '0,0'"),
        ("number,action\n0,left\n", "line 1: expected frame,action, got 'number,action'"),
        ("", "line 1: expected frame,action, got ''"),
        ("frame,action\n", "expected at least one labelled frame"),
        ('frame,action\n0,"' + "x" * 200_000 + '"\n', "expected a CSV"),
        ("frame,action\n0,left\xff\n".encode("latin-1"), "expected a CSV file in UTF-8"),
    ],
)
def test_an_invalid_label_is_reported_with_its_line(tmp_path: Path, table: str | bytes, message: str) -> None:
    folder = folder_clip(tmp_path / "a")
    (folder / "actions.csv").write_bytes(table if isinstance(table, bytes) else table.encode())
    with pytest.raises(ValueError, match=message):
        read_clips(tmp_path, NAMES)


@pytest.mark.parametrize("kind", ["folder", "video"])
def test_a_label_beyond_the_last_frame_is_reported_with_its_line(tmp_path: Path, kind: str) -> None:
    table = "frame,action\n1,left\n\n3,right\n"
    if kind == "folder":
        folder_clip(tmp_path / "a", table, ("0.png", "1.png", "2.png"))
    else:
        video_clip(tmp_path / "a.mp4", [1, 2, 3], table)
    with pytest.raises(ValueError, match="line 4: expected a frame number from 0 to 2, got 3"):
        list(read_clips(tmp_path, NAMES)[0].images())


def test_a_table_that_is_too_large_is_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder_clip(tmp_path / "a")
    monkeypatch.setattr(clip_files, "MAX_CSV_BYTES", 10)
    with pytest.raises(ValueError, match="expected at most 10 bytes, got 20"):
        read_clips(tmp_path, NAMES)


def test_the_error_for_a_folder_without_clips_says_what_is_missing(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="expected a folder of clips"):
        read_clips(tmp_path / "nowhere", NAMES)
    with pytest.raises(ValueError, match="expected sub-folders"):
        read_clips(tmp_path, NAMES)
    (tmp_path / "a").mkdir()
    with pytest.raises(ValueError, match="expected images"):
        read_clips(tmp_path, NAMES)
    gray(1).save(tmp_path / "a" / "0.png")
    with pytest.raises(ValueError, match="expected a CSV file with the columns"):
        read_clips(tmp_path, NAMES)
    (tmp_path / "a" / "actions.csv").write_text("frame,action\n0,left\n")
    (tmp_path / "b.csv").write_text("frame,action\n0,left\n")
    with pytest.raises(ValueError, match=r"b\.csv: expected a video of the same name"):
        read_clips(tmp_path, NAMES)


def png(width: int, height: int) -> bytes:
    """Return a PNG with a valid header and almost no pixel data."""

    def chunk(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(b"few")) + chunk(b"IEND", b"")


@pytest.mark.filterwarnings("ignore::PIL.Image.DecompressionBombWarning")
@pytest.mark.parametrize(
    ("content", "message"),
    [
        (png(9000, 9000), "expected images of at most 67,108,864 pixels, got 9000 × 9000"),
        (png(60_000, 60_000), "expected a complete PNG or JPEG"),
        (png(20, 20), "expected a complete PNG or JPEG"),
        (b"", "expected a complete PNG or JPEG"),
        (b"GIF89a", "expected a complete PNG or JPEG"),
    ],
)
def test_an_image_that_is_damaged_or_absurdly_large_is_refused(tmp_path: Path, content: bytes, message: str) -> None:
    folder = folder_clip(tmp_path / "a")
    (folder / "000.png").write_bytes(content)
    with pytest.raises(ValueError, match=rf"000\.png: {message}"):
        list(read_clips(tmp_path, NAMES)[0].images())


def test_a_video_that_is_damaged_or_too_large_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    video_clip(tmp_path / "a.mp4", [1, 2], "frame,action\n0,left\n")
    monkeypatch.setattr(images, "MAX_PIXELS", 64 * 48 - 1)
    (clip,) = read_clips(tmp_path, NAMES)
    with pytest.raises(ValueError, match="got 64 × 48"):
        list(clip.images())
    clip.source.write_bytes(b"no video")
    with pytest.raises(ValueError, match="expected a complete video"):
        list(clip.images())


def test_frames_that_a_film_lost_are_counted_since_labels_may_belong_to_others(tmp_path: Path) -> None:
    write_video(tmp_path / "a.mp4", [np.full((48, 64, 3), 5 * number, np.uint8) for number in range(40)], intra=True)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert len(list(film_images(tmp_path / "a.mp4"))) == 40
    for number in (12, 17):
        damage_frame(tmp_path / "a.mp4", number)
    with pytest.warns(UserWarning, match=r"a\.mp4: 2 of 40 frames cannot be decoded; labels after them"):
        assert len(list(film_images(tmp_path / "a.mp4"))) == 38


def test_a_film_that_begins_within_a_group_of_pictures_is_told(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    options = {"g": "12", "bf": "0", "x264-params": "scenecut=0"}
    with av.open(str(tmp_path / "a.ts"), "w") as container:
        stream = container.add_stream("h264", rate=10, options=options)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        packets = []
        for _ in range(30):
            image = rng.integers(0, 256, (48, 64, 3), dtype=np.uint8)
            packets += stream.encode(av.VideoFrame.from_ndarray(image))
        for packet in [*packets, *stream.encode(None)][5:]:
            container.mux(packet)
    with pytest.warns(UserWarning, match=r"a\.ts: 7 of 25 frames cannot be decoded; labels after them"):
        assert len(list(film_images(tmp_path / "a.ts"))) == 18


def test_a_playlist_disguised_as_a_video_cannot_read_other_files(tmp_path: Path) -> None:
    (tmp_path / "clips").mkdir()
    video_clip(tmp_path / "secret.mp4", [1, 2], "frame,action\n0,left\n")
    video_clip(tmp_path / "clips" / "a.mp4", [1, 2], "frame,action\n0,left\n")
    (tmp_path / "secret.mp4").rename(tmp_path / "clips" / "secret.bin")
    (tmp_path / "clips" / "a.mp4").write_text("ffconcat version 1.0\nfile secret.bin\n")
    (clip,) = read_clips(tmp_path / "clips", NAMES)
    with pytest.raises(ValueError, match="expected a complete video"):
        list(clip.images())
