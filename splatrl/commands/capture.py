"""``splatrl-capture``: turn a phone video or a folder of photos into a scene to train in."""

import argparse
import shlex
import sys
from contextlib import suppress
from importlib import import_module
from pathlib import Path

from splatrl.capture.fitting.fit import FitSettings
from splatrl.capture.marker import MARKER_SIDE, write_marker_page
from splatrl.capture.pipeline import capture
from splatrl.capture.resolution import Resolution
from splatrl.capture.settings import CaptureSettings
from splatrl.commands.entries import USERS
from splatrl.commands.entries import capture as main
from splatrl.commands.stopping import stoppable
from splatrl.device import chosen_device, device_line
from splatrl.envs.robot import Robot
from splatrl.files import expanded
from splatrl.scenes.description import scene_folder
from splatrl.waits import Bar


def run(options: argparse.Namespace) -> None:
    """Capture a scene, or write a printable marker page."""
    side = MARKER_SIDE if options.marker_side is None else options.marker_side
    try:
        if options.marker is not None:
            write_marker_page(options.marker, side=side)
            print(f"{options.marker}: print it at actual size (100 %) and place it where the camera will see it")
            return
        source = expanded(options.source)
        folder, splat = scene_folder(expanded(options.out or _beside(source)))
        with suppress(ImportError):  # the capture says how to install the extra
            import_module("pycolmap")  # its own handler of SIGTERM, which prints a stack trace, must come first
        device = chosen_device(options.device)
        print(device_line(device))
        with stoppable("run the same command again to continue"), Bars() as bars:
            capture(source, folder, _settings(options, side, splat, str(device)), bars, bars.say)
    except USERS as error:
        sys.exit(f"splatrl-capture: {error}")
    print(f"report: {folder / 'report.html'}\ntrain in it: splatrl-train {shlex.quote(f'scene={folder}/')}")


def _beside(source: Path) -> Path:
    """Return a folder in the working directory named after the source, but never the source itself.

    In the source folder the pictures that a capture writes would be mistaken for photos.
    """
    named = Path(source.resolve().name if source.is_dir() else source.resolve().stem)
    return named.with_name(f"{named.name}-scene") if named.resolve() == source.resolve() else named


def _settings(options: argparse.Namespace, side: float, splat: str, device: str) -> CaptureSettings:
    views = FitSettings.views if options.views is None else options.views
    across = Robot.image_width if options.robot_width is None else options.robot_width
    return CaptureSettings(
        force=options.force,
        seed=options.seed,
        camera_height=options.camera_height,
        distance=options.distance,
        marker=side,
        splat=splat,
        still=options.still,
        fit=FitSettings(views=views, seed=options.seed, device=device),
        resolution=Resolution(across, width=options.width, gaussians=options.gaussians),
    )


class Bars:
    """Progress bars with the time left, one for each activity of a stage."""

    def __init__(self) -> None:
        self._bar: Bar | None = None
        self._what = ""

    def __enter__(self) -> "Bars":
        return self

    def __exit__(self, *_: object) -> None:
        self._close()

    def __call__(self, what: str, done: int, total: int) -> None:
        """Show the progress of one activity of a stage."""
        if self._bar is None or what != self._what:
            self._close()
            self._bar = Bar(total=total, desc=what, leave=False)
            self._what = what
        self._bar.total = total
        self._bar.update(done - self._bar.n)

    def say(self, line: str) -> None:
        """Close the current bar and print a line."""
        self._close()
        print(line, flush=True)

    def _close(self) -> None:
        if self._bar is not None:
            self._bar.close()
            self._bar = None


if __name__ == "__main__":
    main()
