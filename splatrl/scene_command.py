"""``splatrl-scene``: look at a captured scene, guess how it stands, and write a ``scene.yaml`` to edit."""

import argparse
import sys
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from PIL import Image
from torch import Tensor

from splatrl.collision.density import DensitySettings
from splatrl.collision.occupancy import Occupancy
from splatrl.collision.pictures import draw_blocks, draw_maps
from splatrl.evaluation.viewpoint import eye_view, open_corner
from splatrl.files import replacing
from splatrl.scenes.description import check_absent, write_description
from splatrl.scenes.formats import read_gaussians
from splatrl.scenes.frame import similarity
from splatrl.scenes.gaussians import Gaussians
from splatrl.scenes.placement import (
    Frame,
    matrix_frame,
    metres_per_unit,
    nerfstudio_transform,
    rescaled,
    upright_frame,
)
from splatrl.scenes.scene import Scene, robust_bounds
from splatrl.scenes.sources import read_scene
from splatrl.scenes.survey import survey
from splatrl.scenes.upright import Upright, guess_upright

WORDS = {"--axes": 3, "--translation": 3, "--matrix": 16, "--distance": 7}
"""Options of several words, some of which begin with a minus, and how many."""
EYE = 1.6
"""Metres: height of a person's eye."""
FLAT = 0.15
"""Of its width: a scene that is lower is looked at from above."""


def parser() -> argparse.ArgumentParser:
    """The command line."""
    result = argparse.ArgumentParser(prog="splatrl-scene", description=__doc__)
    result.add_argument("file", type=Path, help="a splat file, or a folder with scene.yaml to look at again")
    result.add_argument("--axes", metavar="X Y Z", help="signed file axes that become world x, y, z: x -z y")
    result.add_argument("--scale", type=float, help="metres a unit of the file")
    result.add_argument("--translation", metavar="X Y Z", help="metres, added last")
    result.add_argument("--matrix", metavar="M", help="16 numbers, row by row: file to world metres")
    result.add_argument("--nerfstudio", type=Path, metavar="JSON", help="dataparser_transforms.json: undo it")
    result.add_argument("--distance", metavar="P Q D", help="two points of the file and the metres between: 7 numbers")
    result.add_argument("--out", type=Path, help="folder for scene.yaml and pictures; by default the file's own")
    result.add_argument("--force", action="store_true", help="replace a scene.yaml that is there")
    result.add_argument("--height", type=float, default=0.4, help="of the robot, metres: where free space is drawn")
    result.add_argument("--resolution", type=float, help="of the occupancy, metres; by default 0.05, or what fits")
    return result


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry point of the command."""
    options = parser().parse_args(_joined(sys.argv[1:] if arguments is None else arguments))
    with warnings.catch_warnings():
        warnings.showwarning = lambda message, *_: print(f"note        {message}", file=sys.stderr)
        try:
            look(options)
        except (OSError, ValueError) as error:
            sys.exit(f"splatrl-scene: {error}")


def look(options: argparse.Namespace) -> None:
    """Print what a scene seems to be, write its ``scene.yaml`` and draw its pictures."""
    for name in ("height", "resolution", "scale"):
        value = getattr(options, name)
        if value is not None and not 0.0 < value < float("inf"):
            raise ValueError(f"--{name}: expected a finite number above 0, got {value}")
    path = options.file.expanduser()
    known = _stated(options)
    out = (options.out or (path if path.is_dir() else path.parent)).expanduser()
    if path.is_dir():
        if known is not None or options.scale or options.distance or options.translation:
            raise ValueError(
                f"{path}: expected no frame beside a folder's; edit its scene.yaml, or name the splat file"
            )
        scene = read_scene(path)
        upright = _print_guess(scene.gaussians, [0.0, 0.0, 1.0])
        _draw(scene, upright.floor, options, out)
        return
    check_absent(out, options.force)
    gaussians = read_gaussians(path)
    upright = _print_guess(gaussians, None if known is None else known[2, :3].tolist())
    frame = _frame(options, known, upright)
    world_from_splat = similarity(**frame)
    floor = world_from_splat[2, :3] @ torch.from_numpy(upright.up * upright.floor) + world_from_splat[2, 3]
    standing = gaussians.transformed(world_from_splat)
    scene = Scene(path.stem, standing, robust_bounds(standing))
    _draw(scene, float(floor), options, out)
    print(f"wrote       {write_description(out, path.name, scene.name, frame, scene.bounds, options.force)}")
    if out.resolve() != path.parent.resolve():
        print(f"            put {path.name} beside it: a folder with both is a scene")


def _print_guess(gaussians: Gaussians, up: list[float] | None) -> Upright:
    print(survey(gaussians))
    upright = guess_upright(gaussians, up)
    print(upright)
    return upright


def _draw(scene: Scene, floor: float, options: argparse.Namespace, out: Path) -> None:
    for picture in draw(scene, floor, options.height, options.resolution, out):
        print(f"drew        {picture}")


def draw(scene: Scene, floor: float, height: float, resolution: float | None, out: Path) -> list[Path]:
    """Draw free space at a robot's height, the occupancy, and a view from eye height.

    Args:
        scene: in the world frame.
        floor: its height, metres.
        height: of the robot, metres; at most half of the scene's is used, for scenes whose units are unknown.
        resolution: of the occupancy, metres; None takes 0.05 within a 256th to a 50th of the scene's diagonal.
        out: folder for the pictures.

    Returns:
        The files.
    """
    lower, upper = np.array(scene.bounds)
    diagonal = float(np.linalg.norm(upper - lower))
    if diagonal == 0.0:
        raise ValueError(f"{scene.name}: expected a scene with an extent to draw, got one at a single point")
    edge = resolution or float(np.clip(0.05, diagonal / 256, diagonal / 50))
    margin = 0.1 * diagonal
    crop = ((lower - margin).tolist(), (upper + margin).tolist())
    occupancy = Occupancy.from_gaussians(scene.gaussians, edge, DensitySettings(min_volume=64 * edge**3), crop)
    room = max(float(upper[2]) - floor, 4 * edge)
    body = min(height, 0.5 * room)
    eye = min(EYE, 0.65 * room)
    across = float(np.hypot(*(upper - lower)[:2]))
    if room < FLAT * across:  # seen from the air: from its own height there would be only ground
        eye = 0.4 * across
    print(f"occupancy   {occupancy.count:,} voxels of {edge:.3g} m, drawn for a robot {body:.2g} m high")
    out.mkdir(parents=True, exist_ok=True)
    files = [out / f"{scene.name}-{kind}.png" for kind in ("free", "occupancy", "view")]
    draw_maps(occupancy, files[0], round(floor + 0.5 * body, 3), round(floor + body, 3))
    draw_blocks(occupancy, files[1], below=floor + 0.85 * room, quarter_turns=open_corner(occupancy))
    image = Image.fromarray(eye_view(scene.gaussians, occupancy, scene.bounds, floor, floor + eye).numpy())
    with replacing(files[2]) as stream:
        image.save(stream, "PNG")
    return files


def _stated(options: argparse.Namespace) -> Tensor | None:
    """``world_from_splat`` as far as the options turn it, or None where they leave that to the guess."""
    given = [name for name in ("axes", "matrix", "nerfstudio") if getattr(options, name) is not None]
    if len(given) > 1:
        raise ValueError(f"expected one of --axes, --matrix and --nerfstudio, got --{' and --'.join(given)}")
    if options.scale is not None and options.distance is not None:
        raise ValueError("expected --scale or --distance, got both")
    if options.translation is not None and given and given != ["axes"]:
        raise ValueError(f"--translation: expected beside --axes or alone, got it beside --{given[0]}")
    if options.axes is not None:
        return similarity(_words(options.axes))
    if options.matrix is not None:
        return similarity(matrix=np.reshape(_numbers("matrix", options.matrix), (4, 4)).tolist())
    return None if options.nerfstudio is None else nerfstudio_transform(options.nerfstudio.expanduser())


def _frame(options: argparse.Namespace, known: Tensor | None, upright: Upright) -> Frame:
    """What the options state, and what the guess says where they say nothing."""
    scale = options.scale
    if options.distance is not None:
        values = _numbers("distance", options.distance)
        scale = metres_per_unit(values[:3], values[3:6], values[6])
    if known is not None and options.axes is None:
        return matrix_frame(known if scale is None else rescaled(known, scale))
    axes = None if options.axes is None else _words(options.axes)
    shift = None if options.translation is None else _numbers("translation", options.translation)
    return upright_frame(upright, axes, scale, shift)


def _joined(arguments: Sequence[str]) -> list[str]:
    """The arguments with the words of ``--axes x -z y`` and its like made one, ``--axes=x -z y``."""
    result, rest = [], list(arguments)
    while rest:
        argument = rest.pop(0)
        if argument in WORDS:
            words: list[str] = []
            while rest and len(words) < WORDS[argument] and not rest[0].startswith("--"):
                words += _words(rest.pop(0))
            argument = f"{argument}={' '.join(words)}"
        result.append(argument)
    return result


def _words(text: str) -> list[str]:
    return text.replace(",", " ").split()


def _numbers(name: str, text: str) -> list[float]:
    words, count = _words(text), WORDS[f"--{name}"]
    try:
        values = [float(word) for word in words]
    except ValueError as error:
        raise ValueError(f"--{name}: expected {count} numbers, got {text!r}") from error
    if len(values) != count:
        raise ValueError(f"--{name}: expected {count} numbers, got {len(values)}: {text!r}")
    return values


if __name__ == "__main__":
    main()
