"""Last stage: write a folder that is a scene to train in, with a report, completely or not at all."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from torch import Tensor

from splatrl.capture.area import SOLID, Area, survey_area
from splatrl.capture.check import COMPARISON, MAP, Quality, check
from splatrl.capture.drift import below_floor, leap, lost_scale, weak_scale
from splatrl.capture.lattice import remarks
from splatrl.capture.masks import much_moves
from splatrl.capture.page import report_page
from splatrl.capture.pictures import GOALS, draw_cameras, draw_goals, draw_moving
from splatrl.capture.progress import Progress, silent
from splatrl.capture.suggestions import Suggestions, place_proposals, seen_by_cameras, suggest
from splatrl.capture.world import Placed
from splatrl.collision.point_clouds import write_points
from splatrl.scenes import read_gaussians, write_gaussians
from splatrl.scenes.description import PATH, SCENE_FILE, SMALL_SPLAT, SPLAT, check_absent, write_description
from splatrl.scenes.gaussians import Gaussians
from splatrl.scenes.whole import whole_scene

FREE, REPORT, CAMERAS, MOVING = "free.ply", "report.html", "cameras.png", "moving.png"
NOT_IN_ALL = (SPLAT, SMALL_SPLAT, FREE, PATH, MOVING)
"""Files that not every capture has; those of an earlier one are removed."""
GOOD_PATH, GOOD_PSNR, FEW_FLOATERS, MOST_MISSING = 0.97, 22.0, 0.005, 0.1
"""Minimum free fraction of the path, minimum PSNR in dB, and maximum fractions of floating voxels and of images without
a pose; the report of a worse capture says so."""
LEFT_OUT = (
    "{} of the image area shows moving things and was masked out (red in moving.png); held-out images still show "
    "them, which lowers their scores."
)
FRAME: dict[str, Any] = {"axes": ["x", "y", "z"], "scale": 1.0, "translation": [0.0, 0.0, 0.0]}


def write_scene(
    folder: Path,
    gaussians: Gaussians,
    placed: Placed,
    held_out: Sequence[int] = (),
    notes: Sequence[str] = (),
    force: bool = False,
    known: Tensor | None = None,
    splat: str = SPLAT,
    moving: Tensor | None = None,
    work: Path | None = None,
    progress: Progress = silent,
) -> Quality:
    """Check a fitted capture and write it as a scene folder: splat, ``scene.yaml``, report and pictures.

    Args:
        folder: the folder to write; anything else in it stays.
        gaussians: the fitted Gaussians, world frame.
        placed: cameras and points in the world.
        held_out: indices of the images that were never fitted.
        notes: remarks of earlier stages for the report, one sentence each.
        force: whether to replace an existing ``scene.yaml``.
        known: [N, h, w] depths of the photos' pixels, metres, 0 where unknown; None where no depth is known.
        splat: name of the splat file; ``.spz`` is small, and rounds.
        moving: [N, h, w] bool, pixels of the photos that show moving things and were left out; None where unknown.
        work: folder on the same disk in which the scene is made before its files move, where ``remove_stale`` removes
            what a killed process left; None takes the parent of ``folder``.
        progress: called for every held-out image.

    Raises:
        CaptureError: for a held-out image that cannot be read.
        FileExistsError: for an existing ``scene.yaml``, without ``force``.
    """
    name = folder.resolve().name
    check_absent(folder / SCENE_FILE, force)
    progress("check", 0, len(held_out))
    work = work or folder.parent
    work.mkdir(parents=True, exist_ok=True)
    with whole_scene(folder, work, SCENE_FILE, NOT_IN_ALL) as fresh:
        write_gaussians(fresh / splat, gaussians, antialiased=True)
        gaussians = read_gaussians(fresh / splat)  # check exactly what was written
        area = survey_area(gaussians, placed, known)
        seen = seen_by_cameras(placed)
        found = suggest(seen, area)
        quality = check(gaussians, placed, held_out, fresh, area, found, progress)
        missed = remarks(area.ground(seen.path), area.walk, area.spacing)
        quality = replace(quality, problems=(*problems(placed, found, quality, moving), *missed))
        draw_cameras(placed, area, fresh / CAMERAS)
        if found.goals:
            draw_goals(gaussians, found.goals, area.robot_height, fresh / GOALS)
        if moving is not None and moving.any():
            draw_moving(placed.reconstruction.paths, moving, fresh / MOVING)
            notes = [*notes, LEFT_OUT.format(share_of(moving))]
        if area.free.count:
            write_points(fresh / FREE, area.free.centers())
        write_points(fresh / PATH, placed.reconstruction.camera_to_world[:, :3, 3].float().numpy())
        proposals = _proposals(placed, area, found, quality)
        write_description(fresh, splat, name, FRAME, area.bounds, proposals=proposals)
        pictures = [file for file in (COMPARISON, MAP, GOALS, CAMERAS, MOVING) if (fresh / file).exists()]
        page = report_page(name, placed, area, found, quality, [*notes, *quality.problems], pictures)
        (fresh / REPORT).write_text(page, encoding="utf-8")
    return quality


def share_of(moving: Tensor) -> str:
    """Return the percentage of photos' pixels, [N, H, W] bool, that show moving things, as text."""
    return f"{100 * float(moving.float().mean()):.2g} %"


def problems(placed: Placed, found: Suggestions, quality: Quality, moving: Tensor | None = None) -> list[str]:
    """List what is wrong with a capture, one sentence each; empty for a good one."""
    missing, floating = placed.reconstruction.missing, quality.floating / max(quality.solid, 1)
    corrected, error_deg = quality.psnr_corrected, placed.up_error_deg
    moved = None if moving is None or not much_moves(moving) else share_of(moving)
    tilt = "any angle" if error_deg is None else f"{error_deg:.0f}°"
    checks = {
        "It is not metric: its scale is unknown. Film a printed marker, or state a distance or the camera's height; "
        "until then, lengths assume that the camera was 1.5 m above the floor.": not placed.metric,
        "The up direction comes from how the camera was held, because neither floor nor walls tell it clearly: "
        f"it may be off by {tilt}, and the floor may be lower.": placed.up_from == "cameras",
        "Its scale may be far off: it rests on a floor that was hardly seen, or on parts that may be joined wrongly. "
        "Film a printed marker, or measure a distance in the scene.": placed.metric
        and placed.scale_error is None
        and placed.contradicted is None
        and placed.doubt is None,
        "GPS positions of the photos do not give the scale: there are fewer than five, or they do not fit the camera's "
        "path.": not placed.metric and placed.reconstruction.gps is not None,
        f"{100 * missing:.0f} % of the images have no pose, among them {', '.join(placed.reconstruction.lost)}.": (
            missing > MOST_MISSING
        ),
        f"{100 * (1 - quality.path_free):.0f} % of the camera's path runs through solid space (red in the map).": (
            quality.path_free < GOOD_PATH
        ),
        f"{quality.floating} of {quality.solid} solid voxels are floaters: cameras saw through them.": (
            floating > FEW_FLOATERS
        ),
        f"Held-out images are rendered at only {corrected or 0:.1f} dB, colours corrected: they look poor.": corrected
        is not None
        and corrected < GOOD_PSNR,
        "No image was held out, so the image quality is unknown.": quality.held_out == 0,
        f"People or things that move fill {moved} of the image area: they may have bent the camera's path. Film with "
        "nobody in view for long, or with everyone behind the camera.": moved is not None,
        "No free pose with something to see was found on the path: set landmarks.goal yourself.": not found.goals,
    }
    serious = [
        said
        for said in (
            leap(placed),
            below_floor(placed),
            lost_scale(placed),
            weak_scale(placed),
            placed.contradicted,
            placed.doubt,
        )
        if said
    ]
    return [*serious, *(text for text, wrong in checks.items() if wrong)]


def _proposals(placed: Placed, area: Area, found: Suggestions, quality: Quality) -> dict[str, Any]:
    error, error_deg = placed.scale_error, placed.up_error_deg
    return {
        "metric": placed.metric,
        **place_proposals(area, found),
        "cutoff": SOLID.cutoff,
        "free": FREE if area.free.count else None,
        "quality": {
            "scale_from": placed.scale_from,
            "scale_error": None if error is None else float(f"{error:.2g}"),
            "up_from": placed.up_from,
            "up_error_deg": None if error_deg is None else float(f"{error_deg:.2g}"),
            **quality.figures(),
        },
    }
