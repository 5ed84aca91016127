"""What splatrl-capture is told: mistakes in it are answered in one line, before anything is read."""

import sys
from pathlib import Path
from typing import Any

import pytest

from splatrl.capture.base import CaptureError
from splatrl.capture.scale import Click, Distance
from splatrl.capture.settings import CaptureSettings
from splatrl.commands import capture


def test_an_unknown_device_is_refused_in_one_line() -> None:
    with pytest.raises(SystemExit, match=r"^splatrl-capture: device: expected auto, cpu.*, got tpu9"):
        capture.main(["walk.mp4", "--device", "tpu9"])


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["3", "10", "20", "30.5", "40", "2.5"], ((3, 10, 20), (3, 30.5, 40))),
        (["3", "10", "20", "7", "30.5", "-4e1", "2.5"], ((3, 10, 20), (7, 30.5, -40))),
        (["3 10 20, 7 30.5 40, 2.5"], ((3, 10, 20), (7, 30.5, 40))),
        (["IMG_3.JPG", "10", "20", "30.5", "40", "2.5"], (("IMG_3.JPG", 10, 20), ("IMG_3.JPG", 30.5, 40))),
        (["a.png 10 20", "7 30.5 40 2.5"], (("a.png", 10, 20), (7, 30.5, 40))),
    ],
)
@pytest.mark.parametrize("source_last", [False, True])
def test_each_point_of_a_distance_may_be_in_its_own_image(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    words: list[str],
    expected: tuple[tuple[Any, ...], ...],
    source_last: bool,
) -> None:
    given: list[object] = []

    def stop(source: Path, folder: Path, settings: CaptureSettings, *_: object) -> None:
        given.extend([source, settings.distance])
        raise CaptureError("far enough")

    monkeypatch.setattr(capture, "capture", stop)
    option = ["--distance", *words]
    with pytest.raises(SystemExit, match="far enough"):
        capture.main([*option, "garden.mp4"] if source_last else ["garden.mp4", *option, "--seed", "1"])
    first, second = (Click(image, x, y) for image, x, y in expected)
    assert given == [Path("garden.mp4"), Distance((first,), (second,), 2.5)]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["1", "2", "3"], "expected IMAGE X Y X Y M or IMAGE X Y IMAGE X Y M, got '1 2 3'"),
        (["1.5", "2", "3", "4", "5", "6"], "expected the name or the number of an image, got 1.5"),
        (["1", "2", "3", "inf", "4", "5", "6"], "expected the name or the number of an image, got inf"),
        (["1", "2", "a.jpg", "4", "5", "6"], "expected IMAGE X Y X Y M or IMAGE X Y IMAGE X Y M, got '1 2 a.jpg"),
        (["1", "2", "3", "4", "5", "-6"], "expected a number of metres above 0.0, got -6"),
    ],
)
def test_an_invalid_distance_is_a_usage_error(
    words: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        capture.main(["garden.mp4", "--distance", *words])
    assert message in capsys.readouterr().err


@pytest.mark.parametrize(
    ("typed", "message"),
    [
        ("--camera-height=0", "expected a number of metres above 0.0, got 0.0"),
        ("--camera-height=-1.4", "expected a number of metres above 0.0, got -1.4"),
        ("--camera-height=nan", "expected a number of metres above 0.0, got nan"),
        ("--camera-height=inf", "expected a number of metres above 0.0, got inf"),
        ("--marker-side=-1", "expected a number of metres above 0.0, got -1.0"),
        ("--gaussians=0", "expected a whole number of at least 1, got 0"),
        ("--width=5", "expected a whole number of pixels, at least 16, got 5"),
        ("--robot-width=0", "expected a whole number of pixels, at least 1, got 0"),
        ("--views=0", "expected a whole number of at least 1, got 0"),
        ("--seed=-1", "expected a whole number from 0 to 2147483647, got -1"),
        ("--seed=99999999999999999999", "expected a whole number from 0 to 2147483647, got 99999999999999999999"),
        ("--out=", "expected a folder, got an empty name"),
    ],
)
def test_numbers_out_of_range_are_refused_before_a_capture_begins(
    typed: str, message: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(capture, "capture", lambda *_: pytest.fail("it began"))
    with pytest.raises(SystemExit):
        capture.main(["garden.mp4", typed])
    assert f"splatrl-capture: {typed.partition('=')[0]}: {message};" in capsys.readouterr().err


def test_a_page_with_a_marker_is_written_without_a_capture(tmp_path: Path) -> None:
    capture.main(["--marker", str(tmp_path / "marker.pdf")])
    assert (tmp_path / "marker.pdf").read_bytes().startswith(b"%PDF")
    for path, message in ((tmp_path / "none" / "m.pdf", "No such file"), (tmp_path / "m.png", "a name that ends in")):
        with pytest.raises(SystemExit, match=f"^splatrl-capture: .*{message}"):
            capture.main(["--marker", str(path)])
    assert [path.name for path in tmp_path.iterdir()] == ["marker.pdf"]


def test_a_missing_extra_is_named_before_the_video_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "cv2", None)
    (tmp_path / "walk.mp4").write_bytes(b"not read")
    with pytest.raises(SystemExit, match=r"^splatrl-capture: cv2 is missing: pip install 'splatrl\[capture\]'$"):
        capture.main([str(tmp_path / "walk.mp4"), "--out", str(tmp_path / "place")])
    assert [path.name for path in tmp_path.iterdir()] == ["walk.mp4"]


def test_a_missing_source_is_a_usage_error(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        capture.main([])
    assert "expected a video or a folder of photos, or --marker" in capsys.readouterr().err


def test_several_sources_are_refused_by_name_with_the_advice_to_join_takes(capsys: pytest.CaptureFixture[str]) -> None:
    for typed in (["a.mp4", "b.mp4"], ["a.mp4", "--still", "b.mp4"]):
        with pytest.raises(SystemExit):
            capture.main(typed)
        said = capsys.readouterr().err
        assert "expected one video or one folder, got a.mp4, b.mp4; name the folder of photos, and first join" in said
    with pytest.raises(SystemExit):
        capture.main(["a.mp4", "--stil1"])
    assert "unrecognized arguments: --stil1" in capsys.readouterr().err
