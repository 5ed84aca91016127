"""What the slow stages find in a placed reconstruction: depths, moving things and Gaussians, each found once and kept.

Both halves of a capture ask for depths and moving things: the first to find poses without them, the second to fit the
place without them.
"""

from dataclasses import asdict
from pathlib import Path

import torch

from splatrl.capture.base import Reconstruction
from splatrl.capture.fitting.checkpoint import CHECKPOINT, Checkpoint
from splatrl.capture.fitting.fit import FitSettings, fit, trained
from splatrl.capture.fitting.pictures import frame_of
from splatrl.capture.moving import find_moving, small_fit
from splatrl.capture.progress import Progress, Say
from splatrl.capture.stages import Stages, fingerprint
from splatrl.capture.stereo import Depths, find_depths
from splatrl.capture.unchanging import left_out_at
from splatrl.native import _core
from splatrl.scenes import Gaussians, read_gaussians, write_gaussians

FITTED = "gaussians.ply"


def kept_depths(found: Reconstruction, stages: Stages, progress: Progress) -> Depths:
    """Return the depths of the photos' pixels without those that never change, found once and kept.

    Args:
        found: the photos with their poses in the world.
        stages: where results are kept.
        progress: called with the progress of the search.
    """
    rows = trained(len(found.paths))

    def find() -> dict[str, torch.Tensor]:
        depths = find_depths(found, frame_of(found.camera_to_world), rows, progress=progress)
        return {"likely": depths.likely, "known": depths.known}

    depths = Depths(**stages.arrays("depths", key_of(found), find))
    unchanged = left_out_at(found, *depths.known.shape[1:])
    return depths if unchanged is None else depths.without(unchanged.expand_as(depths.known))


def kept_moving(
    found: Reconstruction, depths: Depths, stages: Stages, settings: FitSettings, progress: Progress
) -> torch.Tensor:
    """Return where the photos show moving things, [N, H, W] bool, found once and kept.

    Args:
        found: the photos with their poses in the world.
        depths: depths of their pixels.
        stages: where results are kept.
        settings: settings of the fit that is to come.
        progress: called with the progress of the search.
    """

    def find() -> dict[str, torch.Tensor]:
        return {"moving": find_moving(found, depths, settings, progress)}

    return stages.arrays("moving", key_of(found, small_fit(settings, found.width), depths.moving), find)["moving"]


def kept_fit(
    found: Reconstruction,
    depths: Depths,
    stages: Stages,
    settings: FitSettings,
    progress: Progress,
    say: Say,
) -> Gaussians:
    """Return the Gaussians that show what the photos do, fitted once and kept; a fit that was killed resumes.

    Args:
        found: the photos with their poses in the world.
        depths: depths of their pixels, without the moving things that are masked out.
        stages: where results are kept.
        settings: settings of the fit.
        progress: called with the progress of the fit.
        say: called with a line where it continues, or begins anew.
    """
    key = key_of(found, settings, depths.moving)

    def write(made: Path) -> None:
        rounding = f"{torch.device(settings.device).type} {_core.isa()}"
        work = stages.workplace("fitting", fingerprint([key, rounding]))
        checkpoint = Checkpoint(work / CHECKPOINT, say=lambda line: say(f"fit         {line}"))

        def tell(done: int, total: int, loss: float) -> None:
            progress("fit", done, total)

        write_gaussians(made / FITTED, fit(found, settings, tell, depths, checkpoint))

    kept = stages.folder("fit", key, write)
    stages.discard("fitting")
    return read_gaussians(kept / FITTED)  # so that a second call returns the same bytes


def key_of(found: Reconstruction, settings: FitSettings | None = None, moving: torch.Tensor | None = None) -> str:
    """Return a fingerprint of everything that depths, or with settings a fit that masks moving things, depend on."""
    recipe = {} if settings is None else recipe_of(settings)
    tensors = [found.K, found.camera_to_world, found.points, found.colors, found.seen_point, found.seen_by]
    masked = [] if moving is None or not moving.any() else [moving]
    return fingerprint([recipe, found.depth_unit], tensors + masked, (*found.paths, *found.depths))


def recipe_of(settings: FitSettings) -> dict[str, object]:
    """Return what the result of a fit depends on in its settings, as JSON values."""
    return asdict(settings) | {"threads": None, "device": None}
