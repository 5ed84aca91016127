"""``splatrl-export`` from the outside, and the script that it writes."""

import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from splatrl.commands.export import main
from splatrl.configuration import load_config
from splatrl.evaluation.clips import fitted
from splatrl.images import open_video
from splatrl.runs import load_policy
from tests.experiments.trained import BEST, NAMES, config, save_run
from tests.tiny import tiny_overrides

pytest.importorskip("onnxruntime", reason="needs the extra export")
pytest.importorskip("onnxscript", reason="needs the extra export")

pytestmark = pytest.mark.usefixtures("translated_once")


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    return save_run(folder / "run", config(folder, "memory=stack"), 1)


def command(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> None:
    monkeypatch.setattr(sys, "argv", ["splatrl-export", *arguments])
    main()


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


def test_a_policy_is_exported_and_run_on_a_video(
    run: Path, film: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    command(monkeypatch, f"run={run}", "frames=64")
    printed = capsys.readouterr().out
    assert str(run / "export" / "policy.onnx") in printed and "on 64 views" in printed
    done = subprocess.run(
        [sys.executable, str(run / "export" / "run_policy.py"), str(film)], capture_output=True, text=True, check=True
    )
    lines = [line.split(maxsplit=2) for line in done.stdout.splitlines()]
    assert [(number, name) for number, name, _ in lines] == [(str(number), NAMES[1]) for number in range(5)]
    trained = load_policy(run)
    with open_video(film) as video:
        images = [fitted(frame.to_image(), 12, 16) for frame in video.decode(video=0)]
    seen = [images[0]] * 3
    for image, (_, _, told) in zip(images, lines, strict=True):
        seen = [*seen[-3:], image]
        td = trained.beginning()
        td["pixels"] = np.concatenate(seen, -1)[None]
        expected = trained.policy(td)["logits"][0].softmax(-1).detach().numpy()
        found = np.array(told.strip("[] ").split(), float)
        np.testing.assert_allclose(found, expected, atol=2e-3)  # areas are averaged and rounded in other ways


def test_a_wider_camera_is_cropped_to_the_policys_field_of_view(
    run: Path, film: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    command(monkeypatch, f"run={run}", f"output={tmp_path / 'new'}", "frames=8", "checkpoint=best")
    told = {}
    for fov in ("90", "60", "127"):
        line = [sys.executable, str(tmp_path / "new" / "run_policy.py"), str(film), "--fov", fov]
        told[fov] = subprocess.run(line, capture_output=True, text=True, check=True).stdout
        assert told[fov].startswith(f"0 {NAMES[BEST]} ")
    assert told["90"] == told["60"] != told["127"]


def test_what_a_policy_observes_besides_is_given_by_hand(
    film: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    chosen = load_config([*tiny_overrides(tmp_path, "pointnav"), "sensors=[rgb,imagegoal,pointgoal]"])
    run = save_run(tmp_path / "run", chosen, 1)
    command(monkeypatch, f"run={run}", "frames=8")
    picture = str(tmp_path / "goal.png")
    cv2.imwrite(picture, np.full((24, 32, 3), 90, np.uint8))
    line = [sys.executable, str(run / "export" / "run_policy.py"), str(film), "--give", f"imagegoal={picture}"]
    told = [
        subprocess.run([*line, *more], capture_output=True, text=True)
        for more in (["--give", "pointgoal_with_gps_compass=2.5,0.3"], [], ["--give", "pointgoal_with_gps_compass=2"])
    ]
    assert told[0].returncode == 0 and len(told[0].stdout.splitlines()) == 5, told[0].stderr
    assert "--give: expected imagegoal and pointgoal_with_gps_compass for this policy" in told[1].stderr
    assert told[2].returncode != 0 and not told[2].stdout


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["run=nowhere"], "splatrl-export: run: expected a run folder"),
        ([], "splatrl-export: run: expected a value, got none"),
        (["run={run}", "frames=none"], "splatrl-export: frames: expected a number"),
        (["run={run}", "checkpoint=first"], "splatrl-export: checkpoint: expected last or best, got 'first'"),
        (["run={run}", "out=x"], "out: no such key, did you mean output"),
    ],
)
def test_what_is_wrong_is_said_in_a_line(
    run: Path, arguments: list[str], message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(SystemExit, match=message):
        command(monkeypatch, *(argument.format(run=run) for argument in arguments))
