"""Videos of episodes: the robot's view, optionally the robot itself from outside, and a map of where it is."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont
from torch import Tensor

from splatrl.cameras import Cameras
from splatrl.envs.drawing import Drawing, Shot
from splatrl.envs.robot import Robot
from splatrl.envs.tasks import Outcome
from splatrl.evaluation.chart import COLORS, Chart, font
from splatrl.evaluation.figure_style import INK
from splatrl.evaluation.recording import Recording
from splatrl.evaluation.topdown import MapView
from splatrl.files import replacing
from splatrl.values import tenths
from splatrl.waits import Bar

PANEL, WIDEST, GAP, STRIP = 384, 512, 8, 60
"""Height of the panels, maximum width of the map, space around the panels and height of the caption, pixels."""
HOLD = 0.7
"""Extra time for which the last frame of an episode is held, seconds."""
X264 = {"crf": "18", "preset": "veryfast", "x264-params": "mbtree=0"}
"""Encoder options; macroblock-tree rate control is off, since with it x264's output differs from run to run."""
BATCH = 8
"""Number of large views rendered at a time; bounds memory."""


def rollout_video(
    recordings: Sequence[Recording],
    robot: Robot,
    view: MapView,
    path: Path,
    drawing: Drawing | None = None,
    action_names: Sequence[str] = (),
    fps: int = 6,
    outside: Callable[[Recording], Cameras] | None = None,
    goals: int | None = None,
) -> None:
    """Write episodes to an mp4, one after another: the ego view beside a map with the robot and its trail.

    The image of an image goal is shown in a corner of the ego view.

    Args:
        recordings: the episodes.
        robot: body and camera.
        view: background and marks of the map.
        path: the video file.
        drawing: draws the ego view large, with the policy's own pixels in its corner; None enlarges those pixels.
        action_names: names of the actions, by index; empty for continuous actions.
        fps: steps per second of video.
        outside: gives cameras that look at the robot of a recording, one per step, for a third panel; needs
            ``drawing``.
        goals: number of goals needed for success, if episodes can have several.

    Raises:
        ValueError: if there are no recordings.
    """
    if not recordings:
        raise ValueError("recordings: expected at least one episode, got none")
    chart = Chart(view, robot.body, (WIDEST, PANEL))
    frames = _frames(recordings, robot, chart, drawing, action_names, fps, outside, goals)
    total = sum(len(recording.action) + 1 + _held(fps) for recording in recordings)
    encode(Bar(frames, "video", total, leave=False, unit="frame"), path, fps)


def _held(fps: int) -> int:
    """Return for how many extra frames the last frame of an episode is held."""
    return round(HOLD * fps)


def _frames(
    recordings: Sequence[Recording],
    robot: Robot,
    chart: Chart,
    drawing: Drawing | None,
    action_names: Sequence[str],
    fps: int,
    outside: Callable[[Recording], Cameras] | None,
    goals: int | None,
) -> Iterator[Image.Image]:
    for number, recording in enumerate(recordings, 1):
        last = len(recording.action)
        panels = [_views(recording, robot, drawing)]
        if outside is not None and drawing is not None:
            panels.append(map(Image.fromarray, _drawn(recording, drawing, outside(recording))))
        for step, views in enumerate(zip(*panels, strict=True)):
            drawn = [*views, chart.draw(recording, step)]
            width = sum(panel.width + GAP for panel in drawn) + GAP
            page = Image.new("RGB", (width + width % 2, PANEL + 2 * GAP + STRIP), INK)
            left = GAP
            for panel in drawn:
                page.paste(panel, (left, GAP + (PANEL - panel.height) // 2))
                left += panel.width + GAP
            facts = [
                ("episode", f"{number} of {len(recordings)}"),
                ("step", str(step)),
                ("action", _action(recording.action[step - 1], action_names) if step else "none yet"),
                ("return", tenths(float(recording.episode_return[step]))),
            ]
            if recording.goals is not None:
                facts.append(("goals", f"{int(recording.goals[step])} of {goals}"))
            _caption(page, facts, recording.outcome if step == last else Outcome.RUNNING)
            for _ in range(1 + _held(fps) * (step == last)):
                yield page


def _views(recording: Recording, robot: Robot, drawing: Drawing | None) -> Iterator[Image.Image]:
    """Yield the ego view at each step, ``PANEL`` pixels high."""
    large = replace(robot, image_height=PANEL, image_width=round(PANEL * robot.image_width / robot.image_height))
    size, seen = (large.image_width, PANEL), recording.pixels.numpy()
    views = seen if drawing is None else _drawn(recording, drawing, large.cameras(recording.body_to_world))
    for own, view in zip(seen, views, strict=True):
        image = Image.fromarray(view).resize(size, Image.Resampling.NEAREST)
        if drawing is not None:
            _inset(image, own, size[0] - size[0] // 3 - 6)
        if recording.goal_image is not None:
            _inset(image, recording.goal_image.numpy(), 6, "goal")
        yield image


def _inset(image: Image.Image, pixels: NDArray[np.uint8], left: int, name: str = "") -> None:
    """Paste a picture, a third of the view's size, at the view's bottom, ``left`` pixels from its edge, with a name."""
    small = Image.fromarray(pixels).resize((image.width // 3, PANEL // 3), Image.Resampling.NEAREST)
    top = PANEL - small.height - 6
    image.paste("white", (left - 2, top - 2, left + small.width + 2, PANEL - 4))
    image.paste(small, (left, top))
    ImageDraw.Draw(image).text((left, top - 6), name, "white", font(16), "ls", stroke_width=2, stroke_fill=INK)


def _drawn(recording: Recording, drawing: Drawing, cameras: Cameras) -> Iterator[NDArray[np.uint8]]:
    """Yield the view of each camera, one per step: [H, W, 3] uint8."""
    for rows in torch.arange(len(cameras)).split(BATCH):
        memory = {key: value[rows] for key, value in recording.memory.items()}
        parts = None if recording.parts is None else recording.parts.rows(rows)
        yield from drawing.draw(Shot(cameras[rows], memory, parts)).pixels.cpu().numpy()


def _action(action: Tensor, names: Sequence[str]) -> str:
    if names:
        return names[int(action)]
    return " ".join(f"{round(value, 2) + 0.0:.2f}" for value in action.reshape(-1).tolist())


def _caption(page: Image.Image, facts: list[tuple[str, str]], outcome: Outcome) -> None:
    """Write the facts below the panels, and the outcome as a badge."""
    pen = ImageDraw.Draw(page)
    column, top = page.width / (len(facts) + 1), page.height - STRIP + 4
    for number, (name, value) in enumerate([*facts, ("outcome", "")]):
        left = number * column + 2 * GAP
        pen.text((left, top), name, fill="#aaaaaa", font=font(12), anchor="lt")
        pen.text((left, top + 36), value, fill="white", font=fitting(value, column - GAP), anchor="ls")
    if outcome is Outcome.RUNNING:
        pen.text((left, top + 36), "running", fill="white", font=font(18), anchor="ls")
        return
    words = outcome.name.replace("_", " ").lower()
    wide = pen.textlength(words, font=font(16))
    pen.rounded_rectangle((left - 6, top + 17, left + wide + 6, top + 44), 5, fill=COLORS[outcome])
    pen.text((left, top + 30), words, fill="white", font=font(16), anchor="lm")


def fitting(words: str, width: float) -> ImageFont.FreeTypeFont:
    """Return the largest font, from 18 down to 8 pixels, in which words fit a width in pixels."""
    size = 18
    while size > 8 and font(size).getlength(words) > width:
        size -= 1
    return font(size)


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
