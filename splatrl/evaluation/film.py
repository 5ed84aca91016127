"""Shows what a policy would do in an unlabelled film: its frames beside the policy's view and action probabilities."""

import csv
import io
from collections.abc import Callable, Iterator, Sequence
from itertools import chain
from pathlib import Path

from PIL import Image, ImageDraw
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from splatrl.evaluation.clip_files import film_images
from splatrl.evaluation.clips import predictions
from splatrl.evaluation.encoding import encode
from splatrl.evaluation.figure_style import font
from splatrl.evaluation.policy_camera import Eye
from splatrl.evaluation.rollouts import acting
from splatrl.files import replacing
from splatrl.images import open_video, video_track

HEIGHT = 360
"""Height of the film's frame on the page and of the panel beside it, pixels."""
PANEL = 220
"""Width of the panel with the policy's view and its actions, pixels."""
VIEW, BAR = 140, 26
PHOTOS_A_SECOND = 10
FASTEST = 120


def draw_film(
    policy: TensorDictModuleBase,
    action_names: Sequence[str],
    film: Path,
    eye: Eye,
    output: Path,
    start: TensorDictBase | None = None,
    progress: Callable[[int], object] = lambda frames: None,
) -> list[Path]:
    """Show a film to a policy, and write its actions in each frame as a video and as a table.

    Args:
        policy: reads ``pixels`` and whatever else its ``in_keys`` name, writes ``logits``.
        action_names: names of the task's actions, by index.
        film: a video, or a folder of photos in the order of the numbers in their names.
        eye: the camera as which the policy sees the film.
        output: path of both files without their suffix; its folder exists.
        start: batch of [1] with whatever else the policy reads at the start of an episode.
        progress: called with the number of frames just shown.

    Returns:
        The video (mp4) and the table (CSV: ``frame,action`` and the probability of each action), written atomically.

    Raises:
        ValueError: for a film that cannot be read or has no frames, or a policy with other actions.
    """
    if not film.exists():
        raise ValueError(f"{film}: expected a video or a folder of photos, found none")
    table = io.StringIO(newline="")
    writer = csv.writer(table)
    writer.writerow(["frame", "action", *action_names])

    def pages() -> Iterator[Image.Image]:
        shown = predictions(policy, action_names, film_images(film), eye, start)
        for number, (image, view, chances) in enumerate(shown):
            values = [round(float(chance), 4) for chance in chances]
            writer.writerow([number, action_names[int(chances.argmax())], *values])
            yield _page(image, view, values, action_names)
            progress(1)

    with acting(sampled=False, seed=0):
        drawn = pages()
        first = next(drawn, None)
        if first is None:
            raise ValueError(f"{film}: expected at least one frame, got none")
        same = (page if page.size == first.size else page.resize(first.size) for page in chain([first], drawn))
        encode(same, video := output.with_name(f"{output.name}.mp4"), _speed(film))
    with replacing(rows := output.with_name(f"{output.name}.csv")) as stream:
        stream.write(table.getvalue().encode())
    return [video, rows]


def _speed(film: Path) -> int:
    """Return the frame rate of a film, between 1 and ``FASTEST`` frames per second."""
    if film.is_dir():
        return PHOTOS_A_SECOND
    with open_video(film) as container:
        rate = video_track(container).average_rate
    return min(max(1, round(float(rate or PHOTOS_A_SECOND))), FASTEST)


def _page(image: Image.Image, view: Tensor, chances: Sequence[float], names: Sequence[str]) -> Image.Image:
    """Draw a frame beside the policy's view and the action probabilities, the most probable action highlighted."""
    wide = 2 * round(HEIGHT * image.width / image.height / 2)
    page = Image.new("RGB", (wide + PANEL, HEIGHT), "#202020")
    page.paste(image.resize((wide, HEIGHT)), (0, 0))
    small = Image.fromarray(view.numpy())
    scale = min((PANEL - 20) / small.width, VIEW / small.height)
    shown = small.resize((round(small.width * scale), round(small.height * scale)), Image.Resampling.NEAREST)
    page.paste(shown, (wide + (PANEL - shown.width) // 2, 10))
    pen, top = ImageDraw.Draw(page), VIEW + 24
    each = min(BAR, (HEIGHT - top - 8) / len(names))
    for row, (name, chance) in enumerate(zip(names, chances, strict=True)):
        y, best = top + row * each, chance == max(chances)
        bar = (wide + 10, y, wide + 10 + round((PANEL - 20) * chance), y + each - 4)
        pen.rectangle(bar, fill="#2a9d8f" if best else "#465a5a")
        place, color = (wide + 16, y + (each - 4) / 2), "white" if best else "#bbbbbb"
        pen.text(place, name, fill=color, font=font(13, name), anchor="lm")
    return page
