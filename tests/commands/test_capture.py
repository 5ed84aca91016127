"""splatrl-capture turns photos into a folder in which robots can be trained; poses are given here, to save time."""

import os
import signal
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

import splatrl
from splatrl.capture import folder as write_folder
from splatrl.capture import kept, pipeline, placing
from splatrl.capture.base import CaptureError, Photos, Reconstruction
from splatrl.capture.fitting.checkpoint import Checkpoint
from splatrl.capture.fitting.fit import FitSettings
from splatrl.capture.look import Look
from splatrl.capture.progress import Progress
from splatrl.capture.settings import CaptureSettings
from splatrl.capture.stereo import Depths
from splatrl.commands import capture
from splatrl.commands.stopping import INTERRUPTED
from splatrl.files import alone_in, remove_stale

DARK = Look(images=40, brightness=4, keypoints=800, verified=1.0, turned=0.1, shift=0.2, angle=8.0)
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
