"""``splatrl-scene``: inspect a captured scene, guess its orientation, and write a ``scene.yaml`` to edit."""

import argparse
import shlex
import shutil
import sys
import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from splatrl.capture.area import GRID
from splatrl.capture.pictures import GOALS, draw_goals
from splatrl.capture.suggestions import place_proposals, seen_in_splat, suggest
from splatrl.capture.walkable import walkable_area
from splatrl.collision.occupancy import Occupancy
from splatrl.commands.entries import scene as main
from splatrl.commands.options import split
from splatrl.commands.parsers import WORDS
from splatrl.evaluation.scene_pictures import draw_scene, survey_occupancy
from splatrl.evaluation.terrain_pictures import draw_terrain
from splatrl.files import replacing
from splatrl.physics.survey import find_terrain
from splatrl.scenes.blocks import BLOCKS_FILE, is_in_blocks
from splatrl.scenes.description import (
    SCENE_FILE,
    SMALL_SPLAT,
    SPLAT,
    check_absent,
    read_description,
    scene_folder,
    write_description,
)
from splatrl.scenes.formats import read_gaussians, write_gaussians
from splatrl.scenes.frame import AXES, similarity
from splatrl.scenes.gaussians import Gaussians
from splatrl.scenes.nerfstudio import DATAPARSER, antialiased_beside, stands, transform_beside
from splatrl.scenes.placement import floor_height, metres_per_unit, nerfstudio_transform
from splatrl.scenes.proposals import PROPOSALS
from splatrl.scenes.scene import Bounds, Scene, robust_bounds
from splatrl.scenes.sources import read_scene
from splatrl.scenes.splitting import write_split
from splatrl.scenes.stated import StatedFrame
from splatrl.scenes.survey import survey
from splatrl.scenes.upright import GIVEN, UNKNOWN, Guess, Upright, guess_upright

REACH = 0.3
"""Maximum reach, in metres, of a robot with physics beyond its position and above its camera, for drawing boxes."""
FILL = 0.2
"""Width of the openings that count as closed, metres, as in training."""
STILL_TO_TYPE = {"robot_height": "robot.height=0.4", "goal": "'landmarks.goal=[x,y,yaw]'"}
"""Overrides that the user must type for keys for which no proposal was found."""
FRAME_OPTIONS = ("up", "axes", "scale", "translation", "matrix", "nerfstudio", "distance")


def run(options: argparse.Namespace) -> None:
    """Inspect a scene; errors that the user can fix end the command with one line."""
    with warnings.catch_warnings():
        warnings.showwarning = lambda message, *_: print(f"note        {message}", file=sys.stderr)
        try:
            look(options)
        except (OSError, ValueError) as error:
            sys.exit(f"splatrl-scene: {error}")


def look(options: argparse.Namespace) -> None:
    """Print a summary of a scene, write its ``scene.yaml`` and draw its pictures."""
    for name in ("height", "resolution", "scale", "split"):
        value = getattr(options, name)
        if value is not None and not 0.0 < value < float("inf"):
            raise ValueError(f"--{name}: expected a positive, finite number, got {value}")
    path = options.file.expanduser()
    if is_in_blocks(path):
        raise ValueError(
            f"{path}: expected a splat file or a folder with {SCENE_FILE}, got a folder with {BLOCKS_FILE}"
        )
    stated = stated_frame(options)
    out = (options.out or (path if path.is_dir() else path.parent)).expanduser()
    out, splat = scene_folder(out)
    small = splat == SMALL_SPLAT
    if options.split is not None:
        check_no_scene(out, options.force)
    elif small or not path.is_dir():
        check_absent(out, options.force)
        if is_in_blocks(out) and not options.force:
            raise FileExistsError(f"{out / BLOCKS_FILE}: already exists; pass another folder as --out, or --force")
    if path.is_dir():
        look_again(options, path, out, small)
        return
    gaussians = read_gaussians(path)
    up = None if options.up is None else direction(options.up)
    if all(getattr(options, name) is None for name in ("axes", "matrix", "nerfstudio", "translation")):
        stated = beside(path, stated, up is not None)
    scale = stated.scale if stated.transform is None else float(stated.transform[:3, 0].norm())
    upright = print_guess(gaussians, stated.up() if up is None else up, up is not None, stated.scale or scale)
    frame = stated.frame(upright)
    world_from_splat = similarity(**frame)
    standing = read_gaussians(path, transform=world_from_splat)
    scene = Scene(path.stem, standing, robust_bounds(standing))
    drawn, floor = antialiased_beside(path), floor_height(upright, world_from_splat)
    proposals = {} if drawn is None else {"antialiased": drawn}
    if upright.units_guess.confidence == UNKNOWN:
        proposals["metric"] = False
    try:
        occupancy = draw(scene, floor, options, out, drawn)
        bounds, found = propose(scene, occupancy, floor, options, out, drawn is not False)
    except ValueError as error:
        across = max(high - low for low, high in zip(*scene.bounds, strict=True))
        raise ValueError(f"{error}; if the scene is not {across:.3g} m across, pass --scale or --distance") from error
    proposals |= found
    if options.split is not None:
        write_blocks_of(out, scene, options.split, small, bounds, proposals)
    elif small:
        write_small(out, replace(scene, bounds=bounds), proposals, options.force)
    else:
        name = beside_description(path, out, gaussians)
        print(f"wrote       {write_description(out, name, scene.name, frame, bounds, options.force, proposals)}")
    words = [word for key, word in STILL_TO_TYPE.items() if key not in proposals]
    print(" ".join(["train in it: splatrl-train", shlex.quote(f"scene={out}/"), *words]))


def propose(
    scene: Scene, occupancy: Occupancy, floor: float, options: argparse.Namespace, out: Path, antialiased: bool
) -> tuple[Bounds, dict[str, Any]]:
    """Find where robots could walk and which goals they could look for, and draw the view from each goal.

    Returns:
        Bounds of where robots can be, and the other keys and values proposed for ``scene.yaml``.
    """
    area = walkable_area(scene, occupancy, floor, options.height)
    if area is None:
        print(
            f"goals       none: no floor has free space {options.height:g} m above it; "
            "try another --height, --up or --scale"
        )
        return scene.bounds, {}
    if area.robot_height <= 0.0:
        print(
            f"goals       none: expected the floor at z = 0, got {floor:.4g} m; raise it with --matrix or --translation"
        )
        return scene.bounds, {}
    found = suggest(seen_in_splat(scene.gaussians), area)
    if found.goals:
        draw_goals(scene.gaussians, found.goals, area.robot_height, out / GOALS, antialiased)
        print(f"drew        {out / GOALS}")
    for number, goal in enumerate(found.goals, 1):
        print(f"goal {number}      {list(goal)}" + (", written to scene.yaml" if number == 1 else ""))
    show_terrain(scene, area.occupancy, area.walk, options.height, out, antialiased)
    (left, bottom), (right, top) = area.walk
    print(f"walk        x {left:g} to {right:g}, y {bottom:g} to {top:g} m, steps of {area.step or GRID:g} m")
    return area.bounds, place_proposals(area, found)


def beside_description(path: Path, out: Path, gaussians: Gaussians) -> str:
    """Return the name of the splat file in the scene's folder, after copying it there if necessary."""
    if out.resolve() == path.parent.resolve():
        return path.name
    name = path.name
    if path.suffix in (".ply", ".spz", ".splat", ".sog"):
        with replacing(out / name) as stream, path.open("rb") as source:
            shutil.copyfileobj(source, stream)
    else:  # formats with several files are rewritten as one
        name = SPLAT
        write_gaussians(out / name, gaussians)
    print(f"wrote       {out / name}")
    return name


def look_again(options: argparse.Namespace, folder: Path, out: Path, small: bool) -> None:
    """Inspect a folder that already has a ``scene.yaml``."""
    if any(getattr(options, name) is not None for name in FRAME_OPTIONS):
        raise ValueError(
            f"{folder}: expected a folder without options such as --up or --scale, got some; edit its scene.yaml, "
            "or pass the splat file instead"
        )
    scene, proposed = read_scene(folder), read_description(folder)
    drawn = proposed.get("antialiased", antialiased_beside(folder / proposed["splat"]))
    print_stated(scene.gaussians, proposed.get("metric", True))
    occupancy = draw(scene, 0.0, options, out, drawn)
    lower, upper = proposed.get("walk", [corner[:2] for corner in scene.bounds])
    show_terrain(scene, occupancy, (lower, upper), options.height, out, drawn is not False)
    proposals = {key: proposed[key] for key in PROPOSALS if key in proposed}
    if options.split is not None:
        told = {key: value for key, value in proposals.items() if key != "free"}
        told |= {} if drawn is None else {"antialiased": drawn}
        write_blocks_of(out, scene, options.split, small, scene.bounds, told)
    elif small:
        if scene.free is not None:
            with replacing(out / scene.free.path.name) as stream:
                stream.write(scene.free.path.read_bytes())
        write_small(out, scene, proposals | ({} if drawn is None else {"antialiased": drawn}), options.force)


def write_blocks_of(
    folder: Path, scene: Scene, size: float, small: bool, bounds: Bounds, proposals: dict[str, Any]
) -> None:
    """Write a scene as a folder of blocks."""
    names = write_split(folder, scene, size, Path(SMALL_SPLAT if small else SPLAT).suffix, bounds, proposals)
    print(f"wrote       {folder / BLOCKS_FILE} and {len(names)} blocks of {size:g} m")


def check_no_scene(folder: Path, force: bool) -> None:
    """Refuse to write blocks beside a ``scene.yaml``, which would be read instead of them, or over existing blocks."""
    if (folder / SCENE_FILE).exists():
        raise FileExistsError(
            f"--split: expected a folder without {SCENE_FILE}, which would be read instead of the blocks, "
            f"got {folder}; pass another folder as --out"
        )
    if (folder / BLOCKS_FILE).exists() and not force:
        raise FileExistsError(f"{folder / BLOCKS_FILE}: already exists; pass another folder as --out, or --force")


def write_small(folder: Path, scene: Scene, proposals: dict[str, Any], force: bool) -> None:
    """Write a scene's folder with a small splat file, whose Gaussians are in the world frame."""
    splat = folder / SMALL_SPLAT
    write_gaussians(splat, scene.gaussians, proposals.get("antialiased", True))
    print(f"wrote       {splat}, {splat.stat().st_size / 1e6:.1f} MB")
    frame = {"axes": ["x", "y", "z"], "scale": 1.0}
    print(f"wrote       {write_description(folder, splat.name, scene.name, frame, scene.bounds, force, proposals)}")


def print_guess(
    gaussians: Gaussians, up: list[float] | None, roughly: bool = False, scale: float | None = None
) -> Upright:
    """Print a scene's content and guessed orientation; takes the arguments of ``guess_upright`` and a known scale."""
    print(survey(gaussians))
    upright = guess_upright(gaussians, up, roughly)
    if scale is not None:
        upright = replace(upright, metres_per_unit=scale, units_guess=Guess(GIVEN, "the scale was given, not guessed"))
    print(upright)
    return upright


def print_stated(gaussians: Gaussians, metric: bool) -> None:
    """Print the content of a scene whose frame is stated by a ``scene.yaml``: z is up and the floor is at z = 0.

    Args:
        gaussians: the scene's Gaussians, world frame.
        metric: False if ``scene.yaml`` says that nothing determined the scale.
    """
    print(survey(gaussians))
    guessed = guess_upright(gaussians, [0.0, 0.0, 1.0])
    seen = f"the opaque layer is at {round(guessed.floor, 3) + 0.0:g} m ({guessed.floor_guess.confidence})"
    upright = replace(
        guessed,
        floor=0.0,
        floor_guess=Guess(GIVEN, f"z = 0 in scene.yaml; {seen}"),
        metres_per_unit=1.0,
        units_guess=Guess(GIVEN, "scene.yaml states the scale" + ("" if metric else ", and that it is unknown")),
    )
    print(upright)


def direction(text: str) -> list[float]:
    """Parse the value of ``--up`` into a direction: [3], file axes."""
    try:
        words = split(text)
        axis, sign = AXES[words[0]] if len(words) == 1 else (0, 0.0)
        values = [float(word) for word in words] if len(words) > 1 else [sign * (i == axis) for i in range(3)]
    except (KeyError, ValueError):
        values = []
    if len(values) != 3 or not np.isfinite(values).all() or not np.any(values):
        raise ValueError(f"--up: expected one of {', '.join(AXES)}, or 3 numbers, got {text!r}")
    return values


def beside(path: Path, stated: StatedFrame, turned: bool = False) -> StatedFrame:
    """Add to a stated frame the transform that nerfstudio left beside the file, or only its scale.

    Only the scale is taken if ``turned``, where ``--up`` states the orientation, or if nerfstudio's frame is not z up.
    """
    transform = transform_beside(path)
    if transform is None:
        return stated
    if stands(transform) and not turned:
        print(f"frame       from {DATAPARSER} next to the file")
        return replace(stated, transform=transform)
    print(f"frame       scale from {DATAPARSER} next to the file" + ("" if turned else "; its frame is not z-up"))
    return stated if stated.scale is not None else replace(stated, scale=float(transform[2, :3].norm()))


def draw(scene: Scene, floor: float, options: argparse.Namespace, out: Path, antialiased: bool | None) -> Occupancy:
    """Print what is solid and draw the pictures, antialiased unless ``antialiased`` is False."""
    occupancy = survey_occupancy(scene, options.resolution)
    print(occupancy.report())
    for picture in draw_scene(scene, occupancy, floor, options.height, out, antialiased is not False):
        print(f"drew        {picture}")
    return occupancy


def show_terrain(
    scene: Scene,
    occupancy: Occupancy,
    walk: tuple[Sequence[float], Sequence[float]],
    height: float,
    out: Path,
    antialiased: bool,
) -> None:
    """Print and draw the ground and the boxes with which a robot with physics would collide."""
    (left, front), (right, back) = walk
    bottom, top = scene.bounds[0][2], scene.bounds[1][2]
    around = (left - REACH, front - REACH, bottom), (right + REACH, back + REACH, max(top, bottom + 2 * height))
    filled = occupancy.solid(FILL, around=around)
    try:
        found = find_terrain(scene, filled, *walk, REACH, height + REACH, antialiased)
    except ValueError as error:
        print(f"ground      none: {str(error).removeprefix('ground: ')}")
        return
    print(found.ground)
    print(f"boxes       {len(found.terrain.boxes)}, up to {height + REACH:g} m above the ground")
    picture = out / f"{scene.name}-ground.png"
    draw_terrain(scene.gaussians, found, *walk, picture, antialiased)
    print(f"drew        {picture}")


def stated_frame(options: argparse.Namespace) -> StatedFrame:
    """Collect what the options state about the file's frame."""
    given = [name for name in ("axes", "matrix", "nerfstudio", "up") if getattr(options, name) is not None]
    if len(given) > 1:
        raise ValueError(
            f"expected at most one of --axes, --matrix, --nerfstudio and --up, got --{' and --'.join(given)}"
        )
    if options.scale is not None and options.distance is not None:
        raise ValueError("expected --scale or --distance, got both")
    if options.translation is not None and given not in ([], ["axes"], ["up"]):
        raise ValueError(f"--translation: expected on its own or with --axes or --up, got it with --{given[0]}")
    scale, transform = options.scale, None
    if options.distance is not None:
        values = _numbers("distance", options.distance)
        scale = metres_per_unit(values[:3], values[3:6], values[6])
    if options.matrix is not None:
        transform = similarity(matrix=np.reshape(_numbers("matrix", options.matrix), (4, 4)).tolist())
    elif options.nerfstudio is not None:
        transform = nerfstudio_transform(options.nerfstudio.expanduser())
    return StatedFrame(
        axes=None if options.axes is None else split(options.axes),
        transform=transform,
        scale=scale,
        translation=None if options.translation is None else _numbers("translation", options.translation),
    )


def _numbers(name: str, text: str) -> list[float]:
    words, count = split(text), WORDS[f"--{name}"]
    try:
        values = [float(word) for word in words]
    except ValueError as error:
        raise ValueError(f"--{name}: expected {count} numbers, got {text!r}") from error
    if len(values) != count:
        raise ValueError(f"--{name}: expected {count} numbers, got {len(values)}: {text!r}")
    return values


if __name__ == "__main__":
    main()
