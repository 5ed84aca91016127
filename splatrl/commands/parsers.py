"""Option parsers of the commands without a config, kept apart from the commands, which take seconds to import."""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from splatrl.commands.options import Parser, is_numbers, joined, split

if TYPE_CHECKING:
    from splatrl.capture.scale import Distance

WORDS = {"--axes": 3, "--translation": 3, "--matrix": 16, "--distance": 7}
"""Options that take several words, some of which may begin with a minus sign, and how many words each takes."""
GAIT = """
splatrl-gait outputs/2026-01-31/12-00-00 --out gait.npz
splatrl-train task=walk task.motion.gait=gait.npz
"""


def capture(arguments: Sequence[str]) -> argparse.Namespace:
    """Parse the options of ``splatrl-capture``; None stands for an option that was not typed and has a default."""
    result = Parser(
        prog="splatrl-capture", description="Make a scene to train in of a phone video or a folder of photos."
    )
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
        help="folder of the scene; by default the source's name without its ending, and -scene after it where that is "
        "the source itself; garden.spz makes a folder garden with a small splat",
    )
    result.add_argument(
        "--force",
        action="store_true",
        help="go on where a first look says no, or without images that cannot be joined; replace a scene",
    )
    result.add_argument(
        "--camera-height",
        type=float,
        metavar="M",
        help="of the camera above the floor, on average over the film, metres; above grass, count from its tips",
    )
    result.add_argument(
        "--distance",
        type=_distance,
        metavar="IMAGE X Y [IMAGE] X Y M",
        help="two points, each by the number of an image in stages/undistorted and pixels in it (the second in the "
        "same where no other is named), and the metres between them",
    )
    result.add_argument("--marker-side", type=float, metavar="M", help="of a printed marker, metres")
    result.add_argument("--marker", type=Path, metavar="PDF", help="write a page with a marker to print, and stop")
    result.add_argument(
        "--robot-width", type=int, help="of the images that robots will see, pixels; as usual in trainings by default"
    )
    result.add_argument(
        "--width", type=int, help="of the images that are fitted, pixels; follows the robots by default"
    )
    result.add_argument("--gaussians", type=int, help="at most; follows the number of pixels by default")
    result.add_argument("--views", type=int, help="drawn in the fit: more takes longer")
    result.add_argument(
        "--still", action="store_true", help="nothing moved while it was filmed: do not look for people to leave out"
    )
    result.add_argument("--seed", type=int, default=0)
    result.add_argument("--device", default="auto", help="of the fit: auto, cpu, cuda or cuda:<number>")
    options = result.parse_args(joined(arguments, {"--distance": 7}, is_numbers))
    if options.marker is None and options.source is None:
        result.error("expected a video or a folder of photos, or --marker")
    return options


def _distance(text: str) -> "Distance":
    """Parse the value of ``--distance``: IMAGE X Y X Y M, or IMAGE X Y IMAGE X Y M.

    Raises:
        argparse.ArgumentTypeError: for anything else.
    """
    try:
        values = [float(word) for word in split(text)]
        if len(values) == 6:  # both points are in one image
            values.insert(3, values[0])
        if len(values) != 7 or values[0] % 1 != 0 or values[3] % 1 != 0:
            raise ValueError(f"expected IMAGE X Y X Y M or IMAGE X Y IMAGE X Y M, got {text!r}")
        from splatrl.capture.scale import Click, Distance

        first, second = (Click(int(image), x, y) for image, x, y in (values[0:3], values[3:6]))
        return Distance.between(first, second, values[6])
    except (ValueError, OverflowError) as error:
        raise argparse.ArgumentTypeError(str(error)) from error


def scene(arguments: Sequence[str]) -> argparse.Namespace:
    """Parse the options of ``splatrl-scene``."""
    result = Parser(
        prog="splatrl-scene",
        description="Inspect a captured scene, guess its orientation, and write a scene.yaml to edit.",
    )
    result.add_argument("file", type=Path, help="a splat file, or a folder with scene.yaml to inspect again")
    result.add_argument(
        "--up",
        metavar="AXIS",
        help="the file's axis that is up, to about 15°: -y, or 3 numbers; the floor and the walls nearby refine it",
    )
    result.add_argument("--axes", metavar="X Y Z", help="signed file axes that become world x, y and z: x -z y")
    result.add_argument("--scale", type=float, help="metres per unit of the file")
    result.add_argument("--translation", metavar="X Y Z", help="metres, added last")
    result.add_argument("--matrix", metavar="M", help="16 numbers, row by row: from the file to world metres")
    result.add_argument(
        "--nerfstudio",
        type=Path,
        metavar="JSON",
        help="dataparser_transforms.json to undo; by default the one beside the file",
    )
    result.add_argument("--distance", metavar="P Q D", help="two points of the file and the metres between: 7 numbers")
    result.add_argument(
        "--out",
        type=Path,
        help="folder for scene.yaml and pictures; by default the file's folder; garden.spz makes a folder garden that "
        "holds the splat too, as a small file",
    )
    result.add_argument("--force", action="store_true", help="replace an existing scene.yaml")
    result.add_argument(
        "--split",
        type=float,
        metavar="METRES",
        help="write blocks of this size and blocks.yaml in place of one splat and scene.yaml, for scenes larger than "
        "memory; with --out town.spz as small files",
    )
    result.add_argument("--height", type=float, default=0.4, help="of the robot, metres, where free space is drawn")
    result.add_argument("--resolution", type=float, help="of the occupancy, metres; by default 0.05, or what fits")
    words = joined(joined(arguments, {"--up": 3}, is_numbers), {"--up": 1})
    return result.parse_args(joined(words, WORDS))


def gait(arguments: Sequence[str]) -> argparse.Namespace:
    """Parse the options of ``splatrl-gait``."""
    result = argparse.ArgumentParser(
        "splatrl-gait",
        description="Write the policy of a run of task=strides as a gait, a small file of weights.",
        epilog=GAIT,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    result.add_argument("run", type=Path, help="the run folder")
    result.add_argument("--out", type=Path, help="file to write; gait.npz in the run folder unless told")
    result.add_argument("--checkpoint", choices=("last", "best"), default="last", help="of the run (last)")
    return result.parse_args(arguments)
