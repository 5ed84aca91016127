"""What makes a map of a film torn, and whether it is known without the truth: two ways of mapping generated yards.

    python benchmarks/mappers.py                        # 8 yards, about six CPU minutes each
    python benchmarks/mappers.py --yards 100 101 --seconds 60 --size 1280 720
    python benchmarks/mappers.py --films kitchen_m.mp4  # any video with its truth in a .npz beside it

Each yard is filmed as by ``benchmarks/capture.py``, its images are matched, and the cameras found by both of COLMAP's
mappers: image after image, and all at once. A row tells for each how many images it joined, the jerks of the camera's
path (what ``splatrl.capture.mapping`` chooses by), and how far the cameras are from the truth in the mean (root of
squares) and at most, metres, once a similarity has brought them closest. ``--keep FOLDER`` keeps films and matches.
"""

import argparse
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
import torch
from capture import filmed
from machine import measured_machine
from record import print_markdown, write_json

from splatrl.capture.frames import read_photos
from splatrl.capture.jerks import jerks, leaps
from splatrl.capture.job import Job
from splatrl.capture.mapping import camera_places, find_cameras, map_at_once, map_one_by_one
from splatrl.capture.pipeline import CaptureSettings
from splatrl.capture.poses import job_of
from splatrl.capture.structure import match_images
from splatrl.capture.truth import Truth, distances, poses_at, read_truth


@dataclass(frozen=True)
class Map:
    """One way of mapping a film, against the truth."""

    film: str
    way: str
    images: int
    posed: int
    jerks: float
    ate_metres: float
    worst_metres: float
    cpu: float


def parsed() -> argparse.Namespace:
    """The options."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--yards", type=int, nargs="*", default=[*range(40, 48)], help="their seeds")
    parser.add_argument("--films", type=Path, nargs="*", help="in place of yards, each with its truth beside it")
    parser.add_argument("--seconds", type=float, default=45.0, help="of a yard's film")
    parser.add_argument("--size", type=int, nargs=2, default=(960, 540), help="of a yard's film, pixels")
    parser.add_argument("--height", type=float, default=1.5, help="of the camera of a yard's film, metres")
    parser.add_argument("--turn", type=float, default=24.0, help="seconds in which the view goes once around")
    parser.add_argument("--people", type=int, default=0, help="who walk through the yard while it is filmed")
    parser.add_argument("--seed", type=int, default=0, help="of the way through a yard, and of every random sample")
    parser.add_argument("--keep", type=Path, help="folder for films and matches; none forgets them")
    parser.add_argument("--json", action="store_true", help="write benchmarks/results/<date>-cpu-mappers.json")
    return parser.parse_args()


def filmed_yard(yard: int, folder: Path, options: argparse.Namespace) -> Path:
    """The film of a yard, in a folder of its own."""
    folder.mkdir(parents=True, exist_ok=True)
    return filmed(folder / "walk.mp4", argparse.Namespace(**{**vars(options), "yard": yard}))


def against(truth: Truth, job: Job, model: Any) -> tuple[int, float, float, float]:
    """Images joined, jerks, and how far cameras are from the truth, metres: in the mean, and at most."""
    images, places = camera_places(model, job)
    if len(images) < 3:
        return len(images), 0.0, float("nan"), float("nan")
    seconds = np.array(job.seconds)[images]
    away = distances(torch.from_numpy(places), poses_at(torch.from_numpy(seconds), truth)[:, :3, 3])
    return len(images), jerks(leaps(places, seconds)), float(away.square().mean().sqrt()), float(away.max())


def mapped(name: str, film: Path, folder: Path, seed: int) -> list[Map]:
    """A film's maps: image after image, all at once, and the one that a capture takes."""
    folder.mkdir(parents=True, exist_ok=True)
    photos = read_photos(film, folder, CaptureSettings.count, CaptureSettings.longest, lambda *_: None)
    job, truth, rows = job_of(photos, seed), read_truth(film), []
    match_images(pycolmap, folder, job)
    for way, find in (("one by one", map_one_by_one), ("at once", map_at_once), ("taken", find_cameras)):
        began = time.process_time()
        model = find(pycolmap, folder, job)
        cpu = time.process_time() - began
        rows.append(Map(name, way, len(job.names), *against(truth, job, model), cpu))
    return rows


def print_maps(maps: list[Map]) -> None:
    """A table, a row for each."""
    header = ["film", "way", "images", "jerks", "mean off, m", "most off, m", "CPU s"]
    rows = []
    for one in maps:
        figures = [f"{one.jerks:.1f}", f"{one.ate_metres:.3f}", f"{one.worst_metres:.2f}", f"{one.cpu:.0f}"]
        rows.append([one.film, one.way, f"{one.posed} of {one.images}", *figures])
    print_markdown(header, rows)


def main() -> None:
    """Film, map, compare and print."""
    options, machine, found = parsed(), measured_machine(), []
    print(machine)
    pycolmap.logging.minloglevel = 2  # its errors
    with tempfile.TemporaryDirectory() as spare:
        folder = options.keep or Path(spare)
        for source in options.films or options.yards:
            name = source.stem if options.films else f"yard {source}"
            film = source if options.films else filmed_yard(source, folder / name, options)
            maps = mapped(name, film, folder / name / film.stem, options.seed)
            print_maps(maps)
            found += maps
    print_maps(found)
    if options.json:
        print(f"written to {write_json('mappers', machine, found)}")


if __name__ == "__main__":
    main()
