"""A policy's action probabilities for each frame of a video are drawn beside the frame and written to a CSV file."""

import csv
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from splatrl.evaluation.encoding import encode
from splatrl.evaluation.film import HEIGHT, PANEL, draw_film
from splatrl.images import open_video
from tests.evaluation.test_clips import EYE, NAMES, PROBABILITIES, recorder

SIZE = (64, 48)


def frames(count: int) -> list[Image.Image]:
    generator = np.random.default_rng(0)
    return [Image.fromarray(generator.integers(0, 255, (SIZE[1], SIZE[0], 3), dtype=np.uint8)) for _ in range(count)]


def seen(path: Path) -> tuple[int, list[np.ndarray]]:
    with open_video(path) as container:
        rate = container.streams.video[0].average_rate
        return round(float(rate or 0)), [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]


def test_a_video_keeps_its_frames_and_rate_and_every_frame_has_a_csv_row(tmp_path: Path) -> None:
    encode(iter(frames(5)), tmp_path / "walk.mp4", 15)
    shown: list[int] = []
    found = draw_film(recorder()[1], NAMES, tmp_path / "walk.mp4", EYE, tmp_path / "out", progress=shown.append)
    assert found == [tmp_path / "out.mp4", tmp_path / "out.csv"] and shown == [1] * 5
    rate, pages = seen(found[0])
    assert rate == 15 and len(pages) == 5
    assert {page.shape for page in pages} == {(HEIGHT, HEIGHT * SIZE[0] // SIZE[1] + PANEL, 3)}
    rows = list(csv.DictReader(found[1].open()))
    assert [int(row["frame"]) for row in rows] == list(range(5))
    assert {row["action"] for row in rows} == {"right"}, "the most probable"
    for name, chance in zip(NAMES, PROBABILITIES.tolist(), strict=True):
        assert {float(row[name]) for row in rows} == {round(chance, 4)}


@pytest.mark.usefixtures("usual_videos")
def test_the_bars_are_proportional_to_the_action_probabilities(tmp_path: Path) -> None:
    (tmp_path / "photos").mkdir()
    for number, image in enumerate(frames(2)):
        image.save(tmp_path / "photos" / f"{number}.png")
    video, _ = draw_film(recorder()[1], NAMES, tmp_path / "photos", EYE, tmp_path / "out")
    rate, pages = seen(video)
    assert rate == 10 and len(pages) == 2
    lowest = pages[0][HEIGHT // 2 :, -PANEL:].astype(int)
    coloured = (lowest[..., 1] - lowest[..., 0] > 12).sum(1)
    edges = np.flatnonzero(np.diff((coloured > 4).astype(int))) + 1
    bars = [float(np.max(run)) for run in np.split(coloured, edges) if run.max() > 4]
    assert bars == pytest.approx([(PANEL - 20) * chance for chance in PROBABILITIES.tolist()], abs=10)


@pytest.mark.usefixtures("usual_videos")
def test_the_same_video_gives_the_same_bytes(tmp_path: Path) -> None:
    encode(iter(frames(3)), tmp_path / "walk.mp4", 10)
    for name in ("a", "b"):
        draw_film(recorder()[1], NAMES, tmp_path / "walk.mp4", EYE, tmp_path / name)
    for kind in ("mp4", "csv"):
        assert (tmp_path / f"a.{kind}").read_bytes() == (tmp_path / f"b.{kind}").read_bytes()


def test_a_source_that_is_no_video_is_refused_and_leaves_no_files(tmp_path: Path) -> None:
    (tmp_path / "text.mp4").write_text("no video")
    (tmp_path / "empty").mkdir()
    for name, message in (
        ("nowhere.mp4", "expected a video or a folder of photos, found none"),
        ("text.mp4", "expected a complete video"),
        ("empty", "expected at least one frame"),
    ):
        with pytest.raises(ValueError, match=message):
            draw_film(recorder()[1], NAMES, tmp_path / name, EYE, tmp_path / "out")
    assert not list(tmp_path.glob("out*"))
