"""The report of a capture, ``report.html``: figures, what went wrong, and pictures, on one static page."""

import shlex
from collections.abc import Sequence
from html import escape

from splatrl.capture.area import Area
from splatrl.capture.check import Quality
from splatrl.capture.suggestions import Suggestions
from splatrl.capture.world import Placed

TITLES = {
    "held_out.png": "Held-out images: photo, render, difference",
    "map.png": "From above: the camera's path (red where it touches solid space), the walkable area (dashed), "
    "suggested goals (arrows) and the suggested position of an object (star)",
    "goals.png": "What a robot sees at the suggested goals, the first of which is in scene.yaml",
    "moving.png": "Moving things that were masked out (red), in the images that show most of them",
    "cameras.png": "Cameras and points, from above and from the side; the red line is the floor",
}
STYLE = (
    "body{font:16px/1.5 system-ui,sans-serif;max-width:70rem;margin:2rem auto;padding:0 1rem;color:#1f2328}"
    "img{max-width:100%;border:1px solid #d0d7de}td{padding:.1rem 1.5rem .1rem 0;vertical-align:top}"
    "code{background:#f6f8fa;padding:.1rem .3rem}li{color:#9a3412}"
)


def report_page(
    name: str,
    placed: Placed,
    area: Area,
    found: Suggestions,
    quality: Quality,
    notes: Sequence[str],
    pictures: Sequence[str],
) -> str:
    """Return the report as HTML without scripts, with pictures by their file names.

    Args:
        name: name of the scene.
        placed: cameras and points in the world.
        area: bounds and walkable area of the place.
        found: suggested goals and object position.
        quality: figures of the check.
        notes: what went wrong, one sentence each.
        pictures: names of the image files beside the page.
    """
    rows = "".join(
        f"<tr><td>{escape(k)}</td><td>{escape(v)}</td></tr>" for k, v in _figures(placed, area, found, quality)
    )
    wrong = "".join(f"<li>{escape(note)}</li>" for note in notes)
    shown = "".join(
        f'<h2>{escape(TITLES.get(file, file))}</h2><img src="{escape(file)}" alt="{escape(file)}">' for file in pictures
    )
    return (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{escape(name)}</title>'
        f"<style>{STYLE}</style></head><body><h1>{escape(name)}</h1>"
        f"<p>Train here: <code>splatrl-train {escape(shlex.quote(f'scene={name}/'))}</code></p>"
        f"{f'<h2>Problems and notes</h2><ul>{wrong}</ul>' if wrong else ''}<table>{rows}</table>{shown}</body></html>\n"
    )


def _figures(placed: Placed, area: Area, found: Suggestions, quality: Quality) -> list[tuple[str, str]]:
    reconstruction = placed.reconstruction
    error = placed.scale_error
    within = "error unknown" if error is None else f"within {float(f'{100 * error:.2g}'):g} %"
    upright = "error unknown" if placed.up_error_deg is None else f"within {placed.up_error_deg:.2g}°"
    (x0, y0), (x1, y1) = area.walk
    size = " × ".join(f"{high - low:.1f}" for low, high in zip(*area.bounds, strict=True))
    rows = [
        ("Cameras and points", f"{len(reconstruction.paths)} and {len(reconstruction.points)}"),
        ("Images without a pose", f"{100 * reconstruction.missing:.0f} %"),
        ("Scale from", f"{placed.scale_from.replace('_', ' ')}, {within}" if placed.metric else "unknown: not metric"),
        ("Up from", f"{placed.up_from}, {upright}"),
        ("Camera above the ground", f"{placed.camera_height:.2f} m"),
        ("Size", f"{size} m"),
        ("Walkable area", f"{x1 - x0:.1f} × {y1 - y0:.1f} m at {area.robot_height:.2f} m"),
        ("Free part of the camera's path", f"{100 * quality.path_free:.1f} %"),
        ("Solid voxels", f"{quality.solid} of {quality.voxel_size:g} m, {quality.floating} of them floaters"),
    ]
    if quality.psnr is not None and quality.psnr_corrected is not None:
        rows += [
            ("Held-out images", str(quality.held_out)),
            ("PSNR", f"{quality.psnr:.2f} dB, {quality.psnr_corrected:.2f} dB after colour correction"),
            ("SSIM", f"{quality.ssim:.3f}, {quality.ssim_corrected:.3f} after colour correction"),
        ]
    if found.goals:
        rows.append(("Suggested goals", "; ".join(f"x {x:g}, y {y:g}, yaw {yaw:g}°" for x, y, yaw in found.goals)))
    return rows
