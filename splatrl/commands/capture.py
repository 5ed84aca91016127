"""``splatrl-capture``: make a scene to train in of a phone video or a folder of photos."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from tqdm import tqdm

from splatrl.capture.fit import FitSettings
from splatrl.capture.marker import MARKER_SIDE, write_marker_page
from splatrl.capture.pipeline import CaptureSettings, capture
from splatrl.capture.resolution import Resolution
from splatrl.capture.scale import Click, Distance
from splatrl.commands.options import Parser, is_numbers, joined, split
from splatrl.device import AUTO, chosen_device, device_line
from splatrl.envs.robot import Robot
from splatrl.scenes.description import scene_folder

INTERRUPTED = 130
SELDOM = 10.0
"""Seconds between the lines of a bar that goes to a file."""


def parser() -> Parser:
    """The parser of the command line."""
    result = Parser(prog="splatrl-capture", description=__doc__)
    result.add_argument(
        "source",
        type=Path,
        nargs="?",
        help="a video, a folder of photos, or a recording: Polycam's raw data, Stray Scanner's, Record3D's, "
        "transforms.json, a COLMAP model",
    )
    result.add_argument(
        "--out",
        type=Path,
        help="folder of the scene; by default the source's name without its ending; garden.spz makes a folder garden "
        "with a small splat",
    )
    result.add_argument("--force", action="store_true", help="go on where a first look says no; replace a scene")
    result.add_argument(
        "--camera-height",
        type=float,
        metavar="M",
        help="of the camera above the floor, on average over the film, metres; above grass, count from its tips",
    )
    result.add_argument(
        "--distance",
        type=distance,
        metavar="IMAGE X Y [IMAGE] X Y M",
        help="two points, each by the number of an image in stages/undistorted and pixels in it (the second in the "
        "same where no other is named), and the metres between them",
    )
    result.add_argument(
        "--marker-side", type=float, default=MARKER_SIDE, metavar="M", help="of a printed marker, metres"
    )
    result.add_argument("--marker", type=Path, metavar="PDF", help="write a page with a marker to print, and stop")
    result.add_argument(
        "--robot-width",
        type=int,
        default=Robot.image_width,
        help=f"of the images that robots will see, pixels; {Robot.image_width} by default",
    )
    result.add_argument(
        "--width", type=int, help="of the images that are fitted, pixels; follows the robots by default"
    )
    result.add_argument("--gaussians", type=int, help="at most; follows the number of pixels by default")
    result.add_argument("--views", type=int, default=FitSettings.views, help="drawn in the fit: more takes longer")
    result.add_argument("--seed", type=int, default=0)
    result.add_argument("--device", default=AUTO, help="of the fit: auto, cpu, cuda or cuda:<number>")
    return result


def distance(text: str) -> Distance:
    """What ``--distance`` says: IMAGE X Y X Y M, or IMAGE X Y IMAGE X Y M.

    Raises:
        argparse.ArgumentTypeError: for anything else.
    """
    try:
        values = [float(word) for word in split(text)]
        if len(values) == 6:  # both in one image
            values.insert(3, values[0])
        if len(values) != 7 or values[0] % 1 != 0 or values[3] % 1 != 0:
            raise ValueError(f"expected IMAGE X Y X Y M or IMAGE X Y IMAGE X Y M, got {text!r}")
        first, second = (Click(int(image), x, y) for image, x, y in (values[0:3], values[3:6]))
        return Distance.between(first, second, values[6])
    except (ValueError, OverflowError) as error:
        raise argparse.ArgumentTypeError(str(error)) from error


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry point of the command."""
    command = parser()
    given = sys.argv[1:] if arguments is None else arguments
    options = command.parse_args(joined(given, {"--distance": 7}, is_numbers))
    if options.marker is not None:
        write_marker_page(options.marker, side=options.marker_side)
        print(f"{options.marker}: print it at its true size, and lay it where the camera sees it")
        return
    if options.source is None:
        command.error("expected a video or a folder of photos, or --marker")
    source = options.source.expanduser()
    folder, splat = scene_folder((options.out or Path(source.stem)).expanduser())
    try:
        device = chosen_device(options.device)
        print(device_line(device))
        with Bars() as bars:
            capture(source, folder, _settings(options, splat, str(device)), bars, bars.say)
    except (ImportError, OSError, ValueError) as error:
        sys.exit(f"splatrl-capture: {error}")
    except KeyboardInterrupt:
        print("\nstopped; the same command continues", file=sys.stderr)
        sys.exit(INTERRUPTED)
    print(f"report in {folder / 'report.html'}\ntrain in it: splatrl-train scene={folder}/")


def _settings(options: argparse.Namespace, splat: str, device: str) -> CaptureSettings:
    fit = FitSettings(views=options.views, seed=options.seed, device=device)
    return CaptureSettings(
        force=options.force,
        seed=options.seed,
        camera_height=options.camera_height,
        distance=options.distance,
        marker=options.marker_side,
        splat=splat,
        fit=fit,
        resolution=Resolution(options.robot_width, width=options.width, gaussians=options.gaussians),
    )


class Bars:
    """A progress bar for each thing that a stage does, with the time left."""

    def __init__(self) -> None:
        self._bar: tqdm[object] | None = None
        self._what = ""

    def __enter__(self) -> "Bars":
        return self

    def __exit__(self, *_: object) -> None:
        self._close()

    def __call__(self, what: str, done: int, total: int) -> None:
        """Show how far a stage is."""
        if self._bar is None or what != self._what:
            self._close()
            often = 0.1 if sys.stderr.isatty() else SELDOM
            self._bar = tqdm(total=total, desc=what, dynamic_ncols=True, leave=False, mininterval=often)
            self._what = what
        self._bar.total = total
        self._bar.update(done - self._bar.n)

    def say(self, line: str) -> None:
        """Print a line above the bars."""
        self._close()
        print(line, flush=True)

    def _close(self) -> None:
        if self._bar is not None:
            self._bar.close()
            self._bar = None


if __name__ == "__main__":
    main()
