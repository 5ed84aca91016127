"""End-to-end tests of ``splatrl-clips``."""

import json
import shutil
import sys
from pathlib import Path

import pytest

from splatrl.commands.clips import main
from splatrl.evaluation.clip_files import read_clips
from tests.experiments.trained import BEST, NAMES, three_runs, two_clips


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return three_runs(tmp_path_factory.mktemp("runs"))


@pytest.fixture(scope="module")
def clips(runs: Path) -> Path:
    return two_clips(runs)


@pytest.fixture
def film(clips: Path, tmp_path: Path) -> Path:
    """The first frames of a clip, without labels."""
    folder = tmp_path / "walk"
    folder.mkdir()
    for path in sorted((clips / "walk-00").glob("*.png"))[:8]:
        shutil.copy(path, folder)
    return folder


def command(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> None:
    monkeypatch.setattr(sys, "argv", ["splatrl-clips", *arguments])
    main()


def share(clips: Path, action: int) -> float:
    labels = [label for clip in read_clips(clips, NAMES) for label in clip.labels.values()]
    return sum(action in label for label in labels) / len(labels)


def test_runs_are_compared_side_by_side(
    runs: Path, clips: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    names = [str(runs / name) for name in ("forward", "back", "stacked")]
    command(monkeypatch, f"run=[{','.join(names)}]", f"clips={clips}")
    printed = capsys.readouterr().out
    page = (clips / "clips.md").read_text()
    assert page in printed
    lines = [line for line in page.splitlines() if line.startswith("|")]
    assert lines[0] == f"| clip | frames | {' | '.join(names)} |"
    assert [line.split(" | ")[0] for line in lines[2:]] == ["| walk-00", "| walk-01", "| total"]
    content = json.loads((clips / "clips.json").read_text())
    for action, name in enumerate(names):
        assert content[name]["rate"] == pytest.approx(share(clips, action))
        assert f"{content[name]['rate']:.3f}" in lines[-1]
        assert sum(one["frames"] for one in content[name]["clips"]) == int(lines[-1].split(" | ")[1])
    assert 0 < content[names[0]]["rate"] != content[names[1]]["rate"]


def test_clips_can_be_recorded_and_scored_in_one_command(
    runs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    record, output = tmp_path / "new", tmp_path / "report" / "here"
    command(
        monkeypatch,
        f"run={runs / 'forward'}",
        f"record={record}",
        f"clips={record}",
        f"out={output}",
        "checkpoint=best",
        "count=2",
        "height=24",
        "hand.frames=2",
    )
    found = read_clips(record, NAMES)
    assert [clip.name for clip in found] == ["walk-00", "walk-01"]
    assert {image.size for clip in found for image in clip.images()} == {(32, 24)}
    content = json.loads((output / "clips.json").read_text())
    assert content[str(runs / "forward")]["rate"] == pytest.approx(share(record, BEST))
    assert not (record / "clips.md").exists()


def test_the_actions_of_policies_are_drawn_beside_a_video_without_labels(
    runs: Path, film: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    command(monkeypatch, f"run=[{runs / 'forward'},{runs / 'back'}]", f"film={film}", f"out={tmp_path / 'out'}")
    printed = capsys.readouterr().out
    written = {f"walk-{run}.{kind}" for run in ("forward", "back") for kind in ("mp4", "csv")}
    assert {path.name for path in (tmp_path / "out").iterdir()} == written
    assert all(str(tmp_path / "out" / name) in printed for name in written)
    command(monkeypatch, f"run={runs / 'forward'}", f"film={film}")
    for kind in ("mp4", "csv"):
        own = runs / "forward" / "films" / f"walk.{kind}"
        assert own.read_bytes() == (tmp_path / "out" / f"walk-forward.{kind}").read_bytes()
    for action, run in enumerate(("forward", "back")):
        rows = (tmp_path / "out" / f"walk-{run}.csv").read_text().splitlines()
        assert rows[0] == f"frame,action,{','.join(NAMES)}" and len(rows) == 1 + len(list(film.iterdir()))
        assert all(row.split(",")[1] == NAMES[action] for row in rows[1:])


def test_a_line_says_what_a_policy_sees_of_a_film_at_its_field_of_view(
    runs: Path,
    clips: Path,
    film: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def said(*arguments: str) -> list[str]:
        command(monkeypatch, f"run={runs / 'forward'}", f"out={tmp_path}", *arguments)
        return [line for line in capsys.readouterr().out.splitlines() if "shows" in line]

    shown = "shows 60° × 47° of the policy's 90° × 74°; its edges are repeated beyond"
    assert said(f"film={film}") == said(f"film={film}", "fov=110") == []
    assert said(f"film={film}", "fov=60") == [f"{film} {shown}"]
    assert said(f"clips={clips}", "fov=60") == [f"{clips / name} {shown}" for name in ("walk-00", "walk-01")]
    with pytest.raises(SystemExit, match="fov: expected a number of degrees from 1 to 179, got 0"):
        said(f"film={film}", "fov=0")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ["run=[a]"],
            "clips: expected at least one of clips=<a folder>, film=<a video> and record=<a new folder>, got none",
        ),
        (["run=[a,a]", "clips=c"], "run: expected distinct run folders, got a, a"),
        (["run=[]", "clips=c"], "run: expected distinct run folders, got none"),
        (
            ["run=[a/0,b/0]", "film=c.mp4", "out=d"],
            "run: expected folders of different names, which name the films, got a/0, b/0",
        ),
        (["clips=c"], "run: expected a value, got none; type run=<run folder>"),
        (["run=nowhere", "clips=c"], "run: expected a run folder with config.yaml, got nowhere"),
    ],
)
def test_missing_and_invalid_arguments_are_reported(
    monkeypatch: pytest.MonkeyPatch, arguments: list[str], message: str
) -> None:
    with pytest.raises(SystemExit, match=message):
        command(monkeypatch, *arguments)


def test_an_unknown_key_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(SystemExit, match="clip: no such key, did you mean clips"):
        command(monkeypatch, "run=a", "clip=c")
