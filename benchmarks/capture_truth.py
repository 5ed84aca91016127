"""Tests whether a capture is solid where the place is: its depth and free space against ground truth of two places.

    splatrl-capture SCENES/videos/redkitchen/video.mp4 --out red --camera-height 1.3
    python benchmarks/capture_truth.py redkitchen red
    splatrl-capture SCENES/videos/kitchen_m.mp4 --out kitchen
    python benchmarks/capture_truth.py kitchen kitchen
    splatrl-capture SCENES/videos/backyard_m.mp4 --out yard
    python benchmarks/capture_truth.py backyard yard

The capture is aligned with the truth by the similarity that fits its cameras best. Nothing else of the truth is used,
so the source of the capture's scale does not matter.

redkitchen is compared with the images of a depth sensor. AbsRel is the mean of |depth − sensor's| / sensor's over all
pixels that the sensor measured. Free space consists of the voxels of the capture that at least three of the sensor's
images look through, ending 10 cm and 5 % before the measured depth (whichever is more), and that are more than a voxel
away from everything that any image measured. Recall is that of a 0.1 m cube centred on places that the sensor measured.

kitchen is compared with hand-made boxes, backyard with those of its generator. False hits are those of a 0.1 m cube in
the free middle, recall is that of a 0.2 m cube centred on known surfaces that at least two cameras of the capture saw.
Starts are the poses in which ``splatrl-train`` lets a robot begin whose body's centre is ``--height`` above the floor.
They touch something where its body meets solid voxels of the true scene, of 2 cm, and do so deeply where it still does
when 10 cm narrower on every side.
"""

import argparse
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from occupancy_truth import Truth, kitchen_truth, yard_truth
from PIL import Image
from scenes import SCENES
from scipy import ndimage
from torch import Tensor

from splatrl.bodies import Box
from splatrl.building import build_one_world
from splatrl.cameras import Cameras, depths_at
from splatrl.capture.base import Reconstruction
from splatrl.capture.pipeline import reconstruct
from splatrl.capture.settings import CaptureSettings
from splatrl.capture.truth import closest_similarity, read_truth, true_poses
from splatrl.capture.world import Placed, moved
from splatrl.collision import DensitySettings, NativeChecker, Occupancy
from splatrl.collision.point_clouds import read_points
from splatrl.configuration import load_config
from splatrl.geometry import rigid
from splatrl.renderers import NativeRenderer
from splatrl.scenes import Scene, read_scene
from splatrl.scenes.description import PATH, read_description

SMALL, LARGE = Box((0.1, 0.1, 0.1)), Box((0.2, 0.2, 0.2))
VIDEOS = {
    "redkitchen": SCENES / "videos" / "redkitchen" / "video.mp4",
    "kitchen": SCENES / "videos" / "kitchen_m.mp4",
    "backyard": SCENES / "videos" / "backyard_m.mp4",
}
BODY, DEEP, FINE = (0.4, 0.4, 0.1), 0.1, 0.02
"""Body of the robot whose starts are tested, by how much narrower on every side it is for a deep touch, and the edge of
the true scene's voxels, metres."""
POSES = 20_000
SENSOR_K = torch.tensor([[585.0, 0, 320], [0, 585, 240], [0, 0, 1]], dtype=torch.float64)
NO_DEPTH = 65535
BEFORE, BEFORE_SHARE, LOOKS = 0.1, 0.05, 3
FRAMES_A_SECOND = 30.0
AGREES = 0.03
"""Maximum relative deviation of the depth at which a camera counts as seeing a place."""


def aligned(placed: Placed, true: Tensor) -> tuple[Tensor, float]:
    """Return the similarity [4, 4] that aligns a capture with its cameras' true poses [N, 4, 4], and its scale."""
    to_truth = closest_similarity(placed.reconstruction.camera_to_world[:, :3, 3], true[:, :3, 3])
    return to_truth, float(to_truth[:3, :3].det() ** (1 / 3))


def redkitchen(scene: Scene, occupancy: Occupancy, placed: Placed) -> dict[str, float]:
    """Compare depth and free space with the sensor's."""
    folder = VIDEOS["redkitchen"].parent
    truth = torch.from_numpy(np.load(folder / "truth.npz")["camera_to_world"]).double()
    taken = (placed.reconstruction.seconds * FRAMES_A_SECOND).round().long().clamp_max(len(truth) - 1)
    to_truth, scale = aligned(placed, truth[taken])
    depths, poses = [], []
    for path in sorted((folder / "depth").glob("*.png")):
        depth = np.asarray(Image.open(path)).astype(np.float64)
        depth[depth == NO_DEPTH] = 0
        pose = to_truth.inverse() @ truth[int("".join(filter(str.isdigit, path.stem)))]
        pose[:3, :3] *= scale
        depths.append(torch.from_numpy(depth / 1000 / scale))
        poses.append(pose)
    measured, cameras_to_world = torch.stack(depths), torch.stack(poses)
    cameras = Cameras(cameras_to_world.float(), SENSOR_K.float(), 640, 480)
    renderer = NativeRenderer(scene)
    drawn = torch.cat([renderer.render(cameras[row : row + 1]).depth for row in range(len(measured))])
    known = measured > 0
    away = ((drawn - measured).abs() / measured.clamp_min(1e-6))[known]
    free = looked_through(occupancy, cameras_to_world, measured, scale)
    surface = measured_places(cameras_to_world, measured)
    return {
        "AbsRel": float(away.mean()),
        "AbsRel, median": float(away.median()),
        "off by more than a quarter": float((away > 0.25).double().mean()),
        "free voxels": float(free.sum()),
        "of these occupied": float(occupancy.occupied[free].mean()),
        "recall": share_hit(occupancy, surface, SMALL, torch.eye(3), scale),
    }


def measured_places(poses: Tensor, measured: Tensor) -> Tensor:
    """Draw places [P, 3] that a depth sensor measured, equally many per image, with a fixed seed."""
    generator, places = torch.Generator().manual_seed(0), []
    for pose, depth in zip(poses, measured, strict=True):
        pixels = depth.nonzero()
        down, across = pixels[torch.randint(len(pixels), (POSES // len(poses),), generator=generator)].unbind(1)
        seen = torch.stack([across, down, torch.ones_like(down)], 1).double()
        rays = seen @ SENSOR_K.inverse().T
        places.append(depth[down, across, None] * rays @ pose[:3, :3].T + pose[:3, 3])
    return torch.cat(places)


def share_hit(occupancy: Occupancy, places: Tensor, cube: Box, turn: Tensor, scale: float) -> float:
    """Return the fraction of a capture's places [P, 3] where a cube, sized in true metres, touches solid voxels."""
    checker = NativeChecker(occupancy, Box(tuple(side / scale for side in cube.size)))
    poses = rigid(turn.expand(len(places), 3, 3), places.float())
    return float(checker.collides(poses).double().mean())


def looked_through(occupancy: Occupancy, poses: Tensor, measured: Tensor, scale: float) -> NDArray[np.bool_]:
    """Return the mask of an occupancy's voxels that a depth sensor's images show to be free."""
    shape, edge = occupancy.occupied.shape, occupancy.resolution
    grid = np.stack(np.meshgrid(*[np.arange(n) for n in shape], indexing="ij"), -1).reshape(-1, 3)
    places = torch.from_numpy((grid + occupancy.origin_key + 0.5) * edge)
    looks, touched = torch.zeros(len(places), dtype=torch.int64), torch.zeros(len(places), dtype=torch.bool)
    for pose, depth in zip(poses, measured, strict=True):
        x, y, z = ((places - pose[:3, 3]) @ pose[:3, :3]).unbind(1)
        across = (SENSOR_K[0, 0] * x / z + SENSOR_K[0, 2]).long()
        down = (SENSOR_K[1, 1] * y / z + SENSOR_K[1, 2]).long()
        inside = (z > 0.1) & (across >= 0) & (across < 640) & (down >= 0) & (down < 480)
        far = torch.where(inside, depth[down.clamp(0, 479), across.clamp(0, 639)], 0.0)
        looks += (far > 0) & (z < far - torch.maximum(torch.tensor(BEFORE / scale), BEFORE_SHARE * far))
        touched |= (far > 0) & ((z - far).abs() < edge)
    near = ndimage.binary_dilation(touched.numpy().reshape(shape), np.ones((3, 3, 3), bool))
    free: NDArray[np.bool_] = (looks >= LOOKS).numpy().reshape(shape) & ~near
    return free


def among_boxes(truth: Truth, video: Path, occupancy: Occupancy, placed: Placed, starts: Tensor) -> dict[str, float]:
    """Compare the occupancy, and a robot's first poses [N, 4, 4], with a scene whose solid parts are known."""
    to_truth, scale = aligned(placed, true_poses(placed.reconstruction, read_truth(video)))
    from_truth = to_truth.inverse()
    surface = truth.surface(POSES)
    surface = surface[seen(truth.scene, surface.double(), moved(placed.reconstruction, to_truth.numpy())) >= 2]
    turn = (from_truth[:3, :3] * scale).float()

    def hit(places: Tensor, cube: Box) -> float:
        return share_hit(occupancy, places.double() @ from_truth[:3, :3].T + from_truth[:3, 3], cube, turn, scale)

    real = Occupancy.from_scene(truth.scene, resolution=FINE)
    places = starts[:, :3, 3].double() @ to_truth[:3, :3].T + to_truth[:3, 3]
    begun = rigid(turn.T @ starts[:, :3, :3], places.float())

    def touch(narrower: float) -> float:
        length, width, height = (scale * side for side in BODY)
        body = Box((length - 2 * narrower, width - 2 * narrower, height))
        return float(NativeChecker(real, body).collides(begun).double().mean())

    return {
        "false hits": hit(truth.free(POSES), SMALL),
        "recall": hit(surface, LARGE),
        "surface seen": len(surface) / len(truth.surface(POSES)),
        "starts": len(starts),
        "starts that touch something": touch(0.0),
        "starts that touch it deeply": touch(DEEP),
    }


def starting_poses(folder: Path, height: float, cutoff: float) -> Tensor:
    """Return the poses [N, 4, 4] in a capture's world in which training lets a robot of this height begin."""
    words = [f"scene={folder.resolve()}", f"robot.height={height}", f"collision.occupancy.density.cutoff={cutoff}"]
    world = build_one_world(load_config(words))
    return world.task.motion.body_to_world(world.plan.starts)


def seen(scene: Scene, places: Tensor, capture: Reconstruction) -> Tensor:
    """Count, for each place [N, 3] of a scene, the cameras of a capture that see it."""
    renderer, count = NativeRenderer(scene), torch.zeros(len(places), dtype=torch.int64)
    for pose in capture.camera_to_world:
        view = renderer.render(Cameras(pose[None].float(), capture.K.float(), capture.width, capture.height))
        z, found = depths_at(places, view.depth[0], pose, capture.K, 0.05)
        count += (found > 0) & ((found - z).abs() < AGREES * z)
    return count


def captured(place: str, folder: Path) -> Placed:
    """Return the cameras of a capture in the frame and scale of its finished scene."""
    placed, _ = reconstruct(VIDEOS[place], folder, CaptureSettings(still=True))
    to_scene = closest_similarity(
        placed.reconstruction.camera_to_world[:, :3, 3], torch.from_numpy(read_points(folder / PATH))
    )
    return replace(placed, reconstruction=moved(placed.reconstruction, to_scene.numpy()))


def main() -> None:
    """Measure, and print the results as JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("place", choices=list(VIDEOS))
    parser.add_argument("folder", type=Path, help="folder of the capture of that place's video")
    parser.add_argument("--cutoff", type=float, help="fraction of light that solid voxels absorb; default scene.yaml's")
    parser.add_argument("--height", type=float, default=0.3, help="height of the robot whose starts are tested, metres")
    arguments = parser.parse_args()
    placed = captured(arguments.place, arguments.folder)
    scene = read_scene(arguments.folder)
    stated = read_description(arguments.folder)
    cutoff = arguments.cutoff or stated["cutoff"]
    occupancy = Occupancy.from_scene(scene, resolution=stated["voxel_size"], density=DensitySettings(cutoff=cutoff))
    if arguments.place == "redkitchen":
        found = redkitchen(scene, occupancy, placed)
    else:
        truth = kitchen_truth() if arguments.place == "kitchen" else yard_truth()
        assert truth is not None
        starts = starting_poses(arguments.folder, arguments.height, cutoff)
        found = among_boxes(truth, VIDEOS[arguments.place], occupancy, placed, starts)
    print(json.dumps({name: round(value, 5) for name, value in found.items()}, indent=1))


if __name__ == "__main__":
    main()
