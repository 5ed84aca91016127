"""A film that is zoomed, or changes its lens, is told from one of a single lens."""

from dataclasses import replace
from itertools import chain
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from splatrl.array_files import read_arrays
from splatrl.cameras import look_at
from splatrl.capture import pipeline, placing
from splatrl.capture.base import CaptureError, Photos, Reconstruction
from splatrl.capture.pipeline import reconstruct
from splatrl.capture.settings import CaptureSettings
from splatrl.capture.sfm.job import Job
from splatrl.capture.sfm.structure import MODEL, _keep
from splatrl.capture.sfm.zoom import CLOSE, PART, REFUSED, _parts, focal_lengths, zoomed
from tests.capture.walks import ABOVE, walk

pycolmap = pytest.importorskip("pycolmap")

COUNT, SIZE = 40, (480, 270)
SECONDS = (torch.arange(COUNT) / 4).double()


def seen_from_a_circle(focal: np.ndarray) -> tuple[Any, Job]:
    """Return COLMAP's model of a film with a common focal length of 400 pixels, where each image really has its own."""
    rng = np.random.default_rng(0)
    points, turns = rng.uniform(-1.0, 1.0, (500, 3)), np.linspace(0.0, 4.0, COUNT)
    model, tracks = pycolmap.Reconstruction(), [pycolmap.Track() for _ in points]
    camera = pycolmap.Camera(model="RADIAL", width=SIZE[0], height=SIZE[1], camera_id=1)
    camera.params = [400.0, SIZE[0] / 2, SIZE[1] / 2, 0.0, 0.0]
    model.add_camera_with_trivial_rig(camera)
    for number, turn in enumerate(turns.tolist()):
        eye = [4.0 * np.cos(turn), 4.0 * np.sin(turn), 0.4 * np.sin(3 * turn)]
        world_to_camera = np.linalg.inv(look_at(eye, [0.0, 0.0, 0.0]).double().numpy())
        local = points @ world_to_camera[:3, :3].T + world_to_camera[:3, 3]
        pixels = focal[number] * local[:, :2] / local[:, 2:] + np.array(SIZE) / 2 + rng.normal(0.0, 0.3, (500, 2))
        rows = np.flatnonzero(((pixels > 0) & (pixels < SIZE)).all(1)).tolist()
        image = pycolmap.Image(name=f"{number:04}.jpg", camera_id=1, image_id=number + 1)
        image.points2D = pycolmap.Point2DList([pycolmap.Point2D(pixels[row]) for row in rows])
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(world_to_camera[:3]))
        for place, row in enumerate(rows):
            tracks[row].add_element(number + 1, place)
    for point, track in zip(points, tracks, strict=True):
        model.add_point3D(point, track)
    return model, Job("", [f"{number:04}.jpg" for number in range(COUNT)], *SIZE, seconds=SECONDS.tolist())


@pytest.mark.parametrize("cuts", [(), (4.75,)])
def test_each_part_of_a_film_has_its_focal_length_and_a_change_is_said_with_its_time(
    cuts: tuple[float, ...], tmp_path: Path
) -> None:
    true = np.where(np.arange(COUNT) < 19, 350.0, 560.0)
    model, job = seen_from_a_circle(true)
    _keep(tmp_path, job, model, focal_lengths(pycolmap, model, replace(job, cuts=cuts)))
    focal = torch.from_numpy(read_arrays(tmp_path / MODEL)["focal_lengths"])
    np.testing.assert_allclose(focal / focal[0], true / true[0], rtol=0.03)
    np.testing.assert_allclose(focal, true, rtol=0.03)
    assert next(iter(model.cameras.values())).focal_length == 400.0, "the model stays as it was"
    said = str(zoomed(replace(walk(), seconds=SECONDS, focal_lengths=focal)))
    assert "the focal length changes by 6" in said and "at about 5 s" in said


def test_a_film_of_one_lens_is_not_zoomed() -> None:
    model, job = seen_from_a_circle(np.full(COUNT, 400.0))
    pycolmap.bundle_adjustment(model, pycolmap.BundleAdjustmentOptions(print_summary=False))
    common = next(iter(model.cameras.values())).focal_length
    assert set(focal_lengths(pycolmap, model, job).values()) == {common}
    assert zoomed(replace(walk(), seconds=SECONDS, focal_lengths=torch.full((COUNT,), 400.0))) is None
    assert zoomed(walk()) is None


def test_a_zoom_of_a_second_is_found_and_nothing_else_of_the_film_counts_as_zoomed() -> None:
    first, last = 18, 23
    zooms = (np.arange(COUNT) >= first) & (np.arange(COUNT) < last)
    model, job = seen_from_a_circle(np.where(zooms, 520.0, 400.0))
    options = pycolmap.BundleAdjustmentOptions(print_summary=False)
    options.ceres.solver_options.function_tolerance = CLOSE
    pycolmap.bundle_adjustment(model, options)
    found = focal_lengths(pycolmap, model, job)
    focal = np.array([found[name] for name in job.names])
    assert REFUSED < focal.max() / focal.min() < 1.35
    assert set(np.flatnonzero(focal > 1.1 * focal.min())) <= set(range(first - 2, last + 2))


def test_a_part_that_the_adjustment_spoils_keeps_the_common_focal_length() -> None:
    class Spoiling:
        """COLMAP, whose adjustment also loses the focal length of the last part, and a few points."""

        def __getattr__(self, name: str) -> Any:
            return getattr(pycolmap, name)

        def bundle_adjustment(self, model: Any, options: Any) -> None:
            pycolmap.bundle_adjustment(model, options)
            model.cameras[max(model.cameras)].focal_length = 900.0
            for number, image in model.images.items():  # one point behind each camera, and one nowhere
                behind = image.cam_from_world().inverse() * np.array([0.0, 0.0, -1.0])
                for seen, place in zip(
                    image.get_observation_points2D()[number:], (behind, behind * np.nan), strict=False
                ):
                    model.points3D[seen.point3D_id].xyz = place

    true = np.where(np.arange(COUNT) < 19, 350.0, 560.0)
    model, job = seen_from_a_circle(true)
    found = focal_lengths(Spoiling(), model, job)
    focal = np.array([found[name] for name in job.names])
    assert (focal[-PART:] == 400.0).all()
    np.testing.assert_allclose(focal[:-PART], true[:-PART], rtol=0.03)


@pytest.mark.parametrize(
    ("takes", "expected"),
    [
        ([8, PART, 4], [3, 3, 2, PART, 4]),
        ([2, 7, 1, PART], [3, 3, 3, 4]),  # takes of one or two images say too little about their lens
        ([6, 2, 2], [3, 3, 4]),
        ([3, 1], [4]),
    ],
)
def test_parts_have_about_three_images_of_one_take_unless_it_is_short(takes: list[int], expected: list[int]) -> None:
    parts = _parts(np.repeat(np.arange(len(takes)), takes))
    assert [len(part) for part in parts] == expected and [*chain(*parts)] == list(range(sum(takes)))


@pytest.mark.parametrize(("ratio", "refused"), [(1.03, False), (1.1, False), (1.2, True)])
def test_a_slight_zoom_is_noted_and_a_strong_one_refused_unless_forced(
    ratio: float, refused: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    focal = torch.where(torch.arange(COUNT) < 28, 350.0, 350.0 * ratio).double()
    film: Reconstruction = replace(walk(), seconds=SECONDS, focal_lengths=focal)
    photos = Photos(film.paths, film.width, film.height, SECONDS)
    monkeypatch.setattr(pipeline, "read_photos", lambda *_: photos)
    monkeypatch.setattr(pipeline, "with_mask", lambda photos, *_: photos)
    monkeypatch.setattr(pipeline, "look", lambda *_: SimpleNamespace(cause=lambda: None))
    monkeypatch.setattr(placing, "find_poses", lambda *_, **__: film)
    monkeypatch.setattr(
        placing,
        "place",
        lambda found, *_, **__: SimpleNamespace(
            up_from="floor", scale_from="camera_height", camera_height=ABOVE, remarks=()
        ),
    )
    settings = CaptureSettings(camera_height=ABOVE, still=True)
    said: list[str] = []
    if refused:
        with pytest.raises(CaptureError, match=r"changes by 20 % at about 7 s, .* Pass --force to continue anyway\."):
            reconstruct(tmp_path / "film.mp4", tmp_path, settings, say=said.append)
        settings = replace(settings, force=True)
    notes = reconstruct(tmp_path / "film.mp4", tmp_path, settings, say=said.append)[1]
    assert len(notes) == (ratio > 1.07) and all(note.startswith("zoomed: ") for note in notes)
    assert ("zoomed" in "\n".join(said)) == (ratio > 1.07) and (ratio >= REFUSED) == refused
