"""Videos of episodes: the robot's view, optionally the robot itself from outside, and a map of where it is."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from splatrl.cameras import Cameras
from splatrl.envs.drawing import Drawing, Shot
from splatrl.envs.robot import Robot
from splatrl.evaluation.captions import STRIP, Captions
from splatrl.evaluation.chart import Chart
from splatrl.evaluation.encoding import encode
from splatrl.evaluation.figure_style import INK, font
from splatrl.evaluation.recording import Recording
from splatrl.evaluation.topdown import MapView
from splatrl.waits import Bar

PANEL, WIDEST, GAP = 384, 512, 8
"""Height of the panels, maximum width of the map and space around the panels, pixels."""
HOLD = 0.7
"""Extra time for which the last frame of an episode is held, seconds."""
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
        action_names: names of discrete actions, by index, or of the numbers of a continuous one; empty for numbers
            without names.
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
    captions: Captions | None = None
    for number, recording in enumerate(recordings):
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
            captions = captions or Captions(recordings, action_names, goals, page.width)
            captions.write(page, number, step)
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
