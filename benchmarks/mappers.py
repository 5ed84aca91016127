"""Compares two ways of mapping films of generated yards, and whether jerks reveal a torn map without ground truth.

    python benchmarks/mappers.py                        # 8 yards, about six CPU minutes each
    python benchmarks/mappers.py --yards 100 101 --seconds 60 --size 1280 720
    python benchmarks/mappers.py --films kitchen_m.mp4  # any video with ground truth in a .npz beside it

Each yard is filmed as in ``benchmarks/capture.py``, its images are matched, and the cameras are found by both of
COLMAP's mappers: incremental and global. Each row gives the number of registered images, the jerks of the camera's path
(by which ``splatrl.capture.sfm.mapping`` chooses), how well the scale is carried on where that is worst (by which
``splatrl.capture.carrying`` warns) and the ratio of the largest to the smallest scale of an eighth of the film, and the
root-mean-square and maximum camera error in metres, after alignment by the closest similarity. ``--keep FOLDER`` keeps
films and matches.
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
from capture import add_film_options, filmed
from machine import measured_machine
from record import print_markdown, write_json

from splatrl.capture.frames import read_photos
from splatrl.capture.jerks import jerks, leaps
from splatrl.capture.poses import job_of
from splatrl.capture.settings import CaptureSettings
from splatrl.capture.sfm.job import Job
from splatrl.capture.sfm.mapping import camera_places, find_cameras, least_carried, map_at_once, map_one_by_one
from splatrl.capture.sfm.structure import match_images
from splatrl.capture.truth import Truth, closest_similarity, distances, poses_at, read_truth

PARTS = 8
"""Number of parts of a film whose scales are compared."""


@dataclass(frozen=True)
class Map:
    """The map of a film by one mapper, compared with the truth."""

    film: str
    way: str
    images: int
    posed: int
    jerks: float
    carried: float
    scales: float
    ate_metres: float
    worst_metres: float
    cpu: float


def parsed() -> argparse.Namespace:
    """Parse the options."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--yards", type=int, nargs="*", default=[*range(40, 48)], help="seeds of the yards")
    parser.add_argument("--films", type=Path, nargs="*", help="videos instead of yards, each with its truth beside it")
    add_film_options(parser)
    parser.set_defaults(seconds=45.0, size=(960, 540), height=1.5, turn=24.0)
    parser.add_argument("--keep", type=Path, help="folder in which to keep films and matches")
    parser.add_argument("--json", action="store_true", help="write benchmarks/results/<date>-cpu-mappers.json")
    return parser.parse_args()


def filmed_yard(yard: int, folder: Path, options: argparse.Namespace) -> Path:
    """Film a yard into its own folder, unless the film exists already."""
    folder.mkdir(parents=True, exist_ok=True)
    return filmed(folder / "walk.mp4", argparse.Namespace(**{**vars(options), "yard": yard}))


def against(truth: Truth, job: Job, model: Any) -> tuple[int, float, float, float, float, float]:
    """Return what a ``Map`` says of a model, from the number of registered images to the maximum error."""
    images, places = camera_places(model, job)
    if len(images) < 3 * PARTS:
        return len(images), *5 * (float("nan"),)
    seconds = np.array(job.seconds)[images]
    found, true = torch.from_numpy(places), poses_at(torch.from_numpy(seconds), truth)[:, :3, 3]
    parts = zip(found.tensor_split(PARTS), true.tensor_split(PARTS), strict=True)
    scales = [float(closest_similarity(*part)[:3, :3].det()) ** (1 / 3) for part in parts]
    errors = distances(found, true)
    figures = jerks(leaps(places, seconds, job.cuts)), least_carried(model, job), max(scales) / min(scales)
    return len(images), *figures, float(errors.square().mean().sqrt()), float(errors.max())


def mapped(name: str, film: Path, folder: Path, seed: int) -> list[Map]:
    """Map a film with the incremental and the global mapper, and as a capture does, which chooses between them."""
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
    """Print a table with one row per map."""
    header = ["film", "mapper", "images", "jerks", "carried", "scales", "RMS error, m", "max error, m", "CPU s"]
    rows = []
    for one in maps:
        figures = [f"{one.jerks:.1f}", f"{one.carried:.2f}", f"{one.scales:.2f}"]
        figures += [f"{one.ate_metres:.3f}", f"{one.worst_metres:.2f}", f"{one.cpu:.0f}"]
        rows.append([one.film, one.way, f"{one.posed} of {one.images}", *figures])
    print_markdown(header, rows)


def main() -> None:
    """Film, map, compare and print."""
    options, machine, found = parsed(), measured_machine(), []
    print(machine)
    pycolmap.logging.minloglevel = 2  # only errors
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
