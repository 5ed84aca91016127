"""``splatrl-scene``: inspect a captured scene, guess its orientation, and write a ``scene.yaml`` to edit."""

import argparse
import shlex
import sys
import warnings
from collections.abc import Iterable, Mapping
from pathlib import Path

from splatrl.capture import inspection
from splatrl.commands.entries import USERS
from splatrl.commands.entries import scene as main
from splatrl.files import expanded
from splatrl.scenes.blocks import BLOCKS_FILE, is_in_blocks, scene_place
from splatrl.scenes.description import SCENE_FILE, read_description
from splatrl.scenes.folders import SceneFolder
from splatrl.scenes.formats import read_gaussians
from splatrl.scenes.formats.reading import read_centred, rounding, splat_reader, trained_antialiased
from splatrl.scenes.frame import similarity
from splatrl.scenes.nerfstudio import antialiased_beside
from splatrl.scenes.placement import floor_height
from splatrl.scenes.proposals import PROPOSALS
from splatrl.scenes.scene import Scene, captured_bounds
from splatrl.scenes.sources import read_scene, splat_file, splat_name
from splatrl.scenes.stated import StatedFrame, described_upright, typed_frame
from splatrl.scenes.survey import survey
from splatrl.scenes.upright import GIVEN, GUESS, UNKNOWN, Upright
from splatrl.values import require_number

ROBOT_HEIGHT = 0.4
"""Height of the robot where neither ``--height`` nor a ``scene.yaml`` states it, metres."""
PASS_SCALE = "pass --scale or --distance"
FRAME_OPTIONS = ("up", "axes", "scale", "translation", "matrix", "nerfstudio", "distance")


def run(options: argparse.Namespace) -> None:
    """Inspect a scene; errors that the user can fix end the command with one line."""
    with warnings.catch_warnings():
        warnings.showwarning = lambda message, *_: print(f"note        {message}", file=sys.stderr)
        try:
            look(options)
        except USERS as error:
            sys.exit(f"splatrl-scene: {error}")


def look(options: argparse.Namespace) -> None:
    """Print a summary of a scene, write its ``scene.yaml`` and draw its pictures."""
    for name in ("height", "resolution", "scale", "split"):
        if getattr(options, name) is not None:
            require_number(f"--{name}", getattr(options, name), above=0.0)
    path = scene_place(expanded(options.file))
    if is_in_blocks(path):
        raise ValueError(
            f"{path}: expected a splat file or a folder with {SCENE_FILE}, got a folder with {BLOCKS_FILE}"
        )
    path = splat_file(path)
    stated = typed_frame(**{name: getattr(options, name) for name in FRAME_OPTIONS})
    out = expanded(options.out or (path if path.is_dir() else path.parent))
    target = SceneFolder.at(out, options.split, options.force)
    if path.is_dir():
        look_again(options, path, target)
    else:
        look_first(options, path, stated, target)


def look_first(options: argparse.Namespace, path: Path, stated: StatedFrame, target: SceneFolder) -> None:
    """Inspect a splat file, and write the folder of its scene."""
    splat_reader(path)  # refuses what is no splat file before anything that its name would replace
    target.check(path)
    name = splat_name(path)
    kept, dropped = target.kept(path, name)
    gaussians, origin = read_centred(path)
    stated, lines = stated.beside(path)
    described = path.with_name(SCENE_FILE)
    if described.is_file() and not stated.placed and target.path.resolve() != path.parent.resolve():
        named = f"splatrl-scene {shlex.quote(str(path.parent))}"
        lines.append(f"frame       estimated, not that of {described}; to keep that, name the folder: {named}")
    if any(origin):
        placed = stated.translation is not None or stated.transform is not None
        lines.append(
            f"origin      {'of the figures below:' if placed else 'moved to'} {list(map(int, origin))} of the file"
        )
    show([*lines, survey(gaussians)])
    upright = stated.guess(gaussians, origin)
    print(upright)
    frame = stated.frame(upright)
    rounded = rounding(gaussians)
    del gaussians  # of which a large file would otherwise take twice the memory, in its own frame and upright
    world_from_splat = similarity(**frame)
    standing = read_gaussians(path, transform=world_from_splat)
    scene = Scene(kept.pop("name", name), standing, captured_bounds(standing))
    floor = floor_height(upright, world_from_splat)
    pictures = inspection.ScenePictures(target.path)
    height = options.height or ROBOT_HEIGHT
    try:
        occupancy, lines = inspection.inspect_occupancy(scene, floor, height, pictures, options.resolution)
        show(lines)
        proposed = inspection.propose(scene, occupancy, floor, height, pictures)
    except ValueError as error:
        across = max(high - low for low, high in zip(*scene.bounds, strict=True))
        advice = "check the scale that was given" if upright.units_guess.confidence == GIVEN else PASS_SCALE
        raise ValueError(f"{error}; if the scene is not {across:.3g} m across, {advice}") from error
    show(proposed.lines)
    if proposed.settings and proposed.settings.get("goal") is None:
        print("goals       none: nothing to recognise near a free place")
    proposals = {"metric": False} if upright.units_guess.confidence in (UNKNOWN, GUESS) else {}
    proposals |= proposed.settings | kept
    if stays := [*(["name"] if scene.name != name else []), *kept]:
        print(f"keeps       {', '.join(stays)} as they were; what is estimated has been replaced")
    if dropped:
        print(f"drops       {', '.join(dropped)} of the description that was there, which may be of another splat")
    if target.converts:
        show(target.write(scene, proposed.bounds, proposals, _trained(path)))
    else:
        show(target.describe(path, scene.name, frame, proposed.bounds, proposals, _trained(path)))
    if (rounded := rounded or rounding(standing)) is not None:
        print(f"not fit to train in: {rounded}")
        return
    still_to_type = {"robot_height": f"robot.height={height:g}", "goal": "'landmarks.goal=[x,y,yaw]'"}
    words = [word for key, word in still_to_type.items() if proposals.get(key) is None]
    train = " ".join(["train in it: splatrl-train", shlex.quote(f"scene={target.path}/"), *words])
    checks = _checks(upright, scene, proposals, pictures)
    print("; ".join([*checks, f"otherwise {train}" if checks else train]))


def _checks(
    upright: Upright, scene: Scene, proposals: Mapping[str, object], pictures: inspection.ScenePictures
) -> list[str]:
    """Return what to look at before one trains in a scene of which something was only guessed, one clause each."""
    checks = list[str]()
    if GUESS in (upright.axis_guess.confidence, upright.sign_guess.confidence):
        checks.append(f"look at {pictures.view(scene)}: if the place lies on its side there, or upside down, pass --up")
    if proposals.get("metric") is False:
        size = " × ".join(f"{high - low:.3g}" for low, high in zip(*scene.bounds, strict=True))
        checks.append(f"if the place is not {size} m, pass --distance or --scale")
    return checks


def look_again(options: argparse.Namespace, folder: Path, target: SceneFolder) -> None:
    """Inspect a folder that already has a ``scene.yaml``, and write it in another form if that is asked for."""
    described = read_description(folder)
    kept = dict[str, object]()
    if target.converts:
        target.check(folder, described.get("free"))
        kept, _ = target.kept(folder, described.get("name", folder.resolve().name))
    if any(getattr(options, name) is not None for name in FRAME_OPTIONS):
        raise ValueError(
            f"{folder}: expected a folder without options such as --up or --scale, got some; edit its scene.yaml, "
            "or pass the splat file instead"
        )
    scene = read_scene(folder)
    pictures = inspection.ScenePictures(target.path, described.get("antialiased", True))
    show([survey(scene.gaussians), described_upright(scene.gaussians, described.get("metric", True))])
    height = options.height or described.get("robot_height", ROBOT_HEIGHT)
    occupancy, lines = inspection.inspect_occupancy(scene, 0.0, height, pictures, options.resolution, described)
    show(lines)
    lower, upper = described.get("walk", [corner[:2] for corner in scene.bounds])
    show(inspection.inspect_terrain(scene, occupancy, (lower, upper), height, pictures))
    if target.converts:
        proposals = {key: value for key, value in (kept | described).items() if key in PROPOSALS}
        show(target.write(scene, scene.bounds, proposals, _trained(folder / described["splat"])))


def _trained(splat: Path) -> bool | None:
    """Return whether a splat was trained antialiased, as its file or nerfstudio says; None if neither does."""
    said = trained_antialiased(splat)
    return antialiased_beside(splat) if said is None else said


def show(lines: Iterable[object]) -> None:
    """Print lines."""
    for line in lines:
        print(line)


if __name__ == "__main__":
    main()
