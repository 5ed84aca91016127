"""Fixtures for tests of splatrl-capture: a made-up walk, whose stages are given or cached."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from PIL import Image

import splatrl
from splatrl.cameras import Cameras
from splatrl.capture import folder as write_folder
from splatrl.capture import kept, pipeline, placing
from splatrl.capture.base import Photos, Reconstruction
from splatrl.capture.fitting.fit import FitSettings
from splatrl.capture.fitting.pictures import Frame
from splatrl.capture.look import Look
from splatrl.capture.progress import Progress
from splatrl.capture.stereo import Depths
from splatrl.renderers import NativeRenderer
from tests.capture.walks import HEIGHT, WIDTH, K, strewn, walk

GOOD = Look(images=40, brightness=120, keypoints=800, verified=1.0, turned=0.1, shift=0.2, angle=8.0)


@pytest.fixture(scope="session")
def photographed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Photos, Reconstruction]:
    """Photos of the made-up walk at a quarter of its size, and the result of structure from motion for them."""
    folder = tmp_path_factory.mktemp("photos")
    found, _ = strewn(3)
    true = walk()
    small = K * torch.tensor([[0.25], [0.25], [1.0]])
    cameras = Cameras(true.camera_to_world.float(), small.float(), WIDTH // 4, HEIGHT // 4)
    views = NativeRenderer(splatrl.backyard().gaussians, tolerance=1.0).pixels(cameras).numpy()
    paths = [folder / path.name for path in true.paths]
    for path, view in zip(paths, views, strict=True):
        Image.fromarray(view).save(path)
    times, files = torch.arange(len(paths), dtype=torch.float64), tuple(path.name for path in paths)
    photos = Photos(paths, WIDTH // 4, HEIGHT // 4, times, files=files)
    numbers = torch.arange(len(paths))
    return photos, replace(found, paths=paths, K=small, width=WIDTH // 4, height=HEIGHT // 4, numbers=numbers)


@pytest.fixture(scope="session")
def known() -> dict[str, Any]:
    """A cache of stage results by their inputs, which are the same in nearly all captures here."""
    return {}


@pytest.fixture
def stages(
    photographed: tuple[Photos, Reconstruction], known: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> list[str]:
    """Replace stages by given or cached results; the value lists the names of the stages that were called."""
    called: list[str] = []
    photos, found = photographed

    def read_photos(source: Path, folder: Path, count: object, longest: int, progress: Progress) -> Photos:
        called.append("frames")
        progress("frames", 1, 2)
        return photos

    def find_poses(photos: Photos, folder: Path, seed: int, progress: Progress, least: float) -> Reconstruction:
        called.append("poses")
        return found

    real_depths, real_moving, real_fit, real_place = kept.find_depths, kept.find_moving, kept.fit, placing.place

    def once(key: str, find: Callable[[], Any]) -> Any:
        if key not in known:
            known[key] = find()
        return known[key]

    def place(found: Reconstruction, *settings: object, progress: Progress) -> Any:
        return once(f"{kept.key_of(found)} {settings}", lambda: real_place(found, *settings))

    def find_depths(found: Reconstruction, frame: Frame, rows: torch.Tensor, progress: Progress) -> Any:
        return once(kept.key_of(found), lambda: real_depths(found, frame, rows, progress=progress))

    def find_moving(found: Reconstruction, depths: Depths, settings: FitSettings, progress: Progress) -> Any:
        return once(kept.key_of(found, settings), lambda: real_moving(found, depths, settings, progress))

    def fit(*arguments: object) -> object:
        called.append("fit")
        return real_fit(*arguments)

    monkeypatch.setattr(pipeline, "read_photos", read_photos)
    for found_by in (find_poses, place):
        monkeypatch.setattr(placing, found_by.__name__, found_by)
    for kept_of in (find_depths, find_moving, fit):
        monkeypatch.setattr(kept, kept_of.__name__, kept_of)
    monkeypatch.setattr(pipeline, "look", lambda photos, progress: GOOD)
    return called


@pytest.fixture
def fitted_once(stages: list[str], known: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    """Cache fits too, for tests of what follows the fit."""
    fitted = kept.fit

    def fit(found: Reconstruction, settings: FitSettings, *others: Any) -> object:
        key = f"fit {kept.key_of(found, settings)}"
        if key not in known:
            known[key] = fitted(found, settings, *others)
        return known[key]

    monkeypatch.setattr(kept, "fit", fit)


@pytest.fixture
def unchecked(bare_report: None, known: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    """Remove no floaters, and reuse the area, suggestions and quality of the first capture in all others, for tests
    that look at none of these."""

    def first(name: str, find: Callable[..., object]) -> Callable[..., object]:
        def found(*arguments: object) -> object:
            if name not in known:
                known[name] = find(*arguments)
            return known[name]

        return found

    monkeypatch.setattr(pipeline, "dense_voxels", lambda *_: None)
    monkeypatch.setattr(pipeline, "without_floaters", lambda gaussians, *_: (gaussians, 0))
    for name in ("survey_area", "suggest", "check"):
        monkeypatch.setattr(write_folder, name, first(name, getattr(write_folder, name)))
