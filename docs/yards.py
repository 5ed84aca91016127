"""Makes ``docs/yards.jpg``: generated yards, each at eye level and from above.

Usage: python docs/yards.py [--seeds 0 1 2 …] [--out docs/yards.jpg]
"""

import argparse
import math
from pathlib import Path

import torch
from PIL import Image

from splatrl import Cameras, yards
from splatrl.cameras import intrinsics, look_at
from splatrl.renderers import NativeRenderer
from splatrl.scenes.yards import Yard

WIDTH, HEIGHT, GAP = 336, 216, 6
COLUMNS = 4
EYES = 1.6
"""Height of a person's eyes, metres."""


def picture(one: Yard) -> Image.Image:
    """Draw a yard from the corner with the widest view, and from above."""
    renderer = NativeRenderer(one.scene)
    (x0, y0, _), (x1, y1, _) = one.scene.bounds
    middle = torch.tensor([(x0 + x1) / 2, (y0 + y1) / 2, 0.0])
    corners = torch.tensor([(x, y, EYES) for x in (x0 + 0.45, x1 - 0.45) for y in (y0 + 0.45, y1 - 0.45)])
    poses = look_at(corners, 0.5 * middle + torch.tensor([0.0, 0.0, 0.45]))
    small = renderer.render(Cameras(poses, intrinsics(math.radians(75), 48, 32), 48, 32))
    near = small.depth.flatten(1).quantile(0.1, dim=1)
    person = Cameras(poses[near.argmax()][None], intrinsics(math.radians(75), WIDTH, HEIGHT), WIDTH, HEIGHT)
    high = middle + torch.tensor([0.0, -0.01, 0.95 * max(x1 - x0, y1 - y0)])
    above = Cameras(look_at(high, middle)[None], intrinsics(math.radians(64), HEIGHT, HEIGHT), HEIGHT, HEIGHT)
    page = Image.new("RGB", (WIDTH + HEIGHT, HEIGHT))
    page.paste(Image.fromarray(renderer.pixels(person)[0].numpy()), (0, 0))
    page.paste(Image.fromarray(renderer.pixels(above)[0].numpy()), (WIDTH, 0))
    return page


def main() -> None:
    """Draw the yards row by row."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, nargs="+", default=list(range(16)))
    parser.add_argument("--out", type=Path, default=Path(__file__).with_name("yards.jpg"))
    options = parser.parse_args()
    pictures = [picture(one) for one in yards(options.seeds, workers=2)]
    rows = math.ceil(len(pictures) / COLUMNS)
    wide, high = pictures[0].width + GAP, pictures[0].height + GAP
    page = Image.new("RGB", (COLUMNS * wide - GAP, rows * high - GAP), "white")
    for index, one in enumerate(pictures):
        page.paste(one, (index % COLUMNS * wide, index // COLUMNS * high))
    page.save(options.out, quality=78)


if __name__ == "__main__":
    main()
