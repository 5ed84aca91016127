"""A video shows every step of every episode beside the map."""

import itertools
from dataclasses import replace
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
import torch
from PIL import Image, ImageDraw
from torch import Tensor

from splatrl.envs.drawing import SceneDrawing, Shot, View
from splatrl.envs.tasks import Mark, Outcome
from splatrl.evaluation.captions import Captions
from splatrl.evaluation.figure_style import BLUE, MISSED, REACHED
from splatrl.evaluation.recording import Recording
from splatrl.evaluation.topdown import MapView, TopDown
from splatrl.evaluation.video import rollout_video
from splatrl.renderers import Parts, ReferenceRenderer
from tests.tiny import tiny_gaussians, tiny_motion, tiny_robot

GROUND = TopDown(torch.full((39, 29, 3), 255, dtype=torch.uint8), (-1.45, 1.45, -1.95, 1.95))
VIEW = MapView(GROUND, marks=[Mark("goal pose", torch.tensor([0.5, 1.0, 0.0], dtype=torch.float64))])
STRIP = slice(400, None)  # rows of the caption


def recording(shade: int, outcome: Outcome, steps: int = 3) -> Recording:
    """A walk along +y whose pixels have a black left half and a grey right half that brightens with each step."""
    motion = tiny_motion()
    state = torch.tensor([[2, row, 2] for row in range(steps + 1)])
    pixels = (shade + 20 * torch.arange(steps + 1)).view(-1, 1, 1, 1).expand(-1, 12, 16, 3).clone().to(torch.uint8)
    pixels[:, :, :8] = 0
    return Recording(
        planar=motion.planar(state),
        body_to_world=motion.body_to_world(state),
        pixels=pixels,
        action=torch.full((steps,), 2),
        episode_return=-0.2 * torch.arange(steps + 1),
        outcome=outcome,
    )


RECORDINGS = [recording(60, Outcome.GOAL), recording(100, Outcome.COLLISION, steps=2)]


def frames(path: Path) -> list[np.ndarray]:
    with av.open(path) as container:
        stream = container.streams.video[0]
        assert stream.codec_context.pix_fmt == "yuv420p"
        return [frame.to_ndarray(format="rgb24").astype(int) for frame in container.decode(stream)]


def has(picture: np.ndarray, color: str) -> bool:
    wanted = np.array([int(color[i : i + 2], 16) for i in (1, 3, 5)])
    return bool((np.abs(picture - wanted).max(-1) < 30).sum() > 60)


@pytest.fixture(scope="module")
def shown(tmp_path_factory: pytest.TempPathFactory) -> list[np.ndarray]:
    """The frames of both recordings, at 10 frames per second."""
    folder = tmp_path_factory.mktemp("shown")
    rollout_video(RECORDINGS, tiny_robot(), VIEW, folder / "clip.mp4", fps=10)
    assert [path.name for path in folder.iterdir()] == ["clip.mp4"]
    return frames(folder / "clip.mp4")


def test_each_step_is_a_frame_and_the_last_frame_of_an_episode_is_held(shown: list[np.ndarray]) -> None:
    shades = [picture[8:392, 280:500].mean() for picture in shown]
    expected = [60, 80, 100] + [120] * 8 + [100, 120] + [140] * 8
    assert shades == pytest.approx(expected, abs=3)
    height, width, _ = shown[0].shape
    assert height % 2 == 0 and width % 2 == 0


def test_the_policys_pixels_are_enlarged_without_blur(shown: list[np.ndarray]) -> None:
    row = shown[0][200, 8:520].mean(-1)
    assert row[:250] == pytest.approx(0, abs=6) and row[262:] == pytest.approx(60, abs=6)


def test_with_a_drawing_the_view_is_large_and_has_the_policys_pixels_as_an_inset(tmp_path: Path) -> None:
    one = recording(60, Outcome.GOAL, steps=1)
    renderer = ReferenceRenderer(tiny_gaussians())
    rollout_video([one], tiny_robot(), VIEW, tmp_path / "clip.mp4", drawing=SceneDrawing(renderer))
    shown = frames(tmp_path / "clip.mp4")[0]
    small = renderer.pixels(tiny_robot().cameras(one.body_to_world[:1]))[0].numpy().astype(int)
    blocks = shown[8:392, 8:520].reshape(12, 32, 16, 32, 3).mean((1, 3))
    assert np.abs(blocks - small)[:7].mean() < 8 < np.abs(blocks - small[:, ::-1])[:7].mean()  # above the inset
    inset = shown[262:384, 348:512].mean(-1)
    assert inset[:, :78].max() < 8 and inset[:, 90:].min() > 50


def test_a_goal_image_is_shown_in_the_corner_of_the_view(tmp_path: Path, shown: list[np.ndarray]) -> None:
    red = torch.tensor([200, 0, 0], dtype=torch.uint8).expand(12, 16, 3)
    one = replace(recording(60, Outcome.GOAL, steps=1), goal_image=red)
    rollout_video([one], tiny_robot(), VIEW, tmp_path / "clip.mp4")
    with_goal, plain = frames(tmp_path / "clip.mp4")[0], shown[0]
    inset = (slice(262, 384), slice(18, 180))
    assert np.abs(with_goal[inset] - (200, 0, 0)).max() < 30 and plain[inset].max() < 40
    named = with_goal[236:254, 14:60].mean(-1)
    assert named.max() > 200 and plain[236:254, 14:60].mean(-1).max() < 80


def test_goals_are_counted_where_an_episode_has_several(tmp_path: Path) -> None:
    goals = torch.tensor([0, 1, 1, 2])
    one = [replace(RECORDINGS[0], goals=goals)]
    rollout_video(one, tiny_robot(), VIEW, tmp_path / "clip.mp4", goals=5)
    lefts = Captions(one, (), 5, frames(tmp_path / "clip.mp4")[0].shape[1]).lefts
    column = slice(round(lefts[4]) - 4, round(lefts[5]) - 12)
    shown = [picture[STRIP, column] for picture in frames(tmp_path / "clip.mp4")[:4]]
    changed = [bool((np.abs(one - other).max(-1) > 60).any()) for one, other in itertools.pairwise(shown)]
    assert changed == [True, False, True]


def test_the_large_view_is_drawn_with_the_memory_and_parts_of_each_step(tmp_path: Path) -> None:
    steps = 11  # more than one batch of views
    memory = {"target": torch.arange(3.0 * (steps + 1)).view(-1, 3)}
    parts = Parts(torch.arange(steps + 1).view(-1, 1), torch.eye(4).repeat(steps + 1, 1, 1, 1))
    one = replace(recording(60, Outcome.GOAL, steps), memory=memory, parts=parts)
    drawing = Kept()
    rollout_video([one], tiny_robot(), VIEW, tmp_path / "clip.mp4", drawing=drawing)
    poses, targets, models = (torch.cat(kept) for kept in zip(*drawing.asked, strict=True))
    assert torch.equal(poses, tiny_robot().cameras(one.body_to_world).camera_to_world)
    assert torch.equal(targets, memory["target"]) and torch.equal(models, parts.model)


def test_an_outside_camera_adds_a_panel_with_its_views(tmp_path: Path) -> None:
    parts = Parts(torch.zeros(3, 1, dtype=torch.int64), torch.eye(4).repeat(3, 1, 1, 1))
    one = replace(recording(60, Outcome.GOAL, steps=2), memory={"target": torch.zeros(3, 3)}, parts=parts)
    drawing = Kept()
    eyes = tiny_robot().cameras(one.body_to_world.flip(0))
    rollout_video([one], tiny_robot(), VIEW, tmp_path / "wide.mp4", drawing=drawing, outside=lambda _: eyes)
    rollout_video([one], tiny_robot(), VIEW, tmp_path / "clip.mp4", drawing=drawing)
    wide, narrow = (frames(tmp_path / name)[0].shape[1] for name in ("wide.mp4", "clip.mp4"))
    assert abs(wide - narrow - eyes.width - 8) <= 1
    asked = [poses for poses, *_ in drawing.asked]
    assert any(torch.equal(poses, eyes.camera_to_world) for poses in asked)


class Kept(SceneDrawing):
    """Draws black images, and records what it was asked to draw."""

    def __init__(self) -> None:
        super().__init__(ReferenceRenderer(tiny_gaussians()))
        self.asked: list[tuple[Tensor, ...]] = []

    def draw(self, shot: Shot) -> View:
        assert shot.parts is not None
        cameras = shot.cameras
        self.asked.append((cameras.camera_to_world, shot.memory["target"], shot.parts.model))
        return View(torch.zeros(len(cameras), cameras.height, cameras.width, 3, dtype=torch.uint8), {})


def test_the_outcome_is_shown_at_the_end_of_each_episode_and_not_before(shown: list[np.ndarray]) -> None:
    assert [has(picture[STRIP], REACHED) for picture in shown] == [False] * 3 + [True] * 8 + [False] * 10
    assert [has(picture[STRIP], MISSED) for picture in shown] == [False] * 13 + [True] * 8


def test_the_robot_moves_on_the_map(shown: list[np.ndarray]) -> None:
    blue = np.array([int(BLUE[i : i + 2], 16) for i in (1, 3, 5)])
    tops = []
    for picture in shown[:3]:
        rows, columns = (np.abs(picture[:, 528:] - blue).max(-1) < 40).nonzero()
        tops.append(rows.min())
        assert abs(columns.mean() - 142.5) < 3  # x = 0 is the middle of the map
    steps = -np.diff(tops)
    assert steps == pytest.approx(0.5 * 384 / 3.9, abs=4)


def test_without_x264_the_video_is_mpeg4(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(av, "codecs_available", {"mpeg4"})
    rollout_video(RECORDINGS, tiny_robot(), VIEW, tmp_path / "clip.mp4")
    with av.open(tmp_path / "clip.mp4") as container:
        assert container.streams.video[0].codec_context.name == "mpeg4"
    assert len(frames(tmp_path / "clip.mp4")) == 7 + 2 * 4


def test_the_action_that_led_to_a_frame_is_named_or_shown_as_numbers(tmp_path: Path) -> None:
    first, second = [], []
    for names in (("+x", "-x", "+y"), ("left", "right", "+y"), ("+y", "+y", "-x"), ()):
        one = [recording(60, Outcome.GOAL, steps=1)]
        rollout_video(one, tiny_robot(), VIEW, tmp_path / "clip.mp4", action_names=names)
        for kept, picture in zip((first, second), frames(tmp_path / "clip.mp4"), strict=False):
            kept.append(picture)
    assert (first[1] == first[0]).all()  # no action has been taken yet
    assert (second[1] == second[0]).all()  # both are +y
    for other in second[2:]:
        changed = (np.abs(second[0] - other).max(-1) > 60).nonzero()
        assert len(changed[0]) > 10 and changed[0].min() >= STRIP.start


RATES = ("thrust", "roll_rate", "pitch_rate", "yaw_rate")


def flight(*numbers: float) -> Recording:
    """One step with a continuous action."""
    return replace(recording(60, Outcome.OUT_OF_BOUNDS, steps=1), action=torch.tensor([numbers]))


@pytest.mark.parametrize(
    ("numbers", "names", "width", "columns"),
    [
        (4, RATES, 1000, RATES),
        (4, RATES, 400, ("action",)),
        (4, (), 1000, ("action",)),
        (12, tuple(f"front_left_hip_{number}" for number in range(12)), 800, ("action",)),
        (80, (), 1000, ("action",)),
        (2, ("forward (m/s)", "turn (rad/s)"), 792, ("forward (m/s)", "turn (rad/s)")),
    ],
)
def test_the_numbers_of_an_action_have_names_where_they_fit_and_no_text_touches_the_next(
    numbers: int, names: tuple[str, ...], width: int, columns: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[tuple[str, float, float]] = []

    def text(pen: ImageDraw.ImageDraw, at: tuple[float, float], words: str, **how: Any) -> None:
        drawn.append((words, at[0], pen.textbbox(at, words, how["font"], how["anchor"])[2]))

    monkeypatch.setattr(ImageDraw.ImageDraw, "text", text)
    captions = Captions([flight(*[-1.25] * numbers)], names, 5, width)
    for step in (0, 1):
        drawn.clear()
        captions.write(Image.new("RGB", (width, STRIP.start + 60)), 0, step)
        assert tuple(name for name, *_ in drawn[:-1:2]) == ("episode", "step", *columns, "return", "outcome")
        lefts = [left for _, left, _ in drawn[:-1:2]] + [width]
        for words, left, right in drawn:
            assert right <= next(other for other in lefts if other > left) - 8, words
    assert ("80 numbers" in [words for words, *_ in drawn]) == (numbers == 80)


def test_a_failed_video_leaves_the_previous_file(tmp_path: Path) -> None:
    (tmp_path / "clip.mp4").write_bytes(b"an older clip")
    with pytest.raises(ValueError, match="at least one episode"):
        rollout_video([], tiny_robot(), VIEW, tmp_path / "clip.mp4")
    assert (tmp_path / "clip.mp4").read_bytes() == b"an older clip"
