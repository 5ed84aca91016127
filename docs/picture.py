"""Makes ``docs/backyard.jpg``: the yard as a person and as the robot sees it, and a run's success map from above.

Usage: python docs/picture.py <run folder>
"""

import math
import sys
from pathlib import Path

from PIL import Image

from splatrl import Cameras, backyard
from splatrl.cameras import intrinsics, look_at
from splatrl.renderers import NativeRenderer

HEIGHT, GAP = 560, 8


def main() -> None:
    """Render the views, and put the run's success map beside them."""
    renderer = NativeRenderer(backyard().gaussians)

    def view(
        position: tuple[float, ...], target: tuple[float, ...], fov_deg: float, width: int, height: int
    ) -> Image.Image:
        K = intrinsics(math.radians(fov_deg), width, height)
        return Image.fromarray(renderer.pixels(Cameras(look_at(position, target)[None], K, width, height))[0].numpy())

    person = view((1.9, -2.1, 1.15), (-0.2, 0.6, 0.25), 70, 900, HEIGHT)
    side = (HEIGHT - GAP) // 2
    robot = view((-0.6, -0.4, 0.4), (1.25, 0.4, 0.4), 90, 64, 64).resize((side, side), Image.Resampling.NEAREST)
    above = Image.open(Path(sys.argv[1]) / "success_map.png").convert("RGB")
    above.thumbnail((1000, HEIGHT), Image.Resampling.LANCZOS)
    egg = view((0.6, 0.4, 0.4), (1.6, 0.4, 0.4), 90, 64, 64).resize((side, side), Image.Resampling.NEAREST)
    page = Image.new("RGB", (person.width + side + above.width + 2 * GAP, HEIGHT), "white")
    page.paste(person, (0, 0))
    page.paste(robot, (person.width + GAP, 0))
    page.paste(egg, (person.width + GAP, HEIGHT - side))
    page.paste(above, (person.width + side + 2 * GAP, (HEIGHT - above.height) // 2))
    page.save(Path(__file__).with_name("backyard.jpg"), quality=90)


if __name__ == "__main__":
    main()
