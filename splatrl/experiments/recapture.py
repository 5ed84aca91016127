"""Recaptures a scene: a simulated phone films a walk through it, and the film is captured as a new scene.

The new scene is aligned with the original by the true camera poses, once, so that goals and starts mean the same
places in both. The ground truth is used for nothing else.
"""

import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image
from torch import Tensor

from splatrl.building import build_one_world
from splatrl.capture.area import SOLID
from splatrl.capture.base import CaptureError
from splatrl.capture.check import Quality, colour_corrected, psnr
from splatrl.capture.folder import FREE, SPLAT
from splatrl.capture.pipeline import build_scene, reconstruct
from splatrl.capture.poses import check_libraries
from splatrl.capture.progress import Progress
from splatrl.capture.settings import CaptureSettings
from splatrl.capture.truth import Deviation, deviation, read_truth
from splatrl.collision import Occupancy
from splatrl.collision.point_clouds import read_points, write_points
from splatrl.configuration import load_config
from splatrl.documents import write_json
from splatrl.envs.world import World
from splatrl.evaluation.phone_video import Phone, phone_video
from splatrl.evaluation.phone_walk import Stroll, phone_walk
from splatrl.evaluation.starts import spread
from splatrl.experiments.report import FIGURES, VIEWS
from splatrl.files import new_folder, replacing
from splatrl.renderers import NativeRenderer
from splatrl.scenes.description import SCENE_FILE, read_description, write_description
from splatrl.scenes.placement import matrix_frame
from splatrl.scenes.scene import Bounds
from splatrl.waits import Bar

FILM, CAPTURED, RECAPTURED = "walk.mp4", "captured", "recaptured"
PHONE = Phone(960, 540)
SECONDS = 60.0
BESIDE = 0.8
"""Margin around the robots' area within which the walk stays, metres."""
ABOVE, RISE = 0.1, 0.2
"""Mean height of the camera above the robots' camera, and how far it is raised and lowered from there, metres."""
TURN = 12.0
"""Seconds per full turn of the view, so that a one-minute walk sees solid things from all sides."""
BORDER = 12
"""Margin around a scene's bounds, in voxels, within which free voxels are recorded too."""
TASK = "task=grid"
SEEN, SHOWN = 256, 8
"""Number of poses from which the two scenes are compared, and number of these that are shown."""


@dataclass(frozen=True)
class Agreement:
    """Similarity of two scenes from a robot's perspective.

    Attributes:
        psnr: mean PSNR between the robots' views from starts that both scenes share, dB.
        psnr_corrected: the same after fitting the colours of the other scene's views to the original's.
        blocked: fraction of the original's starts that are not starts in the other scene.
        opened: fraction of the other scene's starts that are not starts in the original.
    """

    psnr: float
    psnr_corrected: float
    blocked: float
    opened: float


def recapture(folder: Path, scenes: Mapping[str, Sequence[str]], original: str = "backyard") -> Path:
    """Film a scene, capture the film, and align the captured scene with the original, unless this was done before.

    Args:
        folder: folder for the film, the capture, the scene ``recaptured``, and the figures and views for the report.
        scenes: overrides of scenes, by name.
        original: name of the scene to film.

    Returns:
        The folder of the captured scene, whose ``scene.yaml`` has the original's bounds, goal, robot height and area.

    Raises:
        CaptureError: if the film cannot be captured.
        ImportError: without the extra ``capture``.
        ValueError: if the original leaves no room for the walk.
    """
    target = folder / RECAPTURED
    if (target / SCENE_FILE).is_file() and (folder / FIGURES).is_file():
        return target
    check_libraries()
    folder.mkdir(parents=True, exist_ok=True)
    cfg = load_config([*scenes[original], TASK])
    world = build_one_world(cfg)
    film = _film(world, folder / FILM)
    truth = read_truth(film)
    height = float(truth.camera_to_world[:, 2, 3].mean() - world.scene.bounds[0][2])
    settings = CaptureSettings(camera_height=height, force=True)
    with _bar() as progress:
        placed, notes = reconstruct(film, folder / CAPTURED, settings, progress, Bar.write)
        quality = build_scene(placed, folder / CAPTURED, settings, notes, progress, Bar.write)
    off = deviation(placed, truth, PHONE.width)
    shutil.rmtree(target, ignore_errors=True)
    with new_folder(target) as made:
        shutil.copy(folder / CAPTURED / SPLAT, made / SPLAT)
        edge = float(cfg.collision.occupancy.resolution)
        _lay_free_voxels(folder / CAPTURED, made, off.world_from_capture, world.scene.bounds, edge)
        proposals = {
            "robot_height": float(cfg.robot.height),
            "voxel_size": edge,
            "cutoff": SOLID.cutoff,
            "free": FREE if (made / FREE).exists() else None,
            "walk": [[float(value) for value in corner] for corner in (cfg.task.motion.lower, cfg.task.motion.upper)],
            "goal": [float(value) for value in cfg.landmarks.goal],
            "object": [float(value) for value in cfg.landmarks.object],
        }
        frame = matrix_frame(off.world_from_capture)
        write_description(made, SPLAT, RECAPTURED, frame, world.scene.bounds, proposals=proposals)
    cfg.scene = load_config([f"scene={target}", TASK]).scene
    cfg.collision.occupancy.density.cutoff = SOLID.cutoff
    alike = compare(world, build_one_world(cfg), folder / VIEWS)
    write_json(folder / FIGURES, {"figures": _figures(placed.reconstruction.missing, off, quality, alike)})
    return target


def _lay_free_voxels(capture: Path, target: Path, world_from_capture: Tensor, bounds: Bounds, edge: float) -> None:
    """Write the world's voxels whose centres a capture knows to be free; write no file if it knows of none."""
    stated = read_description(capture)
    if "free" not in stated:
        return
    free = Occupancy.from_points(read_points(capture / stated["free"]), float(stated["voxel_size"]))
    first, last = (np.floor(np.array(corner) / edge).astype(int) for corner in bounds)
    axes = [np.arange(low - BORDER, high + 1 + BORDER) for low, high in zip(first, last, strict=True)]
    centers = (np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3) + 0.5) * edge
    inverse = torch.linalg.inv(world_from_capture).numpy()
    known = free.contains(centers @ inverse[:3, :3].T + inverse[:3, 3])
    if known.any():
        write_points(target / FREE, centers[known].astype(np.float32))


def _film(world: World, path: Path) -> Path:
    """Film a walk around the robots' area, unless film and ground truth exist already."""
    motion = world.task.motion
    places = motion.body_to_world(motion.states())[:, :3, 3]
    lower, upper = (places[:, :2].amin(0) - BESIDE).tolist(), (places[:, :2].amax(0) + BESIDE).tolist()
    height = float(places[0, 2]) + ABOVE
    stroll = Stroll((lower[0], lower[1]), (upper[0], upper[1]), height, RISE, turn=TURN)
    if not (path.is_file() and path.with_suffix(".npz").is_file()):
        walk = phone_walk(Occupancy.from_scene(world.scene), stroll, round(SECONDS * PHONE.fps), PHONE.fps)
        with _bar() as progress:
            phone_video(NativeRenderer(world.scene), walk, PHONE, path, 0, lambda *now: progress("film", *now))
    return path


def compare(original: World, other: World, path: Path) -> Agreement:
    """Compare the robots' views and starts in two scenes, and write a picture of some views, one row per scene."""
    starts = {tuple(state) for state in original.plan.starts.tolist()}
    others = {tuple(state) for state in other.plan.starts.tolist()}
    both = torch.tensor(sorted(starts & others))
    if len(both) == 0:
        raise CaptureError("recaptured: expected starts that are free in the original too, got none")
    states = both[spread(torch.arange(len(both)), SEEN)]
    views = [_views(world, states) for world in (original, other)]
    pairs = [(b / 255.0, a / 255.0) for a, b in zip(*(view.double().numpy() for view in views), strict=True)]
    shown = spread(torch.arange(len(states)), SHOWN)
    page = torch.cat([view[shown].movedim(0, 1).flatten(1, 2) for view in views])
    with replacing(path) as stream:
        image = Image.fromarray(page.numpy())
        image.resize((2 * image.width, 2 * image.height), Image.Resampling.NEAREST).save(stream, "PNG")
    return Agreement(
        psnr=float(np.mean([psnr(*pair) for pair in pairs])),
        psnr_corrected=float(np.mean([psnr(colour_corrected(*pair), pair[1]) for pair in pairs])),
        blocked=len(starts - others) / len(starts),
        opened=len(others - starts) / len(others),
    )


def _views(world: World, states: Tensor) -> Tensor:
    cameras = world.robot.cameras(world.task.motion.body_to_world(states))
    return NativeRenderer(world.scene).pixels(cameras)


def _figures(missing: float, off: Deviation, quality: Quality, alike: Agreement) -> dict[str, Any]:
    return {
        "images_without_a_pose": missing,
        "cameras_metres": off.metres,
        "cameras_share_of_path": off.path,
        "up_deg": off.up_deg,
        "scale": off.scale,
        "held_out_psnr_corrected": quality.psnr_corrected,
        "path_free": quality.path_free,
        **asdict(alike),
    }


@contextmanager
def _bar() -> Iterator[Progress]:
    """Provide one progress bar, shared by activities that run one after another."""
    with Bar(leave=False) as bar:

        def progress(what: str, done: int, total: int) -> None:
            bar.total = total
            bar.set_description(what, refresh=False)
            bar.update(done - bar.n)

        yield progress
