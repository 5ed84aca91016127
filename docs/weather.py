"""Makes ``docs/weather.jpg``: one view in each kind of weather, as a person and as a robot sees it.

Usage: python docs/weather.py [--out docs/weather.jpg]
"""

import argparse
import math
from pathlib import Path

import torch
from PIL import Image, ImageDraw
from tensordict import TensorDict

from splatrl import Cameras, yards
from splatrl.cameras import intrinsics, look_at
from splatrl.envs.drawing import DepthDrawing, SceneDrawing, Shot
from splatrl.envs.transforms import Weather
from splatrl.envs.transforms.weather import CLEAR, FIELDS
from splatrl.renderers import NativeRenderer

WIDTH, HEIGHT, ROBOT, GAP, COLUMNS = 390, 260, 64, 6, 4
KINDS: dict[str, dict[str, float]] = {
    "clear": {},
    "fog": {"fog": 0.3},
    "dusk": {"dusk": 0.8},
    "warm sun": {"red": 1.2, "green": 1.03, "blue": 0.8},
    "rain": {"rain": 0.9, "wind": 0.15},
    "snow": {"snow": 0.9, "wind": -0.2},
    "wet lens": {"wet": 0.9, "lens_row": 0.2, "lens_column": 0.6},
    "rain at dusk": {"rain": 1.0, "dusk": 0.65, "wet": 0.5, "fog": 0.06, "wind": -0.3, "lens_row": 0.6},
}
SEED = 10


def views(width: int, height: int, fov_deg: float, kinds: list[dict[str, float]]) -> list[Image.Image]:
    """Draw the same view in each kind of weather; square images are the robot's view."""
    (one,) = yards([SEED])
    (x0, y0, _), (x1, y1, _) = one.scene.bounds
    corner = (x0 + 0.5, y0 + 0.5, 1.5)
    pose = look_at(torch.tensor(corner), torch.tensor([0.4 * x1, 0.4 * y1, 0.5]))
    if width == height:
        x, y, yaw_deg = one.goal
        yaw = math.radians(yaw_deg)
        eye = torch.tensor([x - 0.8 * math.cos(yaw), y - 0.8 * math.sin(yaw), 0.4])
        pose = look_at(eye, torch.tensor([*one.egg]))
    cameras = Cameras(pose.expand(len(kinds), 4, 4), intrinsics(math.radians(fov_deg), width, height), width, height)
    view = DepthDrawing(SceneDrawing(NativeRenderer(one.scene)), height, width).draw(Shot(cameras))
    weather = torch.tensor(
        [[kind.get(name, clear) for name, clear in zip(FIELDS, CLEAR, strict=True)] for kind in kinds]
    )
    seen = TensorDict({"pixels": view.pixels, "weather": weather, **view.shown}, [len(kinds)])
    return [Image.fromarray(image.numpy()) for image in Weather(seed=5)(seen)["pixels"]]


def main() -> None:
    """Draw each kind of weather, with the robot's view in a corner."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path(__file__).with_name("weather.jpg"))
    options = parser.parse_args()
    kinds = list(KINDS.values())
    large, small = views(WIDTH, HEIGHT, 75, kinds), views(ROBOT, ROBOT, 90, kinds)
    rows = math.ceil(len(kinds) / COLUMNS)
    page = Image.new("RGB", (COLUMNS * (WIDTH + GAP) - GAP, rows * (HEIGHT + GAP) - GAP), "white")
    for index, (name, person, robot) in enumerate(zip(KINDS, large, small, strict=True)):
        person.paste(
            robot.resize((2 * ROBOT, 2 * ROBOT), Image.Resampling.NEAREST), (WIDTH - 2 * ROBOT, HEIGHT - 2 * ROBOT)
        )
        draw = ImageDraw.Draw(person)
        draw.rectangle((0, 0, 10 + draw.textlength(name, font_size=16), 24), fill="black")
        draw.text((5, 3), name, fill="white", font_size=16)
        page.paste(person, (index % COLUMNS * (WIDTH + GAP), index // COLUMNS * (HEIGHT + GAP)))
    page.save(options.out, quality=82)


if __name__ == "__main__":
    main()
