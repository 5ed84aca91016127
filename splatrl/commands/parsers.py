"""Option parsers of the commands without a config, kept apart from the commands, which take seconds to import."""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from splatrl.commands.options import Parser, is_numbers, is_word, joined
from splatrl.values import require_number, split_words

if TYPE_CHECKING:
    from splatrl.capture.scale import Distance

WORDS = {"--axes": 3, "--translation": 3, "--matrix": 16, "--distance": 7}
"""Options that take several words, some of which may begin with a minus sign, and how many words each takes."""
CAPTURE: dict[str, dict[str, Any]] = {
    "camera_height": {"above": 0.0, "unit": "metres"},
    "marker_side": {"above": 0.0, "unit": "metres"},
    "robot_width": {"low": 1, "whole": True, "unit": "pixels"},
    "width": {"low": 16, "whole": True, "unit": "pixels"},
    "gaussians": {"low": 1, "whole": True},
    "views": {"low": 1, "whole": True},
    "seed": {"low": 0, "high": 2**31 - 1, "whole": True},
}
"""Limits of the numbers that ``splatrl-capture`` takes, as for ``require_number``; some are used only after minutes."""
COMPARE = """
splatrl-train -m seed=0,1,2 memory=none,gru
splatrl-compare multirun/2026-01-31/12-00-00
splatrl-compare outputs/2026-01-31/12-00-00 outputs/2026-02-01/09-30-00 --out comparison/
"""
GAIT = """
splatrl-gait outputs/2026-01-31/12-00-00 --out gait.npz
splatrl-train task=walk task.motion.gait=gait.npz
"""


def capture(arguments: Sequence[str]) -> argparse.Namespace:
    """Parse the options of ``splatrl-capture``; None stands for an option that was not typed and has a default."""
    result = _capture_parser()
    options, more = result.parse_known_args(joined(arguments, {"--distance": 7}, _is_click))
    if any(word.startswith("-") for word in more):
        result.error(f"unrecognized arguments: {' '.join(more)}")
    if more:
        result.error(
            f"expected one video or one folder, got {', '.join(map(str, (options.source, *more)))}; name the folder of "
            "photos, and first join takes of one camera, held the same way (ffmpeg -f concat)"
        )
    if options.marker is None and options.source is None:
        result.error("expected a video or a folder of photos, or --marker")
    try:
        for name, limits in CAPTURE.items():
            if getattr(options, name) is not None:
                require_number(f"--{name.replace('_', '-')}", getattr(options, name), **limits)
    except ValueError as error:
        result.error(str(error))
    return options


def _capture_parser() -> Parser:
    result = Parser(
        prog="splatrl-capture", description="Turn a phone video or a folder of photos into a scene to train in."
    )
    result.add_argument(
        "source",
        type=Path,
        nargs="?",
        help="a video, a folder of photos, or a recording: raw data of Polycam, Stray Scanner or Record3D, "
        "a transforms.json or a COLMAP model",
    )
    result.add_argument(
        "--out",
        type=_folder,
        help="folder for the scene; by default the source's name without its suffix, plus -scene if that is the source "
        "itself; garden.spz makes a folder garden that holds the splat as a small file",
    )
    result.add_argument(
        "--force",
        action="store_true",
        help="continue even if the first look refuses the images, or without images that cannot be registered; "
        "replace an existing scene",
    )
    result.add_argument(
        "--camera-height",
        type=float,
        metavar="M",
        help="mean height of the camera over the film, metres, above the floor, or above the soil if there is grass",
    )
    result.add_argument(
        "--distance",
        type=_distance,
        metavar="IMAGE X Y [IMAGE] X Y M",
        help="two points and the distance between them in metres; each point is an image, by its file name or its "
        "number in the order of the names, from 0, and a pixel in it (the second point may omit the image if it is the "
        "same); the images are those in stages/undistorted, or for recordings with poses those in stages/shots, "
        "stages/upright or stages/recorded, or else the recording's own",
    )
    result.add_argument("--marker-side", type=float, metavar="M", help="side length of the printed marker, metres")
    result.add_argument("--marker", type=Path, metavar="PDF", help="write a page with a marker to print, and exit")
    result.add_argument(
        "--robot-width", type=int, help="width of the robots' images, pixels; by default the usual width in training"
    )
    result.add_argument(
        "--width", type=int, help="width of the images for the fit, pixels; by default set from the robots' images"
    )
    result.add_argument(
        "--gaussians", type=int, help="maximum number of Gaussians; by default set from the number of pixels"
    )
    result.add_argument("--views", type=int, help="number of views rendered during the fit; more takes longer")
    result.add_argument(
        "--still", action="store_true", help="nothing moved during filming: do not search for people to mask out"
    )
    result.add_argument("--seed", type=int, default=0)
    result.add_argument("--device", default="auto", help="device for the fit: auto, cpu, cuda or cuda:<number>")
    return result


def _folder(text: str) -> Path:
    """Parse the path of a folder; an empty one would be the working directory.

    Raises:
        argparse.ArgumentTypeError: for an empty path.
    """
    if not text:
        raise argparse.ArgumentTypeError("expected a folder, got an empty name")
    return Path(text)


def _is_click(word: str) -> bool:
    """Return whether an argument is part of ``--distance``: a number or the name of a photo, or several of them."""
    from splatrl.images import PHOTO_SUFFIXES

    parts = split_words(word) if is_word(word) else []
    return bool(parts) and all(is_numbers(part) or part.lower().endswith(PHOTO_SUFFIXES) for part in parts)


def _distance(text: str) -> "Distance":
    """Parse the value of ``--distance``: IMAGE X Y X Y M, or IMAGE X Y IMAGE X Y M, an image by its name or number.

    Raises:
        argparse.ArgumentTypeError: for anything else.
    """
    try:
        words = split_words(text)
        if len(words) == 6:  # both points are in one image
            words.insert(3, words[0])
        if len(words) != 7 or not all(map(is_numbers, (*words[1:3], *words[4:]))):
            raise ValueError(f"expected IMAGE X Y X Y M or IMAGE X Y IMAGE X Y M, got {text!r}")
        from splatrl.capture.scale import Click, Distance

        first, second = (Click(_image(image), float(x), float(y)) for image, x, y in (words[0:3], words[3:6]))
        return Distance.between(first, second, float(words[6]))
    except (ValueError, OverflowError) as error:
        raise argparse.ArgumentTypeError(str(error)) from error


def _image(word: str) -> int | str:
    """Return the number of an image, or its file name.

    Raises:
        ValueError: for a number that is not whole.
    """
    if not is_numbers(word):
        return word
    number = float(word)
    if number % 1 != 0:
        raise ValueError(f"expected the name or the number of an image, got {word}")
    return int(number)


def scene(arguments: Sequence[str]) -> argparse.Namespace:
    """Parse the options of ``splatrl-scene``."""
    result = Parser(
        prog="splatrl-scene",
        description="Inspect a captured scene, guess its orientation, and write a scene.yaml to edit.",
    )
    result.add_argument(
        "file",
        type=Path,
        help="a splat file, the folder of an unpacked SOG, or a folder with scene.yaml to inspect again",
    )
    result.add_argument(
        "--up",
        metavar="AXIS",
        help="up direction in the file, to within about 15°: an axis such as -y, or 3 numbers; it is refined to fit "
        "the floor and the walls",
    )
    result.add_argument("--axes", metavar="X Y Z", help="signed file axes that become world x, y and z, such as x -z y")
    result.add_argument("--scale", type=float, help="metres per unit of the file")
    result.add_argument("--translation", metavar="X Y Z", help="translation in metres, added last")
    result.add_argument("--matrix", metavar="M", help="transform from the file to world metres: 16 numbers, row by row")
    result.add_argument(
        "--nerfstudio",
        type=Path,
        metavar="JSON",
        help="dataparser_transforms.json whose transform is undone; by default the one next to the file",
    )
    result.add_argument(
        "--distance", metavar="P Q D", help="two points in the file and the metres between them: 7 numbers"
    )
    result.add_argument(
        "--out",
        type=_folder,
        help="folder for scene.yaml and pictures; by default the file's folder; garden.spz makes a folder garden that "
        "also holds the splat as a small file",
    )
    result.add_argument(
        "--force",
        action="store_true",
        help="replace existing splat files, and in an existing scene.yaml what this command estimates; name, source, "
        "antialiased and cutoff stay as you wrote them",
    )
    result.add_argument(
        "--split",
        type=float,
        metavar="METRES",
        help="write blocks of this size and blocks.yaml instead of one splat and scene.yaml, for scenes that do not "
        "fit in memory; --out town.spz writes them as small files",
    )
    result.add_argument(
        "--height",
        type=float,
        help="height of the robot, metres, at which free space is drawn; by default that of scene.yaml, or 0.4",
    )
    result.add_argument(
        "--resolution",
        type=float,
        help="voxel size of the occupancy, metres; by default that of scene.yaml; for a splat file 0.05, but between "
        "1/256 and 1/50 of the scene's diagonal",
    )
    words = joined(joined(arguments, {"--up": 3}, is_numbers), {"--up": 1})
    return result.parse_args(joined(words, WORDS))


def gait(arguments: Sequence[str]) -> argparse.Namespace:
    """Parse the options of ``splatrl-gait``."""
    result = Parser(
        "splatrl-gait",
        description="Write the policy of a task=strides run as a gait, a small file of network weights.",
        epilog=GAIT,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    result.add_argument("run", type=Path, help="the run folder")
    result.add_argument("--out", type=Path, help="file to write; by default gait.npz in the run folder")
    result.add_argument(
        "--checkpoint", choices=("last", "best"), default="last", help="checkpoint to use; by default last"
    )
    return result.parse_args(arguments)


def compare(arguments: Sequence[str]) -> argparse.Namespace:
    """Parse the options of ``splatrl-compare``."""
    result = Parser(
        "splatrl-compare",
        description="Compare finished trainings: a table with means over seeds, whether the best differs by more than "
        "chance, and learning curves, in report.md, report.json and figures.",
        epilog=COMPARE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    result.add_argument("runs", type=Path, nargs="+", metavar="run", help="run folders, or folders of sweeps")
    result.add_argument(
        "--out",
        type=_folder,
        help="folder of the report, new or of an earlier comparison; by default comparison in the first folder",
    )
    return result.parse_args(arguments)
