"""Measures the cost per frame of weather and of varied appearance, compared with that of drawing the frame.

    python benchmarks/weather.py            # half a minute
    python benchmarks/weather.py --batch 16 --size 128

Views of the backyard are drawn, drawn with depth, put into weather, and varied; all calls take turns.
"""

import argparse
from collections.abc import Callable
from functools import partial
from statistics import median

import torch
from scenes import YARD
from tensordict import TensorDict
from timing import take_turns

from splatrl import backyard
from splatrl.envs.drawing import DepthDrawing, SceneDrawing, Shot, View
from splatrl.envs.transforms import Appearance, Weather
from splatrl.renderers import NativeRenderer

NAMES = ("fog", "dusk", "sun", "rain", "snow", "wet")


def put(weather: Weather, shown: View, count: int) -> object:
    """Put images into weather."""
    return weather(TensorDict({"pixels": shown.pixels, **shown.shown}, [count]))


def vary(appearance: Appearance, shown: View, count: int) -> object:
    """Vary the appearance of images."""
    return appearance(TensorDict({"pixels": shown.pixels}, [count]))


def main() -> None:
    """Measure in turns, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--batch", type=int, default=64)
    parser.add_argument("--size", type=int, default=64)
    parser.add_argument("--rounds", type=int, default=15)
    options = parser.parse_args()
    torch.set_num_threads(1)
    views = YARD.views(options.batch, options.size, options.size)
    plain = SceneDrawing(NativeRenderer(backyard(), threads=1))
    deep = DepthDrawing(plain, options.size, options.size)
    shown = deep.draw(Shot(views))
    calls: dict[str, Callable[[], object]] = {
        "drawn": partial(plain.draw, Shot(views)),
        "drawn with depth": partial(deep.draw, Shot(views)),
    }
    for name in (*NAMES, "all weather"):
        off = {other: 0.0 for other in NAMES if name in NAMES and other != name}
        calls[f"put into {name}"] = partial(put, Weather(**off), shown, options.batch)
    calls["varied (appearance=varied)"] = partial(vary, Appearance(), shown, options.batch)
    seconds = take_turns(calls, options.rounds)
    print(f"| {options.size} × {options.size}, {options.batch} views, one core | ms per frame |")
    print("|---|---|")
    for name, times in seconds.items():
        print(f"| {name} | {1000 * median(times) / options.batch:.3f} |")


if __name__ == "__main__":
    main()
