"""Measures how long a capture takes from a phone video to a scene to train in, and how far it is from the truth.

    python benchmarks/capture.py                    # films 60 s at 1080p in the backyard, then captures the film
    python benchmarks/capture.py --yard 3           # the same in a generated yard
    python benchmarks/capture.py --people 2         # two people walk through the place during the film
    python benchmarks/capture.py --along 1          # somebody walks ahead of the camera through the whole film
    python benchmarks/capture.py kitchen_m.mp4      # any video with ground truth in a .npz beside it

The truth only serves to judge the capture, except for the one length that a person would measure: the height of the
camera above the floor. Prints the wall-clock and CPU seconds of every stage, the camera errors after alignment by the
closest similarity (ATE), the errors of up and scale, and the quality of held-out images. If it made the film itself, it
also compares what the cameras see in the capture with the same place without people. ``--keep FOLDER`` keeps film and
scene, and a second call continues there.
"""

import argparse
import os
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

import av
import numpy as np
import torch
from capture_figure import Likeness, draw
from machine import measured_machine
from numpy.typing import NDArray
from passers_by import PassersBy
from PIL import Image
from record import RESULTS, print_markdown, today, write_json
from tqdm import tqdm

import splatrl
from splatrl.cameras import Cameras
from splatrl.capture.check import colour_corrected, psnr, ssim
from splatrl.capture.fitting.fit import FitSettings, held_out
from splatrl.capture.jerks import camera_leaps, jerks
from splatrl.capture.pipeline import build_scene, reconstruct
from splatrl.capture.settings import CaptureSettings
from splatrl.capture.truth import Deviation, Truth, deviation, read_truth, true_poses
from splatrl.capture.world import Placed
from splatrl.collision import Occupancy
from splatrl.commands.capture import Bars
from splatrl.evaluation.phone_video import Phone, phone_video
from splatrl.evaluation.phone_walk import Stroll, phone_walk
from splatrl.renderers import NativeRenderer
from splatrl.scenes import Gaussians, Scene, read_gaussians

Floats = NDArray[np.float64]

FILM = "walk.mp4"
INSIDE, ABOVE = 1.2, 0.6
"""Distance of the walk from a yard's bounds, and default height of the camera, a little above the robots; metres."""
TOLERANCE = 0.5
"""Tolerance of the level of detail in the film, pixels."""


@dataclass(frozen=True)
class Lap:
    """Wall-clock seconds of one stage, and its CPU seconds over all cores."""

    stage: str
    wall: float
    cpu: float


@dataclass(frozen=True)
class Result:
    """A capture compared with its ground truth."""

    video: str
    seconds: float
    width: int
    height: int
    images: int
    posed: int
    points: int
    gaussians: int
    laps: list[Lap]
    wall: float
    cpu: float
    ate_percent: float
    ate_metres: float
    turn_deg: float
    up_deg: float
    scale_percent: float
    scale_from: str
    focal_percent: float
    jerks: float
    fit_width: int
    psnr: float
    ssim: float
    psnr_corrected: float
    empty: float | None
    empty_worst: float | None
    path_free: float
    floating: int
    solid: int


@dataclass
class Stopwatch:
    """Times the stages of a capture, each of which ends with a line of ``say``, and the parts that report progress."""

    bars: Bars
    laps: list[Lap] = field(default_factory=list)
    parts: dict[str, float] = field(default_factory=dict)
    _began: tuple[float, float] = field(default_factory=lambda: _clock())
    _part: tuple[str, float] = ("", 0.0)

    def __call__(self, what: str, done: int, total: int) -> None:
        """Receive the progress of a part of a stage."""
        now = time.perf_counter()
        if self._part[0] == what:
            self.parts[what] = self.parts.get(what, 0.0) + now - self._part[1]
        self._part = (what, now)
        self.bars(what, done, total)

    def say(self, line: str) -> None:
        """Receive the line that ends a stage."""
        wall, cpu = _clock()
        self.laps.append(Lap(line.split()[0], wall - self._began[0], cpu - self._began[1]))
        self.bars.say(line)
        self._began = _clock()


def _clock() -> tuple[float, float]:
    """Return wall-clock seconds, and the CPU seconds of this process and of the subprocesses that it has waited for."""
    return time.perf_counter(), sum(os.times()[:4])


def place_of(options: argparse.Namespace) -> Scene:
    """Return the scene to film."""
    return splatrl.backyard() if options.yard is None else splatrl.yard(options.yard)


def add_film_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that ``filmed`` reads, but for ``yard``."""
    parser.add_argument("--seconds", type=float, default=60.0, help="length of the film, seconds")
    parser.add_argument("--size", type=int, nargs=2, default=(1920, 1080), help="width and height of the film, pixels")
    parser.add_argument("--height", type=float, default=ABOVE, help="height of the camera in the film, metres")
    parser.add_argument("--turn", type=float, default=Stroll.turn, help="seconds per full turn of the view")
    parser.add_argument("--people", type=int, default=0, help="number of people who walk through the film")
    parser.add_argument("--along", type=int, default=0, help="number of people who walk ahead of the camera")
    parser.add_argument("--seed", type=int, default=0, help="seed of the walk and of all random sampling")


def filmed(path: Path, options: argparse.Namespace) -> Path:
    """Film a walk through a yard with a simulated phone, unless the film exists already."""
    if path.is_file() and path.with_suffix(".npz").is_file():
        return path
    scene = place_of(options)
    phone, seed = Phone(*options.size), options.seed
    (x, y, _), (right, back, _) = scene.bounds
    stroll = Stroll((x + INSIDE, y + INSIDE), (right - INSIDE, back - INSIDE), options.height, turn=options.turn)
    walk = phone_walk(Occupancy.from_scene(scene), stroll, round(options.seconds * phone.fps), phone.fps, seed)
    began = _clock()
    with tqdm(total=len(walk), unit="frame", desc="film", dynamic_ncols=True) as bar:
        renderer: NativeRenderer | PassersBy = NativeRenderer(scene, tolerance=TOLERANCE)
        if options.people or options.along:
            renderer = PassersBy(scene, options.people, options.along, phone.fps, TOLERANCE)
        phone_video(renderer, walk, phone, path, seed, lambda done, total: bar.update(done - bar.n))
    wall, cpu = (now - then for now, then in zip(_clock(), began, strict=True))
    print(f"filmed {len(walk)} frames of {phone.width} × {phone.height} pixels in {wall:.0f} s, {cpu:.0f} CPU s")
    return path


def likenesses(gaussians: Gaussians, placed: Placed, width: int) -> list[Likeness]:
    """Compare held-out images with renders of the capture, at the width of the fit."""
    found = placed.reconstruction
    width = min(width, found.width)
    size = (width, round(found.height * width / found.width))
    K = found.K * torch.tensor([[size[0] / found.width], [size[1] / found.height], [1.0]])
    renderer, result = NativeRenderer(gaussians), []
    for row in held_out(len(found.paths)).tolist():
        camera = Cameras(found.camera_to_world[row : row + 1].float(), K.float(), *size)
        drawn = renderer.pixels(camera)[0].numpy() / 255.0
        photo = np.asarray(Image.open(found.paths[row]).convert("RGB").resize(size, Image.Resampling.BOX)) / 255.0
        corrected = colour_corrected(drawn, photo)
        result.append(Likeness(photo, drawn, psnr(drawn, photo), ssim(drawn, photo), psnr(corrected, photo)))
    return result


def likeness_to(
    scene: Scene, gaussians: Gaussians, placed: Placed, truth: Truth, options: argparse.Namespace
) -> Floats:
    """Compare a capture with the place without people: the PSNR of each camera's view to its view of the empty place.

    Each channel is first fitted by a gain and an offset, since the exposure of the film drifts. Returns [N], dB.
    """
    found, (full, height) = placed.reconstruction, options.size
    size = options.width, round(options.width * height / full)
    K = truth.K * torch.tensor([[size[0] / full], [size[1] / height], [1.0]])
    there = Cameras(true_poses(found, truth).float(), K.float(), *size)
    empty = NativeRenderer(scene).pixels(there).numpy() / 255.0
    here = Cameras(found.camera_to_world.float(), found.K_at(*size).float(), *size)
    drawn = NativeRenderer(gaussians).pixels(here).numpy() / 255.0
    return np.array([psnr(colour_corrected(ours, true), true) for ours, true in zip(drawn, empty, strict=True)])


def settings_of(options: argparse.Namespace, truth: Truth) -> CaptureSettings:
    """Return the settings; the camera's mean height above the floor at z = ``--floor`` is what a person would state."""
    height = float((truth.camera_to_world[:, 2, 3] - options.floor).mean())
    fit = FitSettings(width=options.width, cap=options.gaussians, views=options.views, seed=options.seed)
    return CaptureSettings(camera_height=height, seed=options.seed, fit=fit, force=True, still=options.still)


def parsed() -> argparse.Namespace:
    """Parse the options."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("video", type=Path, nargs="?", help="with its truth in a .npz beside it; default: film a yard")
    add_film_options(parser)
    parser.add_argument("--yard", type=int, help="seed of a generated yard to film; by default the backyard")
    parser.add_argument("--still", action="store_true", help="assume a static scene: do not look for moving things")
    parser.add_argument("--floor", type=float, default=0.0, help="height of the floor in the truth, metres")
    parser.add_argument("--width", type=int, default=FitSettings.width)
    parser.add_argument("--gaussians", type=int, default=FitSettings.cap)
    parser.add_argument("--views", type=int, default=FitSettings.views)
    parser.add_argument("--keep", type=Path, help="folder in which to keep film and scene; by default they are deleted")
    parser.add_argument("--json", action="store_true", help="write benchmarks/results/<date>-cpu-capture.json")
    parser.add_argument("--png", type=Path, default=RESULTS / f"{today()}-cpu-capture.png")
    return parser.parse_args()


def measured(video: Path, folder: Path, options: argparse.Namespace) -> tuple[Result, list[Likeness], Placed]:
    """Capture a video, and compare the capture with the ground truth."""
    truth, settings = read_truth(video), settings_of(options, read_truth(video))
    with av.open(str(video)) as container:
        stream = container.streams.video[0]
        width, height, seconds = stream.width, stream.height, float(truth.time[-1])
    with Bars() as bars:
        watch = Stopwatch(bars)
        placed, notes = reconstruct(video, folder, settings, watch, watch.say)
        quality = build_scene(placed, folder, settings, notes, watch, watch.say)
    gaussians = read_gaussians(folder / "splat.ply")
    empty = likeness_to(place_of(options), gaussians, placed, truth, options) if options.video is None else None
    off: Deviation = deviation(placed, truth, width)
    alike = likenesses(gaussians, placed, settings.fit.width)
    images = len(placed.reconstruction.paths)
    result = Result(
        video=video.name,
        seconds=seconds,
        width=width,
        height=height,
        images=round(images / (1 - placed.reconstruction.missing)),
        posed=images,
        points=len(placed.reconstruction.points),
        gaussians=gaussians.numel(),
        laps=[*watch.laps, *(Lap(f"  {part}", wall, float("nan")) for part, wall in watch.parts.items())],
        wall=sum(lap.wall for lap in watch.laps),
        cpu=sum(lap.cpu for lap in watch.laps),
        ate_percent=100 * off.path,
        ate_metres=off.metres,
        turn_deg=off.turn_deg,
        up_deg=off.up_deg,
        scale_percent=100 * off.scale,
        scale_from=placed.scale_from,
        focal_percent=100 * off.focal,
        jerks=jerks(camera_leaps(placed.reconstruction)),
        fit_width=settings.fit.width,
        psnr=float(np.mean([one.psnr for one in alike])),
        ssim=float(np.mean([one.ssim for one in alike])),
        psnr_corrected=float(np.mean([one.psnr_corrected for one in alike])),
        empty=None if empty is None else float(empty.mean()),
        empty_worst=None if empty is None else float(np.sort(empty)[: max(1, images // 10)].mean()),
        path_free=quality.path_free,
        floating=quality.floating,
        solid=quality.solid,
    )
    return result, alike, placed


def print_result(result: Result) -> None:
    """Print two tables: the time of each stage, and the quality of the capture."""
    rows = [[lap.stage, f"{lap.wall:.1f}", "" if np.isnan(lap.cpu) else f"{lap.cpu:.1f}"] for lap in result.laps]
    print_markdown(["stage", "wall s", "CPU s"], [*rows, ["all", f"{result.wall:.1f}", f"{result.cpu:.1f}"]])
    empty = "–" if result.empty is None else f"{result.empty:.2f} dB, the worst tenth {result.empty_worst:.2f}"
    figures = [
        ("images with a pose", f"{result.posed} of {result.images}"),
        ("points, Gaussians", f"{result.points:,}, {result.gaussians:,}"),
        ("camera error (ATE)", f"{result.ate_percent:.3f} % of the path, {1000 * result.ate_metres:.1f} mm"),
        ("rotation, median", f"{result.turn_deg:.2f}°"),
        ("up", f"{result.up_deg:.2f}°"),
        ("scale", f"{result.scale_percent:+.2f} % (by {result.scale_from})"),
        ("focal length", f"{result.focal_percent:+.2f} %"),
        ("jerks of the path", f"{result.jerks:.1f}"),
        (f"held out, {result.fit_width} pixels wide", f"{result.psnr:.2f} dB, SSIM {result.ssim:.3f}"),
        ("the same, colour-corrected", f"{result.psnr_corrected:.2f} dB"),
        ("compared with the place without people", empty),
        ("free fraction of the path", f"{100 * result.path_free:.1f} %"),
        ("floating voxels", f"{result.floating} of {result.solid}"),
    ]
    print_markdown(["", ""], [list(row) for row in figures])


def main() -> None:
    """Film, capture, compare, and print the results."""
    options = parsed()
    machine = measured_machine()
    print(machine)
    with tempfile.TemporaryDirectory() as spare:
        folder = options.keep or Path(spare)
        folder.mkdir(parents=True, exist_ok=True)
        video = options.video or filmed(folder / FILM, options)
        result, alike, placed = measured(video, folder / video.stem, options)
        print_result(result)
        draw(result.laps, alike, placed, true_poses(placed.reconstruction, read_truth(video)), options.png)
        print(f"drawn to {options.png}")
    if options.json:
        print(f"written to {write_json('capture', machine, [result])}")


if __name__ == "__main__":
    main()
