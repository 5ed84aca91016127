"""Pictures by which a person judges a capture: photos beside renders, maps, cameras and points."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image, ImageDraw
from torch import Tensor

from splatrl.cameras import Cameras, intrinsics, look_at
from splatrl.capture.area import Area
from splatrl.capture.cuts import takes
from splatrl.capture.photo_files import read_photo
from splatrl.capture.world import Placed
from splatrl.collision.pictures import FREE, SOLID
from splatrl.envs.robot import Robot
from splatrl.evaluation.figure_style import font
from splatrl.evaluation.topdown import DEPTH, footprint, top_down
from splatrl.files import replacing
from splatrl.renderers import NativeRenderer
from splatrl.scenes.gaussians import Gaussians

Floats = NDArray[np.float64]

GOALS = "goals.png"
THUMBNAIL = 320
"""Side of the view from a goal, pixels."""
ROWS = 6
"""Maximum number of photos in a comparison."""
WIDTH = 480
"""Width of a photo in a comparison, pixels."""
BODY = 0.1
"""Metres above and below the robot's height within which solid things are drawn."""
LONG = 2.5
"""Ratio of a place's extent along x to that along y above which its two maps are stacked."""
PATH, BLOCKED, POINTS = "#1f6feb", "#d1242f", "#8a6d3b"
_MOST_POINTS = 20_000


def draw_goals(
    gaussians: Gaussians, goals: Sequence[Sequence[float]], height: float, path: Path, antialiased: bool = True
) -> None:
    """Draw what a robot sees at each goal, side by side and numbered, as PNG.

    Args:
        gaussians: the scene's Gaussians, world frame.
        goals: at least one goal, each x and y in metres and yaw in degrees.
        height: height of the robot's camera, world, metres.
        path: the file to write; ends in .png.
        antialiased: whether to render antialiased; False gives the classic 3DGS image.
    """
    poses = []
    for x, y, yaw in goals:
        turn = np.radians(yaw)
        poses.append(look_at([x, y, height], [x + np.cos(turn), y + np.sin(turn), height]))
    K = intrinsics(np.radians(Robot.fov_deg), THUMBNAIL, THUMBNAIL)
    cameras = Cameras(torch.stack(poses), K, THUMBNAIL, THUMBNAIL)
    page = Image.new("RGB", (len(poses) * (THUMBNAIL + 4) - 4, THUMBNAIL), "white")
    pen = ImageDraw.Draw(page)
    for column, view in enumerate(NativeRenderer(gaussians, antialiased).pixels(cameras).numpy()):
        page.paste(Image.fromarray(view), (column * (THUMBNAIL + 4), 0))
        corner = column * (THUMBNAIL + 4) + 6, 4
        pen.text(corner, str(column + 1), fill="white", font=font(18), stroke_width=2, stroke_fill="black")
    with replacing(path) as stream:
        page.save(stream, "PNG")


def comparison_rows(count: int) -> list[int]:
    """Return which of ``count`` held-out photos a comparison shows, ascending: some from the first to the last."""
    return np.unique(np.linspace(0, count - 1, ROWS).round().astype(int)).tolist() if count else []


def comparison_line(photo: Floats, render: Floats, score: float) -> Image.Image:
    """Draw a photo, the render from the same camera and four times their difference side by side.

    Args:
        photo: [H, W, 3] in [0, 1].
        render: the same shape.
        score: PSNR of the render, dB.
    """
    size = WIDTH, max(1, round(WIDTH * photo.shape[0] / photo.shape[1]))
    line = Image.new("RGB", (3 * size[0] + 8, size[1]), "white")
    for column, values in enumerate((photo, render, np.clip(4 * np.abs(photo - render), 0.0, 1.0))):
        image = Image.fromarray((255 * values + 0.5).astype(np.uint8)).resize(size, Image.Resampling.LANCZOS)
        line.paste(image, (column * (size[0] + 4), 0))
    ImageDraw.Draw(line).text(
        (size[0] + 10, 4), f"{score:.1f} dB", fill="white", font=font(14), stroke_width=2, stroke_fill=0
    )
    return line


def draw_comparison(lines: Sequence[Image.Image], path: Path) -> None:
    """Draw the lines of a comparison below one another, with titles, as PNG.

    Args:
        lines: at least one result of ``comparison_line``, all of one size.
        path: the file to write; ends in .png.
    """
    width, height = lines[0].size
    page = Image.new("RGB", (width, len(lines) * (height + 4) + 20), "white")
    for column, title in enumerate(("held-out photo", "render", "four times the difference")):
        ImageDraw.Draw(page).text((column * (WIDTH + 4) + 4, 2), title, fill="black", font=font(14))
    for number, line in enumerate(lines):
        page.paste(line, (0, 20 + number * (height + 4)))
    with replacing(path) as stream:
        page.save(stream, "PNG")


def draw_moving(photos: Sequence[Path], moving: Tensor, path: Path) -> None:
    """Draw the photos with the most moving pixels, in two columns and with these pixels in red, as PNG.

    Args:
        photos: all photos.
        moving: [N, h, w] bool, pixels of each photo that show moving things.
        path: the file to write; ends in .png.
    """
    shares = moving.flatten(1).float().mean(1)
    rows = shares.argsort(descending=True, stable=True)[: min(ROWS, int((shares > 0).sum()))].sort().values
    size = WIDTH, max(1, round(WIDTH * moving.shape[1] / moving.shape[2]))
    page = Image.new("RGB", (2 * size[0] + 4, -(-len(rows) // 2) * (size[1] + 4) - 4), "white")
    for place, row in enumerate(rows.tolist()):
        image = read_photo(photos[row]).resize(size, Image.Resampling.LANCZOS)
        shade = Image.fromarray(np.uint8(160) * moving[row].numpy()).resize(size, Image.Resampling.NEAREST)
        image.paste(BLOCKED, mask=shade)
        page.paste(image, (place % 2 * (size[0] + 4), place // 2 * (size[1] + 4)))
    with replacing(path) as stream:
        page.save(stream, "PNG")


def draw_map(
    gaussians: Gaussians,
    placed: Placed,
    area: Area,
    free: NDArray[np.bool_],
    path: Path,
    goals: Sequence[Sequence[float]] = (),
    thing: Sequence[float] | None = None,
) -> None:
    """Draw the place from above with the camera's path, and beside it free space and points, as PNG.

    Args:
        gaussians: the scene's Gaussians, world frame.
        placed: cameras and points.
        area: bounds, walkable area and what is solid.
        free: [N] bool, whether the path is free at each camera.
        path: the file to write; ends in .png.
        goals: poses to mark, each x, y and yaw in degrees; the first is drawn largest.
        thing: x, y, z of an object position to mark.
    """
    lower, upper = area.bounds[0][:2], area.bounds[1][:2]
    cut = area.robot_height + 0.3
    ground = top_down(gaussians, lower, upper, cut, depth=cut + DEPTH)  # down to the floor at 0, far below a drone
    solid = footprint(area.occupancy, area.robot_height - BODY, area.robot_height + BODY, ground).numpy()
    cameras, points = (
        placed.reconstruction.camera_to_world[:, :3, 3].numpy(),
        _some(placed.reconstruction.points.numpy()),
    )
    shape = (upper[0] - lower[0]) / (upper[1] - lower[1])
    width = 6.0 * min(1.6, max(0.7, shape))
    stacked = shape > LONG
    size = (12.0, 2.4 + max(1.0, 22.0 / shape)) if stacked else (2 * width + 0.8, 7.4)
    figure = Figure(figsize=size, dpi=110, layout="constrained")
    canvas = FigureCanvasAgg(figure)
    left, right = figure.subplots(*((2, 1) if stacked else (1, 2)), sharex=True, sharey=True)
    left.imshow(ground.image.numpy(), extent=ground.extent)
    left.set_title("from above, with the camera's path")
    colors = np.array([[int(tone[i : i + 2], 16) for i in (1, 3, 5)] for tone in (FREE, SOLID)], np.uint8)
    right.imshow(colors[solid.astype(int)], extent=ground.extent)
    right.scatter(*points[:, :2].T, s=0.3, c=POINTS, linewidths=0, alpha=0.5)
    right.set_title(f"free space (green) at {area.robot_height:.2f} m, and points")
    (x0, y0), (x1, y1) = area.walk
    for axis in (left, right):
        axis.plot(*camera_path(placed)[:, :2].T, color=PATH, linewidth=1.2)
        axis.scatter(*cameras[~free, :2].T, s=14, c=BLOCKED, zorder=3)
        axis.plot([x0, x1, x1, x0, x0], [y0, y0, y1, y1, y0], color="white" if axis is left else "black", ls="--", lw=1)
        for rank, (x, y, yaw) in enumerate(goals):
            ahead = (
                np.array([np.cos(np.radians(yaw)), np.sin(np.radians(yaw))])
                * (0.06 if rank else 0.09)
                * (x1 - x0 + y1 - y0)
            )
            axis.annotate(
                "",
                (x + ahead[0], y + ahead[1]),
                (x, y),
                arrowprops={"color": "#bf3989", "width": 2 - 1.2 * (rank > 0), "headwidth": 8 - 3 * (rank > 0)},
            )
        if thing is not None:
            axis.plot(*thing[:2], marker="*", color="#e3b341", markeredgecolor="black", markersize=12)
        axis.set(xlim=ground.extent[:2], ylim=ground.extent[2:], xlabel="x (m)", ylabel="y (m)")
        axis.label_outer()
    with replacing(path) as stream:
        canvas.print_png(stream)


def draw_cameras(placed: Placed, area: Area, path: Path) -> None:
    """Draw cameras and points from above and from the side, as PNG."""
    reconstruction = placed.reconstruction
    points, colors = (_some(values.numpy()) for values in (reconstruction.points, reconstruction.colors))
    poses = reconstruction.camera_to_world.numpy()
    (x0, y0, z0), (x1, y1, z1) = area.bounds
    tall = max((y1 - y0) + (z1 - z0), 0.3 * (x1 - x0))
    figure = Figure(figsize=(8.0, min(16.0, 1.6 + 7.6 * tall / (x1 - x0))), dpi=110, layout="constrained")
    canvas = FigureCanvasAgg(figure)
    above, beside = figure.subplots(2, 1, sharex=True, height_ratios=[y1 - y0, z1 - z0])
    for axis, other, (low, high) in ((above, 1, (y0, y1)), (beside, 2, (min(z0, -0.2), z1))):
        axis.scatter(points[:, 0], points[:, other], s=1.0, c=colors / 255.0, linewidths=0)
        axis.plot(*camera_path(placed)[:, [0, other]].T, color=PATH, linewidth=1.2)
        some = poses[:: max(1, len(poses) // 40)]
        axis.quiver(
            some[:, 0, 3], some[:, other, 3], some[:, 0, 2], some[:, other, 2], color=PATH, width=0.002, scale=30
        )
        axis.set(xlim=(x0, x1), ylim=(low, high), aspect="equal", ylabel=f"{'xyz'[other]} (m)")
    beside.axhline(0.0, color=BLOCKED, linewidth=0.8)
    beside.set_xlabel("x (m)")
    with replacing(path) as stream:
        canvas.print_png(stream)


def camera_path(placed: Placed) -> Floats:
    """Return the camera's positions [N + C, 3], world, with a row of NaN where each of C further takes begins."""
    found = placed.reconstruction
    places: Floats = found.camera_to_world[:, :3, 3].numpy()
    if found.seconds is None:
        return places
    begins = np.flatnonzero(np.diff(takes(found.seconds.numpy(), found.cuts))) + 1
    return np.insert(places, begins, np.nan, axis=0)


def _some(values: NDArray[np.float64]) -> NDArray[np.float64]:
    return values[:: max(1, -(-len(values) // _MOST_POINTS))]
