"""Measures how well up is found in films that look one way: python benchmarks/upright.py

The films are synthetic, in generated yards and the backyard: a camera moves straight ahead or sideways, looks in one
direction within some degrees, and up or down. The points of the reconstruction are the places' Gaussians in view,
hidden or not, and the whole is rotated at random. ``--floor 0.06`` keeps this fraction of the points on the ground, as
structure from motion does on a lawn, and ``--noise 0.02 --strays 0.02`` adds more noise and stray points, as in dim
films. Prints the errors of up and of the camera's height over all places and both directions of movement.
"""

import argparse
import math

import numpy as np
import torch
from numpy.typing import NDArray
from record import print_markdown
from scipy import ndimage

import splatrl
from splatrl.capture.ground import Ground, find_ground
from splatrl.evaluation.phone_walk import camera_poses
from splatrl.scenes import Scene

Floats = NDArray[np.float64]

YARDS = range(300, 312)
CAMERAS, HEIGHT, LENGTH = 150, 1.5, 3.5
"""Number of images in a film, height of the camera above the ground and length of the path, metres."""
WOBBLE, ROLL = math.radians(3.0), math.radians(1.0)
"""Standard deviations of the pitch and of the roll, radians."""
HALF = math.tan(math.radians(34.5)), math.tan(math.radians(21.1))
"""Half width and half height of the image at a depth of 1."""
NEAREST, FARTHEST, SIGHTINGS, POINTS, NOISE = 0.3, 15.0, 3, 7000, 0.004
"""Range of depths, metres; minimum number of sightings in every fifth image; maximum number of points, and their noise
relative to the distance."""
GROUND = 0.05
"""Height below which a point counts as ground, metres."""


def points_of(scene: Scene, floor: float) -> Floats:
    """Return the centres of every seventh opaque Gaussian, of those on the ground only a fraction ``floor``: [P, 3]."""
    gaussians = scene.gaussians
    middles = gaussians.means[gaussians.opacities > 0.5][::7].double().numpy()
    return middles[(middles[:, 2] > GROUND) | (np.random.default_rng(1).random(len(middles)) < floor)]


def drift(random: np.random.Generator, most: float) -> Floats:
    """Draw a slow sway about 0 with standard deviation ``most``: [CAMERAS]."""
    sway = ndimage.gaussian_filter1d(random.normal(size=CAMERAS), 6)
    return np.asarray(most * sway / sway.std())


def film(middle: Floats, spread_deg: float, pitch_deg: float, sideways: bool, random: np.random.Generator) -> Floats:
    """Return the poses [CAMERAS, 4, 4] of a straight walk past the middle of a place."""
    ahead = random.uniform(0.0, math.tau)
    way, look = (np.array([math.cos(yaw), math.sin(yaw)]) for yaw in (ahead + 0.5 * math.pi * sideways, ahead))
    along = np.linspace(-0.5, 0.5, CAMERAS)[:, None] * LENGTH
    places = middle + along * way - (1.2 if sideways else 0.35) * look
    yaw = ahead + drift(random, math.radians(spread_deg))
    pitch = math.radians(pitch_deg) + drift(random, WOBBLE)
    roll = drift(random, ROLL) + ROLL * random.normal()
    walk = np.stack([*places.T, HEIGHT + drift(random, 0.03), yaw, pitch, roll], 1)
    return camera_poses(torch.from_numpy(walk)).numpy()


def seen(
    points: Floats, poses: Floats, random: np.random.Generator, noise: float = NOISE, strays: float = 0.0
) -> Floats:
    """Return the points that several images see, with noise, and a fraction of stray points around them: [P, 3]."""
    count = np.zeros(len(points), int)
    for pose in poses[::5]:
        local = (points - pose[:3, 3]) @ pose[:3, :3]
        depth = np.maximum(local[:, 2], 1e-9)
        inside = (np.abs(local[:, :2]) < depth[:, None] * HALF).all(1)
        count += inside & (local[:, 2] > NEAREST) & (local[:, 2] < FARTHEST)
    found = points[count >= SIGHTINGS]
    found = found[random.permutation(len(found))[:POINTS]]
    near = np.linalg.norm(found[:, None] - poses[None, ::30, :3, 3], axis=2).min(1)
    low, high = found.min(0), found.max(0)
    around = random.uniform(low - 0.3 * (high - low), high + 0.3 * (high - low), (int(strays * len(found)), 3))
    return np.concatenate([found + noise * near[:, None] * random.normal(size=found.shape), around])


def errors(points: Floats, poses: Floats, random: np.random.Generator) -> tuple[float, float, Ground]:
    """Find the ground in a random frame: the error of up in degrees, the camera's relative height error, the ground."""
    turn = np.linalg.qr(random.normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    lying = poses.copy()
    lying[:, :3] = turn @ poses[:, :3]
    ground = find_ground(lying, points @ turn.T)
    above = float((lying[:, :3, 3] @ ground.up).mean()) - ground.height
    return math.degrees(math.acos(min(1.0, float(ground.up @ turn[:, 2])))), abs(above / HEIGHT - 1.0), ground


def main() -> None:
    """Measure, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--spreads", type=float, nargs="+", default=[0.5, 5.0, 25.0], help="sway of the heading, degrees"
    )
    parser.add_argument(
        "--pitches", type=float, nargs="+", default=[-10.0, 0.0, 10.0, 20.0, 30.0], help="downwards, degrees"
    )
    parser.add_argument("--floor", type=float, default=1.0, help="fraction of the ground's points to keep")
    parser.add_argument("--noise", type=float, default=NOISE, help="of the points, relative to their distance")
    parser.add_argument("--strays", type=float, default=0.0, help="stray points, as a fraction of the others")
    options = parser.parse_args()
    scenes = [splatrl.backyard(), *map(splatrl.yard, YARDS)]
    places = [(points_of(scene, options.floor), np.mean(scene.bounds, 0)[:2]) for scene in scenes]
    rows = []
    for spread in options.spreads:
        for pitch in options.pitches:
            found = []
            for number, (points, middle) in enumerate(places):
                for sideways in (False, True):
                    random = np.random.default_rng([number, sideways])
                    poses = film(middle, spread, pitch, sideways, random)
                    kept = seen(points, poses, random, options.noise, options.strays)
                    found.append(errors(kept, poses, random))
            off, height, grounds = zip(*found, strict=True)
            beyond = np.mean([up > ground.error_deg for up, ground in zip(off, grounds, strict=True)])
            by = [sum(ground.up_from == name for ground in grounds) for name in ("floor", "walls", "cameras")]
            rows.append(
                [
                    f"{spread:g}°",
                    f"{pitch:g}°",
                    f"{np.median(off):.1f}, {np.quantile(off, 0.9):.1f}, {max(off):.1f}°",
                    f"{100 * beyond:.0f} %",
                    f"{100 * np.median(height):.0f}, {100 * max(height):.0f} %",
                    ", ".join(map(str, by)),
                ]
            )
    heads = [
        "sway",
        "down",
        "up: median, 90 %, max",
        "above error_deg",
        "height: median, max",
        "by floor, walls, cameras",
    ]
    print_markdown(heads, rows)


if __name__ == "__main__":
    main()
