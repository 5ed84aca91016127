"""splatrl-capture finds poses again without what moves, and keeps those that hold."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from splatrl.capture import kept, pipeline, placing
from splatrl.capture.base import CaptureError, Photos, Reconstruction
from splatrl.capture.scale import Click, Distance
from splatrl.capture.settings import CaptureSettings
from splatrl.capture.stereo import Depths
from splatrl.capture.world import Placed


@pytest.fixture
def movers(stages: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Make much of all images but the first move, and look for no depths, which do not matter then."""

    def find_depths(found: Reconstruction, *_: object, **__: object) -> Depths:
        unknown = torch.zeros(len(found.paths), found.height, found.width)
        return Depths(unknown, unknown)

    def find_moving(found: Reconstruction, depths: Depths, *_: object) -> torch.Tensor:
        stages.append("moving")
        moving = torch.zeros_like(depths.known, dtype=torch.bool)
        moving[1:, :, :9] = True
        return moving

    monkeypatch.setattr(kept, "find_depths", find_depths)
    monkeypatch.setattr(kept, "find_moving", find_moving)


@pytest.mark.parametrize("again", ["all", "few", "none"])
def test_poses_are_found_again_without_people_who_walk_along_unless_fewer_images_get_one(
    again: str,
    tmp_path: Path,
    stages: list[str],
    movers: None,
    photographed: tuple[Photos, Reconstruction],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    found, masks = photographed[1], []
    few = {"paths": found.paths[:30], "camera_to_world": found.camera_to_world[:30]}
    seen = {"seen_point": found.seen_point[found.seen_by < 30], "seen_by": found.seen_by[found.seen_by < 30]}

    def find_poses(photos: Photos, *_: object, **__: object) -> Reconstruction:
        masks.append(photos.moving and sorted(path.name for path in photos.moving.glob("*.png"))[:2])
        if photos.moving is not None and again == "none":
            raise CaptureError("tracking lost")
        return found if photos.moving is None or again == "all" else replace(found, **few, **seen)

    monkeypatch.setattr(placing, "find_poses", find_poses)
    place, remark = placing.place, "The floor seems to slope by 8° or more."
    monkeypatch.setattr(placing, "place", lambda *given, **told: replace(place(*given, **told), remarks=(remark,)))
    for times in (1, 2):
        said: list[str] = []
        placed, notes = pipeline.reconstruct(
            Path("garden.mp4"), tmp_path / "garden", CaptureSettings(), say=said.append
        )
        assert masks == [None, [f"{name.name}.png" for name in found.paths[:2]]] * times
        seen_in = f"{100 * (len(found.paths) - 1) / len(found.paths):.0f} % of the images"
        assert any(line.startswith("moving ") and f"{seen_in}: poses are found again" in line for line in said)
        assert len(placed.reconstruction.paths) == len(found.paths)
        assert any("The poses before are kept" in line for line in said) == (again != "all")
        assert notes[-2] == remark and f"in view in {seen_in}, which may be why" in notes[-1]
        assert stages.count("moving") == 1, "the masks are kept"
    still = replace(CaptureSettings(), still=True)
    pipeline.reconstruct(Path("garden.mp4"), tmp_path / "garden", still)
    assert masks[-2:] == [[f"{name.name}.png" for name in found.paths[:2]], None] and len(masks) == 5


@pytest.fixture
def walked_along(
    movers: None, stages: list[str], photographed: tuple[Photos, Reconstruction], monkeypatch: pytest.MonkeyPatch
) -> list[Reconstruction]:
    """Make much of the images move; the value holds the poses found with it in view, and those found without it."""
    given = [photographed[1], replace(photographed[1], points=photographed[1].points + 1e-6)]

    def find_poses(photos: Photos, *_: object, **__: object) -> Reconstruction:
        stages.append("poses" if photos.moving is None else f"poses without {photos.moving.name}")
        return given[photos.moving is not None]

    monkeypatch.setattr(placing, "find_poses", find_poses)
    return given


@pytest.mark.parametrize("doubts", [("leap", "leap, no floor"), ("", "leap"), ("leap, no floor", "leap")])
def test_poses_found_again_are_not_used_where_they_seem_torn_and_those_before_less_so(
    doubts: tuple[str, str],
    tmp_path: Path,
    walked_along: list[Reconstruction],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    place, said = placing.place, []

    def doubted(found: Reconstruction, *given: Any, **told: Any) -> Placed:
        doubt = doubts[found is walked_along[1]]
        return replace(
            place(found, *given, **told), up_from="cameras" if "floor" in doubt else "floor", remarks=(doubt,)
        )

    monkeypatch.setattr(placing, "place", doubted)
    for by in ("again", "pipeline"):
        monkeypatch.setattr(
            f"splatrl.capture.{by}.leap", lambda placed: "It jumps." if "leap" in placed.remarks[0] else None
        )
    placed, _ = pipeline.reconstruct(Path("a.mp4"), tmp_path / "a", CaptureSettings(), say=said.append)
    better = "floor" in doubts[0]
    assert placed.remarks[0] == doubts[better]
    assert any("It jumps.\n            The poses before are kept." in line for line in said) == (not better)


def test_poses_found_again_are_not_used_where_moving_things_cannot_be_sought_with_them(
    tmp_path: Path, walked_along: list[Reconstruction], monkeypatch: pytest.MonkeyPatch
) -> None:
    find_moving, counts, said = kept.find_moving, [], []

    def fails(found: Reconstruction, *given: Any) -> torch.Tensor:
        counts.append(found.points)
        if len(counts) == 2:
            raise CaptureError("expected points, got none")
        return find_moving(found, *given)

    monkeypatch.setattr(kept, "find_moving", fails)
    placed, _ = pipeline.reconstruct(Path("a.mp4"), tmp_path / "a", CaptureSettings(), say=said.append)
    assert torch.equal(placed.reconstruction.points, counts[0]) and not torch.equal(counts[0], counts[1])
    assert any("expected points, got none\n            The poses before are kept." in line for line in said)


def test_a_distance_is_measured_in_the_images_of_the_poses_that_are_used(
    tmp_path: Path, walked_along: list[Reconstruction]
) -> None:
    found = walked_along[1]
    few = found.seen_by < 38
    less = replace(
        found,
        paths=found.paths[:38],
        camera_to_world=found.camera_to_world[:38],
        numbers=torch.arange(38),
        seen_point=found.seen_point[few],
        seen_by=found.seen_by[few],
    )
    clicks = Click("039.png", 40.0, 30.0), Click("000.png", 30.0, 30.0)
    stated = replace(CaptureSettings(), distance=Distance.between(*clicks, 2.5))
    for number, poses in enumerate([(less, found), (found, less)]):
        walked_along[:] = poses
        placed, _ = pipeline.reconstruct(Path("a.mp4"), tmp_path / str(number), stated)
        assert placed.scale_from == "distance" and len(placed.reconstruction.paths) == 40
    walked_along[:] = less, less
    with pytest.raises(CaptureError, match=r"^distance: expected an image with a pose in .*, got 039\.png"):
        pipeline.reconstruct(Path("a.mp4"), tmp_path / "neither", stated)


def test_poses_are_kept_where_only_the_size_of_the_fit_changes(
    tmp_path: Path, stages: list[str], walked_along: list[Reconstruction]
) -> None:
    settings = CaptureSettings()
    pipeline.reconstruct(Path("a.mp4"), tmp_path / "a", settings)
    sought = stages.count("moving")
    finer = replace(settings, fit=replace(settings.fit, width=400, cap=90_000, sh_degree=2, device="cuda"))
    pipeline.reconstruct(Path("a.mp4"), tmp_path / "a", finer)
    assert stages.count("moving") == sought > 0
    pipeline.reconstruct(Path("a.mp4"), tmp_path / "a", replace(settings, fit=replace(settings.fit, views=100)))
    assert stages.count("moving") > sought, "the search is as long as the fit"
