"""splatrl-capture turns photos into a folder in which robots can be trained; poses are given here, to save time."""

import os
import signal
import sys
import tempfile
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
from splatrl.capture.base import CaptureError, Photos, Reconstruction
from splatrl.capture.fit import FitSettings
from splatrl.capture.fit_checkpoint import Checkpoint
from splatrl.capture.fit_pictures import Frame
from splatrl.capture.look import Look
from splatrl.capture.progress import Progress
from splatrl.capture.scale import Click, Distance
from splatrl.capture.settings import CaptureSettings
from splatrl.capture.stereo import Depths
from splatrl.capture.world import Placed
from splatrl.commands import capture
from splatrl.commands.stopping import INTERRUPTED
from splatrl.files import alone_in, remove_stale
from splatrl.renderers import NativeRenderer
from tests.capture.walks import HEIGHT, WIDTH, K, strewn, walk

GOOD = Look(images=40, brightness=120, keypoints=800, verified=1.0, turned=0.1, shift=0.2, angle=8.0)
DARK = replace(GOOD, brightness=4.0)


@pytest.fixture(scope="module")
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


@pytest.fixture(scope="module")
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


QUICK = ["--camera-height", "1.4", "--width", "80", "--gaussians", "3000", "--views", "100", "--device", "cpu"]


def test_photos_become_a_folder_with_everything_that_a_training_needs(
    tmp_path: Path, stages: list[str], capsys: pytest.CaptureFixture[str], request: pytest.FixtureRequest
) -> None:
    folder = tmp_path / "garden"
    capture.main(["garden.mp4", "--out", str(folder), *QUICK])
    assert stages == ["frames", "poses", "fit"]
    said = capsys.readouterr().out
    assert "40 of 40 images" in said and "camera at 1.40 m" in said and f"splatrl-train scene={folder}/" in said
    assert {"scene.yaml", "splat.ply", "report.html", "held_out.png", "map.png"} <= {p.name for p in folder.iterdir()}
    env = splatrl.make_env([f"scene={folder}/", "device=cpu", "robot.image_width=16", "robot.image_height=16"], [2])
    assert env.robot.height == pytest.approx(1.4, abs=0.15) and env.rollout(3)["pixels"].float().std() > 5
    with pytest.raises(
        SystemExit, match=r"scene\.yaml: already exists; choose another folder with --out, or pass --force"
    ):
        capture.main(["garden.mp4", "--out", str(folder), *QUICK])
    request.getfixturevalue("unchecked")
    capture.main(["garden.mp4", "--out", str(folder), *QUICK, "--force"])
    assert stages.count("fit") == 1  # the fit is reused


@pytest.mark.parametrize("name", ["splat.ply", "splat.spz", "scene.yaml"])
def test_no_file_of_others_is_replaced_without_being_asked_to(tmp_path: Path, stages: list[str], name: str) -> None:
    theirs = tmp_path / "theirs" / name
    theirs.parent.mkdir()
    theirs.write_text("theirs")
    with pytest.raises(SystemExit, match=rf"{name}: already exists; choose another folder with --out, or pass --force"):
        capture.main(["garden.mp4", "--out", str(theirs.parent), *QUICK])
    assert [path.name for path in theirs.parent.iterdir()] == [name] and theirs.read_text() == "theirs" and not stages


def test_the_fitted_width_follows_the_robots_and_the_photos_unless_it_is_given(
    tmp_path: Path, stages: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    fitted: list[tuple[int, int, int]] = []

    def fit(reconstruction: Reconstruction, settings: FitSettings, *_: object) -> None:
        fitted.append((settings.width, settings.cap, settings.views))
        raise CaptureError("far enough")

    monkeypatch.setattr(kept, "fit", fit)
    for options in ([], ["--robot-width", "999"], ["--width", "50", "--gaussians", "9"]):
        with pytest.raises(SystemExit, match="far enough"):
            capture.main(["a.mp4", "--out", str(tmp_path / "a"), *QUICK[:2], "--views", "7", "--still", *options])
    assert fitted == [(80, 60_000, 7), (80, 60_000, 7), (50, 9, 7)], "the photos are 80 pixels wide"


@pytest.mark.usefixtures("bare_report", "fitted_once")
def test_an_out_path_that_ends_in_spz_makes_a_compressed_splat(
    tmp_path: Path, stages: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    capture.main(["garden.mp4", "--out", str(tmp_path / "garden.spz"), *QUICK])
    folder = tmp_path / "garden"
    assert f"splatrl-train scene={folder}/" in capsys.readouterr().out and not (tmp_path / "garden.spz").exists()
    assert {"scene.yaml", "splat.spz", "report.html"} <= {p.name for p in folder.iterdir()}
    assert not (folder / "splat.ply").exists()
    assert (folder / "splat.spz").stat().st_size < (folder / "stages" / "fit" / "gaussians.ply").stat().st_size / 3
    env = splatrl.make_env([f"scene={folder}/", "device=cpu", "robot.image_width=16", "robot.image_height=16"], [2])
    assert env.rollout(3)["pixels"].float().std() > 5


@pytest.mark.usefixtures("unchecked")
def test_a_stopped_fit_continues_with_the_same_bytes(
    tmp_path: Path, stages: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(Checkpoint, "due", lambda self: True)
    shown, heard = capture.Bars.__call__, []

    def show(self: capture.Bars, what: str, done: int, total: int) -> None:
        heard.extend([done] if what == "fit" else [])
        if heard == [*range(2, 62, 2)]:
            raise KeyboardInterrupt
        shown(self, what, done, total)

    monkeypatch.setattr(capture.Bars, "__call__", show)
    folders = [tmp_path / "stopped", tmp_path / "whole"]
    with pytest.raises(SystemExit):
        capture.main(["garden.mp4", "--out", str(folders[0]), *QUICK])
    assert "run the same command again to continue" in capsys.readouterr().err
    for folder in folders:
        heard.clear()
        heard.append(0)
        capture.main(["garden.mp4", "--out", str(folder), *QUICK])
        assert heard[1] == (60 if folder == folders[0] else 2)
    written = [(folder / "splat.ply").read_bytes() for folder in folders]
    assert written[0] == written[1]
    assert not list(tmp_path.rglob("checkpoint.npz")) and not list(tmp_path.rglob("*.tmp"))


@pytest.mark.usefixtures("unchecked")
def test_damaged_files_of_stages_are_computed_again(
    tmp_path: Path, stages: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["garden.mp4", "--out", str(tmp_path / "garden"), *QUICK, "--force"]
    capture.main(words)
    whole = (tmp_path / "garden" / "splat.ply").read_bytes()
    kept = tmp_path / "garden" / "stages"
    files = [kept / name for name in ("depths/arrays.npz", "moving/arrays.npz", "fit/gaussians.ply")]
    for path in files:
        path.write_bytes(path.read_bytes()[:2000])
    (kept / ".fit.0123abcd.tmp").mkdir()  # left by a kill
    capsys.readouterr()
    capture.main(words)
    said = capsys.readouterr().out
    assert all(f"{path}: expected the file that was kept, found it damaged" in said for path in files)
    assert (tmp_path / "garden" / "splat.ply").read_bytes() == whole and stages.count("fit") == 2
    assert not list(tmp_path.rglob("*.tmp"))


@pytest.mark.usefixtures("unchecked")
def test_moving_things_are_left_out_unless_still_is_passed(
    tmp_path: Path, stages: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def find_moving(found: Reconstruction, depths: Depths, settings: FitSettings, progress: Progress) -> torch.Tensor:
        moving = torch.zeros_like(depths.known, dtype=torch.bool)
        moving[1] = True
        return moving

    monkeypatch.setattr(kept, "find_moving", find_moving)
    words, written = ["garden.mp4", "--out", str(tmp_path / "garden"), *QUICK, "--force"], []
    for more in (["--still"], [], []):
        capture.main([*words, *more])
        written.append((tmp_path / "garden" / "splat.ply").read_bytes())
        assert ("2.5 % of the image area shows moving things" in capsys.readouterr().out) == (not more)
    assert stages.count("fit") == 2 and written[0] != written[1] == written[2]


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("name", ["arrays.npz", "checkpoint.npz", "gaussians.ply", "splat.ply"])
def test_a_full_disk_is_reported_in_one_line_that_names_the_file(
    tmp_path: Path, stages: list[str], monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    renamed = os.replace

    def fails(old: Path, new: Path) -> None:
        if Path(new).name == name:
            raise OSError(28, "No space left on device")
        renamed(old, new)

    monkeypatch.setattr(os, "replace", fails)
    monkeypatch.setattr(Checkpoint, "due", lambda self: True)
    with pytest.raises(SystemExit, match=rf"^splatrl-capture: .*cannot write: No space left on device: '.*{name}'$"):
        capture.main(["garden.mp4", "--out", str(tmp_path / "garden"), *QUICK])
    assert not list(tmp_path.rglob("*.tmp")) and not (tmp_path / "garden" / "scene.yaml").exists()


@pytest.mark.usefixtures("unchecked", "fitted_once")
def test_problems_found_by_the_report_are_printed_too(
    tmp_path: Path, stages: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("splatrl.capture.folder.problems", lambda *_: ["The sky fell."])
    capture.main(["garden.mp4", "--out", str(tmp_path / "garden"), *QUICK])
    assert "of the camera's path is free\n            The sky fell.\n" in capsys.readouterr().out
    assert "The sky fell." in (tmp_path / "garden" / "report.html").read_text()


@pytest.mark.usefixtures("unchecked", "fitted_once")
def test_a_kill_while_the_scene_is_written_leaves_nothing_beside_it(
    tmp_path: Path, stages: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    places: list[Path] = []
    described = write_folder.write_description

    def describe(fresh: Path, *given: Any, **more: Any) -> object:
        places.append(fresh)
        return described(fresh, *given, **more)

    monkeypatch.setattr(write_folder, "write_description", describe)
    capture.main(["garden.mp4", "--out", str(tmp_path / "garden"), *QUICK])
    (unfinished,) = places
    assert unfinished.parent == tmp_path / "garden" / "stages"
    unfinished.mkdir()  # as a kill leaves it
    remove_stale(unfinished.parent)
    assert not unfinished.exists()


def test_two_captures_do_not_share_a_folder(tmp_path: Path, stages: list[str]) -> None:
    (tmp_path / "garden" / "stages").mkdir(parents=True)
    with alone_in(tmp_path / "garden" / "stages"), pytest.raises(SystemExit, match="that another process is using"):
        capture.main(["garden.mp4", "--out", str(tmp_path / "garden"), *QUICK])
    assert stages == []


def test_a_scene_is_never_written_into_the_folder_of_its_photos(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folders: list[Path] = []

    def stop(source: Path, folder: Path, *_: object) -> None:
        folders.append(folder)
        raise CaptureError("far enough")

    (tmp_path / "photos").mkdir()
    (tmp_path / "scan.v1").mkdir()
    monkeypatch.setattr(pipeline, "reconstruct", stop)
    for place, source in (
        (tmp_path, "photos"),
        (tmp_path / "photos", "."),
        (tmp_path / "photos", "../walk.mp4"),
        (tmp_path / "photos", "../scan.v1"),
    ):
        monkeypatch.chdir(place)
        with pytest.raises(SystemExit, match="far enough"):
            capture.main([source])
    assert folders == [Path("photos-scene"), Path("photos"), Path("walk"), Path("scan.v1")]
    with pytest.raises(SystemExit, match=r"expected a scene folder other than the source.* --out"):
        capture.main([".", "--out", str(tmp_path / "photos")])
    assert not (tmp_path / "photos" / "stages").exists()


def test_a_capture_that_cannot_work_is_refused_with_its_cause(
    tmp_path: Path, stages: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pipeline, "look", lambda photos, progress: DARK)
    with pytest.raises(SystemExit, match=r"splatrl-capture: .*dark.* --force"):
        capture.main(["night.mp4", "--out", str(tmp_path / "night"), *QUICK])
    assert stages == ["frames"] and not (tmp_path / "night" / "scene.yaml").exists()


@pytest.mark.parametrize(
    ("judge", "message"),
    [
        ("on_its_side", r"splatrl-capture: images lie on their side: .* --force"),
        ("upside_down", r"splatrl-capture: images seem to be upside down: .* --force"),
    ],
)
def test_a_video_that_is_not_upright_is_refused_before_the_fit(
    judge: str, message: str, tmp_path: Path, stages: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(f"splatrl.capture.upright_check.{judge}", lambda *_: True)
    with pytest.raises(SystemExit, match=message):
        capture.main(["garden.mp4", "--out", str(tmp_path / "garden"), *QUICK])
    assert stages == ["frames", "poses"]


def test_that_the_camera_was_turned_while_it_filmed_is_said_and_reported(
    tmp_path: Path, stages: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(placing, "how_turned", lambda _: "The camera was turned.")
    said: list[str] = []
    settings = CaptureSettings(still=True)
    notes = pipeline.reconstruct(Path("garden.mp4"), tmp_path / "garden", settings, say=said.append)[1]
    assert "The camera was turned." in notes and any("The camera was turned." in line for line in said)


def test_poses_of_other_images_are_refused_as_such(
    tmp_path: Path, stages: list[str], photographed: tuple[Photos, Reconstruction], monkeypatch: pytest.MonkeyPatch
) -> None:
    photos, found = photographed
    few = replace(found, points=found.points[:3], seen_point=found.seen_point[:0], seen_by=found.seen_by[:0])
    monkeypatch.setattr(pipeline, "is_recording", lambda _: True)
    monkeypatch.setattr(pipeline, "read_recording", lambda *_: replace(photos, camera_to_world=found.camera_to_world))
    monkeypatch.setattr(placing, "find_poses", lambda *_, **settings: few)
    with pytest.raises(CaptureError, match=r"^only 3 points agree with the recorded poses.* belong to these images"):
        pipeline.reconstruct(Path("model"), tmp_path / "model", CaptureSettings())


@pytest.mark.parametrize("up_from", ["floor", "cameras"])
def test_a_film_that_seems_torn_and_shows_no_floor_is_refused_before_the_fit(
    up_from: str, tmp_path: Path, stages: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    placed, said = placing.place, []
    monkeypatch.setattr(placing, "place", lambda *given, **told: replace(placed(*given, **told), up_from=up_from))
    monkeypatch.setattr(pipeline, "leap", lambda _: "The camera seems to jump at 3 s.")
    folder, settings = tmp_path / "garden", CaptureSettings(still=True)
    if up_from == "floor":
        pipeline.reconstruct(Path("garden.mp4"), folder, settings)
        return
    with pytest.raises(CaptureError, match=r"^The camera seems to jump at 3 s\. No floor was found, .* --force"):
        pipeline.reconstruct(Path("garden.mp4"), folder, settings)
    pipeline.reconstruct(Path("garden.mp4"), folder, replace(settings, force=True), say=said.append)
    assert stages == ["frames", "poses"] * 2 and any("No floor was found" in line for line in said)


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


def test_what_was_left_out_of_a_source_is_said_and_noted_for_the_report(
    tmp_path: Path, stages: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    read, said = pipeline.read_photos, []
    remark = "1 of 40 frames of garden.mp4 are damaged, and are not used."
    monkeypatch.setattr(pipeline, "read_photos", lambda *given: replace(read(*given), remarks=(remark,)))
    settings = CaptureSettings(still=True)
    _, notes = pipeline.reconstruct(Path("garden.mp4"), tmp_path / "garden", settings, say=said.append)
    assert notes == [remark] and said[0].split("\n")[1] == f"            {remark}"


def test_an_error_in_a_stage_is_reported_in_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*arguments: object) -> Photos:
        raise CaptureError("walk.mp4: expected a video, found no video stream")

    monkeypatch.setattr(pipeline, "read_photos", broken)
    with pytest.raises(SystemExit, match=r"^splatrl-capture: walk\.mp4: expected a video"):
        capture.main(["walk.mp4", "--out", str(tmp_path / "there" / "walk")])
    assert list(tmp_path.glob("there/*")) == []  # no empty folder is left behind


def test_an_unknown_device_is_refused_in_one_line() -> None:
    with pytest.raises(SystemExit, match=r"^splatrl-capture: device: expected auto, cpu.*, got tpu9"):
        capture.main(["walk.mp4", "--device", "tpu9"])


def test_an_interrupt_says_how_to_continue(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(*arguments: object) -> Photos:
        raise KeyboardInterrupt

    monkeypatch.setattr(pipeline, "read_photos", interrupted)
    with pytest.raises(SystemExit) as ended:
        capture.main(["walk.mp4", "--out", str(tmp_path / "walk")])
    assert ended.value.code == INTERRUPTED and "run the same command again to continue" in capsys.readouterr().err


def test_a_termination_says_how_to_continue(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def terminated(*arguments: object) -> Photos:
        assert signal.getsignal(signal.SIGTERM) is signal.default_int_handler, "or it would end the tests"
        signal.raise_signal(signal.SIGTERM)
        raise AssertionError

    monkeypatch.setattr(pipeline, "read_photos", terminated)
    before = signal.getsignal(signal.SIGTERM)
    try:
        with pytest.raises(SystemExit) as ended:
            capture.main(["walk.mp4", "--out", str(tmp_path / "walk")])
    finally:
        signal.signal(signal.SIGTERM, before)
    assert ended.value.code == INTERRUPTED and "to continue" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["3", "10", "20", "30.5", "40", "2.5"], ((3, 10, 20), (3, 30.5, 40))),
        (["3", "10", "20", "7", "30.5", "-4e1", "2.5"], ((3, 10, 20), (7, 30.5, -40))),
        (["3 10 20, 7 30.5 40, 2.5"], ((3, 10, 20), (7, 30.5, 40))),
        (["IMG_3.JPG", "10", "20", "30.5", "40", "2.5"], (("IMG_3.JPG", 10, 20), ("IMG_3.JPG", 30.5, 40))),
        (["a.png 10 20", "7 30.5 40 2.5"], (("a.png", 10, 20), (7, 30.5, 40))),
    ],
)
@pytest.mark.parametrize("source_last", [False, True])
def test_each_point_of_a_distance_may_be_in_its_own_image(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    words: list[str],
    expected: tuple[tuple[Any, ...], ...],
    source_last: bool,
) -> None:
    given: list[object] = []

    def stop(source: Path, folder: Path, settings: CaptureSettings, *_: object) -> None:
        given.extend([source, settings.distance])
        raise CaptureError("far enough")

    monkeypatch.setattr(capture, "capture", stop)
    option = ["--distance", *words]
    with pytest.raises(SystemExit, match="far enough"):
        capture.main([*option, "garden.mp4"] if source_last else ["garden.mp4", *option, "--seed", "1"])
    first, second = (Click(image, x, y) for image, x, y in expected)
    assert given == [Path("garden.mp4"), Distance((first,), (second,), 2.5)]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["1", "2", "3"], "expected IMAGE X Y X Y M or IMAGE X Y IMAGE X Y M, got '1 2 3'"),
        (["1.5", "2", "3", "4", "5", "6"], "expected the name or the number of an image, got 1.5"),
        (["1", "2", "3", "inf", "4", "5", "6"], "expected the name or the number of an image, got inf"),
        (["1", "2", "a.jpg", "4", "5", "6"], "expected IMAGE X Y X Y M or IMAGE X Y IMAGE X Y M, got '1 2 a.jpg"),
        (["1", "2", "3", "4", "5", "-6"], "expected a number of metres above 0.0, got -6"),
    ],
)
def test_an_invalid_distance_is_a_usage_error(
    words: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        capture.main(["garden.mp4", "--distance", *words])
    assert message in capsys.readouterr().err


@pytest.mark.parametrize(
    ("typed", "message"),
    [
        ("--camera-height=0", "expected a number of metres above 0.0, got 0.0"),
        ("--camera-height=-1.4", "expected a number of metres above 0.0, got -1.4"),
        ("--camera-height=nan", "expected a number of metres above 0.0, got nan"),
        ("--camera-height=inf", "expected a number of metres above 0.0, got inf"),
        ("--marker-side=-1", "expected a number of metres above 0.0, got -1.0"),
        ("--gaussians=0", "expected a whole number of at least 1, got 0"),
        ("--width=5", "expected a whole number of pixels, at least 16, got 5"),
        ("--robot-width=0", "expected a whole number of pixels, at least 1, got 0"),
        ("--views=0", "expected a whole number of at least 1, got 0"),
        ("--seed=-1", "expected a whole number from 0 to 2147483647, got -1"),
        ("--seed=99999999999999999999", "expected a whole number from 0 to 2147483647, got 99999999999999999999"),
        ("--out=", "expected a folder, got an empty name"),
    ],
)
def test_numbers_out_of_range_are_refused_before_a_capture_begins(
    typed: str, message: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(capture, "capture", lambda *_: pytest.fail("it began"))
    with pytest.raises(SystemExit):
        capture.main(["garden.mp4", typed])
    assert f"splatrl-capture: {typed.partition('=')[0]}: {message};" in capsys.readouterr().err


def test_a_file_in_the_place_of_the_scene_is_refused(tmp_path: Path, stages: list[str]) -> None:
    (tmp_path / "garden").write_text("theirs")
    with pytest.raises(SystemExit, match=r"garden: expected a folder for the scene, got a file; .*--out"):
        capture.main(["garden.mp4", "--out", str(tmp_path / "garden")])
    assert (tmp_path / "garden").read_text() == "theirs" and not stages


def test_a_finished_scene_is_not_taken_for_a_folder_of_photos(tmp_path: Path, stages: list[str]) -> None:
    garden = tmp_path / "garden"
    garden.mkdir()
    for name in ("scene.yaml", "map.png"):
        (garden / name).touch()
    with pytest.raises(SystemExit, match=r"garden: expected a video .*got a scene .*: splatrl-train scene=.*garden/$"):
        capture.main([str(garden), "--out", str(tmp_path / "again")])
    assert not stages and not (tmp_path / "again").exists()


def test_a_folder_that_cannot_be_written_is_refused_before_the_capture(
    tmp_path: Path, stages: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(dir: Path, **_: object) -> None:
        if dir == tmp_path / "garden":
            raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(tempfile, "TemporaryFile", refuse)
    with pytest.raises(SystemExit, match=r"cannot write: Permission denied: '.*garden'$"):
        capture.main(["garden.mp4", "--out", str(tmp_path / "garden"), *QUICK])
    assert not stages and not (tmp_path / "garden").exists()


def test_a_page_with_a_marker_is_written_without_a_capture(tmp_path: Path) -> None:
    capture.main(["--marker", str(tmp_path / "marker.pdf")])
    assert (tmp_path / "marker.pdf").read_bytes().startswith(b"%PDF")
    for path, message in ((tmp_path / "none" / "m.pdf", "No such file"), (tmp_path / "m.png", "a name that ends in")):
        with pytest.raises(SystemExit, match=f"^splatrl-capture: .*{message}"):
            capture.main(["--marker", str(path)])
    assert [path.name for path in tmp_path.iterdir()] == ["marker.pdf"]


def test_a_missing_extra_is_named_before_the_video_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "cv2", None)
    (tmp_path / "walk.mp4").write_bytes(b"not read")
    with pytest.raises(SystemExit, match=r"^splatrl-capture: cv2 is missing: pip install 'splatrl\[capture\]'$"):
        capture.main([str(tmp_path / "walk.mp4"), "--out", str(tmp_path / "place")])
    assert [path.name for path in tmp_path.iterdir()] == ["walk.mp4"]


def test_a_missing_source_is_a_usage_error(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        capture.main([])
    assert "expected a video or a folder of photos, or --marker" in capsys.readouterr().err


def test_several_sources_are_refused_by_name_with_the_advice_to_join_takes(capsys: pytest.CaptureFixture[str]) -> None:
    for typed in (["a.mp4", "b.mp4"], ["a.mp4", "--still", "b.mp4"]):
        with pytest.raises(SystemExit):
            capture.main(typed)
        said = capsys.readouterr().err
        assert "expected one video or one folder, got a.mp4, b.mp4; name the folder of photos, and first join" in said
    with pytest.raises(SystemExit):
        capture.main(["a.mp4", "--stil1"])
    assert "unrecognized arguments: --stil1" in capsys.readouterr().err
