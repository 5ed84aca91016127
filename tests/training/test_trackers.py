"""TensorBoard and Weights & Biases are given numbers, figures and videos."""

import math
import sys
from pathlib import Path

import pytest
from PIL import Image, ImageSequence

from splatrl.evaluation.encoding import encode
from splatrl.training.trackers import MOST_FRAMES, WIDEST, gif, make_tracker
from tests.training.test_trainer import trainer

SETTINGS = {"seed": 3, "task": {"max_steps": 50}}


@pytest.fixture
def media(tmp_path: Path) -> list[Path]:
    """A picture, a video of three frames, and a file that is neither."""
    paths = [tmp_path / name for name in ("starts.png", "rollouts.mp4", "notes.txt")]
    Image.new("RGB", (60, 40), "red").save(paths[0])
    encode((Image.new("RGB", (960, 480), color) for color in ("red", "lime", "blue")), paths[1], fps=5)
    paths[2].write_text("nothing to see")
    return paths


def test_tensorboard_holds_numbers_figures_and_videos(tmp_path: Path, media: list[Path]) -> None:
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    tracker = make_tracker("tensorboard", tmp_path / "run", "mine", "", False, SETTINGS)
    assert tracker is not None
    tracker.scalars({"success": 0.25, "return": math.nan}, 64)
    tracker.scalars({"success": 0.5}, 128)
    tracker.files(media, 128)
    tracker.close()
    events = EventAccumulator(str(tmp_path / "run" / "mine")).Reload()
    assert events.Tags()["scalars"] == ["success"]
    assert [(event.step, event.value) for event in events.Scalars("success")] == [(64, 0.25), (128, 0.5)]
    assert events.Tags()["images"] == ["starts", "rollouts"]
    (picture,), (video,) = events.Images("starts"), events.Images("rollouts")
    assert picture.encoded_image_string == media[0].read_bytes() and (picture.width, picture.height) == (60, 40)
    assert video.encoded_image_string[:6] == b"GIF89a" and video.width == WIDEST
    text = events.Tensors("config/text_summary")[0].tensor_proto.string_val[0].decode()
    assert "seed: 3" in text and "task.max_steps: 50" in text


def test_tensorboard_shows_frames_once_that_a_killed_training_repeats(tmp_path: Path) -> None:
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    for number, (begun, logged) in enumerate(((0, [64, 128, 192]), (128, [192, 256]), (0, [64]))):
        tracker = make_tracker("tensorboard", tmp_path, "mine", "", False, SETTINGS, begun)
        assert tracker is not None
        for frames in logged:
            tracker.scalars({"success": 0.5}, frames)
        tracker.close()
        (path,) = (path for path in (tmp_path / "mine").iterdir() if path.name.startswith("events"))
        path.rename(path.with_name(f"{number}.{path.name}"))  # their own numbers are in order only up to 9
        events = EventAccumulator(str(tmp_path / "mine")).Reload()
        assert [event.step for event in events.Scalars("success")] == [64, 128, 192, 256][: logged[-1] // 64]


def test_a_gif_has_the_frames_and_the_timing_of_the_video(tmp_path: Path, media: list[Path]) -> None:
    size, data = gif(media[1])
    path = tmp_path / "a.gif"
    path.write_bytes(data)
    with Image.open(path) as image:
        frames = [frame.convert("RGB").resize((1, 1)).getpixel((0, 0)) for frame in ImageSequence.Iterator(image)]
        assert image.size == size == (WIDEST, WIDEST // 2) and image.info["duration"] == 200
    assert [max(range(3), key=frame.__getitem__) for frame in frames] == [0, 1, 2]


def test_a_gif_has_a_limited_number_of_frames(tmp_path: Path) -> None:
    path = tmp_path / "long.mp4"
    encode((Image.new("RGB", (16, 16), (i % 256, 0, 255 - i % 256)) for i in range(MOST_FRAMES + 9)), path, fps=30)
    (tmp_path / "a.gif").write_bytes(gif(path)[1])
    with Image.open(tmp_path / "a.gif") as image:
        assert image.n_frames <= MOST_FRAMES


def test_a_training_reports_every_row_to_its_tracker(tmp_path: Path) -> None:
    told: list[tuple[int, float | None]] = []

    class Listener:
        def scalars(self, values, frames):
            told.append((frames, values.get("test_success")))

    loop = trainer(tmp_path, [0.4, 0.9, 0.6])
    loop.tracker = Listener()  # type: ignore[assignment]
    loop.fit()
    assert told == [(64, None), (128, 0.4), (192, None), (256, 0.9), (320, None), (384, 0.6)]


def test_csv_needs_no_tracker_and_unknown_backends_are_refused(tmp_path: Path) -> None:
    assert make_tracker("csv", tmp_path, "mine", "", False, {}) is None
    with pytest.raises(ValueError, match=r"logger\.backend: expected one of csv, tensorboard, wandb, got paper"):
        make_tracker("paper", tmp_path, "mine", "", False, {})
    with pytest.raises(ValueError, match=r"logger\.exp_name"):
        make_tracker("tensorboard", tmp_path, "../mine", "", False, {})


def test_a_tracker_that_is_not_installed_is_named_with_its_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "wandb", None)
    with pytest.raises(ImportError, match=r"logger\.backend=wandb needs wandb: pip install 'splatrl\[wandb\]'"):
        make_tracker("wandb", tmp_path, "mine", "", False, {})


@pytest.mark.slow
def test_wandb_offline_keeps_a_run_with_media_and_resumes_it(tmp_path: Path, media: list[Path]) -> None:
    for frames in (64, 128):
        tracker = make_tracker("wandb", tmp_path, "mine", "trial", False, SETTINGS)
        assert tracker is not None
        tracker.scalars({"success": 0.25, "return": math.nan}, frames)
        tracker.files(media, frames)
        tracker.close()
    runs = sorted((tmp_path / "wandb").glob("offline-run-*"))
    identity = (tmp_path / "wandb.txt").read_text()
    assert len(runs) == 2 and all(run.name.endswith(identity) for run in runs)
    for run in runs:
        names = {path.name.split("_")[0] for path in run.rglob("files/media/**/*") if path.is_file()}
        assert names == {"starts", "rollouts"}
        assert next(run.glob("*.wandb")).stat().st_size > 0
