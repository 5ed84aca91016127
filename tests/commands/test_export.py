"""End-to-end tests of ``splatrl-export``, and of the script that it writes."""

import runpy
import subprocess
import sys
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path

import cv2
import numpy as np
import pytest
from torchrl.modules import ActorValueOperator

from splatrl.commands import export
from splatrl.configuration import load_config
from splatrl.envs.world import World
from splatrl.evaluation.policy_camera import Eye
from splatrl.export.onnx_file import POLICY, RUNNER, runner
from splatrl.images import open_video
from splatrl.runs import load_policy
from tests.experiments.trained import BEST, NAMES, config, save_run
from tests.tiny import tiny_overrides

onnxruntime = pytest.importorskip("onnxruntime", reason="needs the extra export")
pytest.importorskip("onnxscript", reason="needs the extra export")

pytestmark = pytest.mark.usefixtures("translated_once")


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    return save_run(folder / "run", config(folder, "memory=stack"), 1)


def command(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> None:
    monkeypatch.setattr(sys, "argv", ["splatrl-export", *arguments])
    export.main()


def run_policy(monkeypatch: pytest.MonkeyPatch, folder: Path, *arguments: object) -> None:
    """Run the script that was written into a folder, in this process."""
    monkeypatch.setattr(sys, "argv", ["run_policy.py", *map(str, arguments)])
    runpy.run_path(str(folder / "run_policy.py"), run_name="__main__")


@pytest.fixture(scope="module")
def exported(run: Path, translated_once: None) -> tuple[Path, str]:
    """The folder into which the run was exported, and the output of the command."""
    with pytest.MonkeyPatch.context() as patched, redirect_stdout(StringIO()) as said:
        command(patched, f"run={run}", "frames=64")
    return run / "export", said.getvalue()


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A video of 5 frames of 96 × 54 pixels, whose colours drift."""
    path = tmp_path_factory.mktemp("film") / "film.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"FFV1"), 5.0, (96, 54))
    rows, columns = np.mgrid[0:54, 0:96]
    for step in range(5):
        image = np.stack([columns * 2, rows * 4, np.full_like(rows, 50 * step)], -1)
        writer.write(image.astype(np.uint8))
    writer.release()
    return path


def test_a_policy_is_exported_and_run_on_a_video(run: Path, film: Path, exported: tuple[Path, str]) -> None:
    folder, printed = exported
    assert str(run / "export" / "policy.onnx") in printed and "on 64 views" in printed
    line = [sys.executable, str(folder / "run_policy.py"), str(film)]
    done = subprocess.run(line, capture_output=True, text=True, check=True)
    lines = [line.split(maxsplit=2) for line in done.stdout.splitlines()]
    assert [(number, name) for number, name, _ in lines] == [(str(number), NAMES[1]) for number in range(5)]
    trained = load_policy(run)
    with open_video(film) as video:
        images = [Eye(12, 16).fitted(frame.to_image()) for frame in video.decode(video=0)]
    seen = [images[0]] * 3
    for image, (_, _, told) in zip(images, lines, strict=True):
        seen = [*seen[-3:], image]
        td = trained.beginning()
        td["pixels"] = np.concatenate(seen, -1)[None]
        expected = trained.policy(td)["logits"][0].softmax(-1).detach().numpy()
        assert all(len(share.partition(".")[2]) == 4 for share in told.split())
        found = np.array(told.split(), float)
        np.testing.assert_allclose(found, expected, atol=2e-3)  # the two average and round areas in different ways


def test_the_checkpoint_and_the_folder_can_be_chosen(
    run: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    given: list[tuple[int, Path, int]] = []

    def export_policy(model: ActorValueOperator, world: World, folder: Path, frames: int, _: object) -> float:
        preferred = model.get_policy_head().module[0].module.bias.argmax()
        given.append((int(preferred), folder, frames))
        return 0.0

    monkeypatch.setattr(export, "export_policy", export_policy)
    command(monkeypatch, f"run={run}", f"out={tmp_path / 'new'}", "frames=8", "checkpoint=best")
    command(monkeypatch, f"run={run}", "frames=9")
    assert given == [(BEST, tmp_path / "new", 8), (1, run / "export", 9)]


@pytest.mark.parametrize("fov", [30, 60, 90, 100, 127])
def test_a_policy_sees_the_angles_of_its_own_camera_in_any_video(
    exported: tuple[Path, str],
    film: Path,
    fov: int,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    seen: list[np.ndarray] = []
    session = onnxruntime.InferenceSession

    class Watched(session):  # type: ignore[valid-type, misc]
        def run(self, names: None, given: dict[str, np.ndarray]) -> list[np.ndarray]:
            seen.append(given["pixels"][0])
            return list(super().run(names, given))

    monkeypatch.setattr(onnxruntime, "InferenceSession", Watched)
    run_policy(monkeypatch, exported[0], film, "--fov", fov)
    eye = Eye(12, 16, fov_deg=90.0, film_fov_deg=fov)
    with open_video(film) as video:
        images = [frame.to_image() for frame in video.decode(video=0)]
    assert len(seen) == len(images) == 5
    for found, image in zip(seen, images, strict=True):
        assert np.abs(found - eye.fitted(image).numpy().astype(int)).max() <= 4  # areas are rounded to whole pixels
    assert capsys.readouterr().err == ("" if fov == 127 else f"{film} {eye.note(images[0])}\n")


def test_other_observations_of_a_policy_are_given_on_the_command_line(
    film: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    sensors = ["sensors=[rgb,imagegoal,pointgoal,depth,lidar]", "sensors.depth.normalize=false"]
    chosen = load_config([*tiny_overrides(tmp_path, "pointnav"), *sensors])
    run = save_run(tmp_path / "run", chosen, 1)
    command(monkeypatch, f"run={run}", "frames=8")
    picture = str(tmp_path / "goal.png")
    cv2.imwrite(picture, np.full((24, 32, 3), 90, np.uint8))
    farthest = {"bytes": np.full((24, 32), 255, np.uint8), "words": np.full((24, 32), 65535, np.uint16)}
    for name, depth in farthest.items():
        cv2.imwrite(str(tmp_path / f"{name}.png"), depth)
    given = {
        "imagegoal": picture,
        "pointgoal_with_gps_compass": "2.5,0.3",
        "lidar": ",".join(["1.25"] * 64),
        "depth": ",".join(["10"] * 12 * 16),
    }

    def said(**changed: object) -> tuple[str, str]:
        words = [f"{name}={value}" for name, value in (given | changed).items()]
        try:
            run_policy(monkeypatch, run / "export", film, *(word for each in words for word in ("--give", each)))
        except SystemExit:
            return "", capsys.readouterr().err
        return tuple(capsys.readouterr())

    capsys.readouterr()
    expected, _ = said()
    assert len(expected.splitlines()) == 5
    for name in farthest:
        assert said(depth=tmp_path / f"{name}.png")[0] == expected
    assert said(depth=",".join(["1"] * 12 * 16))[0] not in ("", expected)
    pixels = "expected 192 numbers or an image file, got"
    for changed, message in (
        ({"depth": "no.png"}, f"--give depth: {pixels} no.png"),
        ({"depth": film}, f"--give depth: {pixels} {str(film)[:60]}"),
        ({"pointgoal_with_gps_compass": 2}, "--give pointgoal_with_gps_compass: expected 2 numbers, got 2"),
        ({"lidar": picture}, f"--give lidar: expected 64 numbers, got {picture[:60]}"),
    ):
        assert message in said(**changed)[1]
    del given["depth"]
    assert "--give: expected " in (told := said()[1]) and "for this policy; check depth" in told


def test_a_script_that_was_changed_is_kept_when_the_policy_is_exported_again(
    run: Path, exported: tuple[Path, str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    written, (folder, said) = runner(), exported
    assert (folder / RUNNER).read_bytes() == written and "run_policy.py: runs the policy on a video" in said
    (folder / POLICY).unlink()
    (folder / RUNNER).write_bytes(changed := written + b"# drives my robot\n")
    try:
        command(monkeypatch, f"run={run}", "frames=8")
        assert (folder / POLICY).exists() and (folder / RUNNER).read_bytes() == changed
        assert "run_policy.py: kept as it was, changed by you" in capsys.readouterr().out
    finally:
        (folder / RUNNER).write_bytes(written)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["run=nowhere"], "splatrl-export: run: expected a run folder"),
        ([], "splatrl-export: run: expected a value, got none"),
        (
            ["run={run}", "out={run}/config.yaml"],
            "splatrl-export: out: expected a folder, got .*config.yaml, a file",
        ),
        (
            ["run={run}", "out={run}/held"],
            "splatrl-export: out: expected a folder without policy.onnx, got .*/held, which holds one",
        ),
        (["run={run}", "frames=none"], "splatrl-export: frames: expected a number"),
        (["run={run}", "checkpoint=first"], "splatrl-export: checkpoint: expected last or best, got 'first'"),
        (["run={run}", "scene.path=moved"], "splatrl-export: .*/moved: expected a file or a folder, found none"),
        (["run={run}", "output=x"], "output: no such key, did you mean out"),
    ],
)
def test_invalid_arguments_are_reported(
    run: Path, arguments: list[str], message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    (run / "held").mkdir(exist_ok=True)
    (run / "held" / "policy.onnx").touch()  # perhaps the policy of another run
    with pytest.raises(SystemExit, match=message):
        command(monkeypatch, *(argument.format(run=run) for argument in arguments))


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["none.mp4"], "none.mp4: expected a video file or the number of a camera"),
        (["none.mp4", "--fov", "0"], "--fov: expected degrees between 0 and 180, got 0"),
        (["none.mp4", "--fov", "-69"], "--fov: expected degrees between 0 and 180"),
        (["none.mp4", "--fov", "200"], "--fov: expected degrees between 0 and 180, got 200"),
    ],
)
def test_a_source_or_a_field_of_view_that_cannot_be_used_is_refused(
    exported: tuple[Path, ...],
    words: list[str],
    message: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    pytest.importorskip("cv2")
    with pytest.raises(SystemExit):
        run_policy(monkeypatch, exported[0], *words)
    assert message in capsys.readouterr().err
