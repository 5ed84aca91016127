"""Makes ``docs/backyard.webp``, the animation in the README: what the policy of a run sees, and where it is.

Usage: python docs/moving.py <run folder>
"""

import sys
from pathlib import Path

import av
from PIL import Image

WIDTH, PAUSE, MOST, QUALITY = 600, 160, 160, 55
"""Width in pixels, milliseconds per frame, maximum number of frames, and WebP quality."""


def main() -> None:
    """Turn the run's video into an animated WebP."""
    images = []
    with av.open(str(Path(sys.argv[1]) / "rollouts.mp4")) as container:
        for frame in container.decode(video=0):
            image = frame.to_image()
            images.append(image.resize((WIDTH, round(WIDTH * image.height / image.width)), Image.Resampling.LANCZOS))
    del images[MOST:]
    path = Path(__file__).with_name("backyard.webp")
    images[0].save(path, save_all=True, append_images=images[1:], duration=PAUSE, quality=QUALITY, method=4, loop=0)
    print(f"{path}: {len(images)} frames, {path.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
