"""Measures the scale by the camera's height on ground that is not flat: python benchmarks/levels.py

Walks through the backyard and yards, 1.3 m above ground that is bent to steps, stairs or a slope, or that lies above a
lower place in view. Cameras and points are the true ones, with noise. Prints the errors of the scale and of up over
all places. ``--floor 0.06`` keeps this fraction of the points on the ground, as structure from motion does on a lawn.
"""

import argparse
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from record import print_markdown
from scipy import ndimage
from upright import FARTHEST, HALF, NEAREST, Floats, points_of, seen

import splatrl
from splatrl.capture.base import Reconstruction
from splatrl.capture.world import Placed, place
from splatrl.collision import Occupancy
from splatrl.evaluation.phone_walk import Stroll, camera_poses, phone_walk
from splatrl.scenes import Scene

HEIGHT, SECONDS, FPS, INSIDE = 1.3, 30, 5, 1.2
"""Height of the camera, duration and rate of the walk, and its distance from the edges of the place, metres."""
STEP_SECONDS = 0.8
"""Standard deviation of the time in which somebody climbs a step."""
FAR = 12.0
"""Farthest points from the middle, metres."""
RISES: dict[str, Callable[[Floats], Floats]] = {
    "flat": lambda x: 0.0 * x,
    "step of 0.3 m": lambda x: 0.3 * (x > 0),
    "step of 0.6 m": lambda x: 0.6 * (x > 0),
    "six stairs of 0.17 m": lambda x: 0.17 * np.clip(np.floor((x + 1) / 0.28), 0, 6),
    "slope of 7 %": lambda x: 0.07 * x,
    "slope of 16 %": lambda x: 0.16 * x,
}
LOWER = (1.5, 3.0, 6.0)
"""Depths of the places below a terrace, metres, each with a quarter as many points as the terrace."""


def walk(scene: Scene) -> Floats:
    """Return the poses [N, 4, 4] of a stroll."""
    (x, y, _), (r, b, _) = scene.bounds
    where = (x + INSIDE, y + INSIDE), (r - INSIDE, b - INSIDE)
    stroll = Stroll(*where, HEIGHT, pitch_deg=8.0, nod_deg=12.0)
    return camera_poses(phone_walk(Occupancy.from_scene(scene), stroll, SECONDS * FPS, FPS, 3)).numpy()


def placed(points: Floats, poses: Floats) -> Placed:
    """Place the cameras and the points that they see, by the camera's height."""
    points = seen(points, poses, np.random.default_rng(1))
    pairs = []
    for camera, pose in enumerate(poses):
        local = (points - pose[:3, 3]) @ pose[:3, :3]
        inside = (np.abs(local[:, :2]) < local[:, 2:] * HALF).all(1)
        rows = np.flatnonzero(inside & (local[:, 2] > NEAREST) & (local[:, 2] < FARTHEST))
        pairs.append(np.stack([rows, np.full(len(rows), camera)]))
    seen_point, seen_by = torch.from_numpy(np.concatenate(pairs, 1))
    K = torch.tensor([[465.0, 0, 320], [0, 465, 180], [0, 0, 1]]).double()
    paths, colors = [Path(f"{row}.jpg") for row in range(len(poses))], torch.zeros(len(points), 3, dtype=torch.uint8)
    cameras, seconds = torch.from_numpy(poses), torch.arange(len(poses)).double() / FPS
    found = torch.from_numpy(points)
    walked = Reconstruction(paths, 640, 360, K, cameras, found, colors, seen_point, seen_by, seconds=seconds)
    return place(walked, marker=None, camera_height=HEIGHT)


def bent(points: Floats, poses: Floats, rise: Callable[[Floats], Floats]) -> tuple[Floats, Floats]:
    """Raise the points and the cameras, which climb steps less suddenly."""
    points, poses = points.copy(), poses.copy()
    points[:, 2] += rise(points[:, 0])
    poses[:, 2, 3] += ndimage.gaussian_filter1d(rise(poses[:, 0, 3]), STEP_SECONDS * FPS)
    return points, poses


def above(points: Floats, scene: Scene, depth: float) -> Floats:
    """Open a place at one side, from where a lower one is in view."""
    (_, front, _), (right, back, _) = scene.bounds
    terrace, random = points[points[:, 0] < right - 0.4], np.random.default_rng(0)
    low, high = [right + 1, front - 3, -0.04 - depth], [right + 9, back + 3, 0.04 - depth]
    return np.concatenate([terrace, random.uniform(low, high, (len(terrace) // 4, 3))])


def main() -> None:
    """Measure, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--yards", type=int, nargs="*", default=[501, 503, 506, 507, 508, 601, 602, 603, 777])
    parser.add_argument("--floor", type=float, default=1.0, help="fraction of the ground's points to keep")
    options = parser.parse_args()
    found: dict[str, list[Placed]] = {}
    for scene in (splatrl.backyard(), *map(splatrl.yard, options.yards)):
        points, poses = points_of(scene, options.floor), walk(scene).astype(np.float64)
        points = points[np.abs(points).max(1) < FAR]
        for name, rise in RISES.items():
            found.setdefault(name, []).append(placed(*bent(points, poses, rise)))
        for depth in LOWER:
            lower = above(points, scene, depth)
            found.setdefault(f"terrace, {depth:g} m above what is in view", []).append(placed(lower, poses))
    rows = []
    for name, all_of in found.items():
        linear = [each.world_from_capture[:3, :3].numpy() for each in all_of]
        scales = [100 * (float(np.cbrt(np.linalg.det(each))) - 1) for each in linear]
        tilts = [math.degrees(math.acos(min(1.0, each[2, 2] / np.linalg.norm(each[2])))) for each in linear]
        known = [each.scale_error for each in all_of]
        within = [said is None or abs(off) < 100 * said for off, said in zip(scales, known, strict=True)]
        stated = [each.up_error_deg for each in all_of]
        upright = [said is None or off < said + 0.05 for off, said in zip(tilts, stated, strict=True)]
        rows.append(
            [
                name,
                f"{min(scales):+.0f} to {max(scales):+.0f} %",
                f"{sum(within)} of {len(within)}, {known.count(None)} unknown",
                f"{max(tilts):.1f}°",
                f"{sum(upright)} of {len(upright)}",
            ]
        )
    print_markdown(["ground", "scale", "within scale_error", "up, at most", "within up_error_deg"], rows)


if __name__ == "__main__":
    main()
