"""Words as people type them, with paths in their home directory or with odd names, and what Hydra reads."""

from pathlib import Path

import pytest

from splatrl.configuration import command_line, load_config
from splatrl.configuration.grammar import bare, readable
from tests.tiny import tiny_overrides


@pytest.mark.parametrize(
    "typed, read",
    [
        ("run=~/runs/1", "run=/home/me/runs/1"),
        ("run='~/runs/1'", "run='/home/me/runs/1'"),
        ("run=[~/a,~/b]", "run=[/home/me/a,/home/me/b]"),
        ("scene=~/a,~/b", "scene=/home/me/a,/home/me/b"),
        ("+own={a:~/a}", "+own={a:/home/me/a}"),
        ("+own={a: ~/a}", "+own={a: /home/me/a}"),
        ("scene.paths=[ ~/a, ~/b]", "scene.paths=[ /home/me/a, /home/me/b]"),
        ("folder=~", "folder=/home/me"),
        ("out=a/~b", "out='a/~b'"),
        ("~task.goal", "~task.goal"),
        ("~/garden", "~/garden"),
        ("run=möbel (2)", "run='möbel (2)'"),
        ("out=2026=1.onnx", "out='2026=1.onnx'"),
        ("out=a, b/d", "out='a, b/d'"),
        ("out=a [1]/d", "out='a [1]/d'"),
        ("record=[a]", "record='[a]'"),
        ("hydra.run.dir=my rün, a=1", "hydra.run.dir='my rün, a=1'"),
        ("out='a, b'", "out='a, b'"),
        ("out='a", "out='a"),
        ("out=null", "out=null"),
        ("folder=${now:%Y}/a", "folder=${now:%Y}/a"),
        ("task.goal=[1,2", "task.goal=[1,2"),
        ("seed=0,1", "seed=0,1"),
        ("collector.total_frames=1e6", "collector.total_frames=1000000"),
        ("collector.total_frames=2.5e5,1E+06", "collector.total_frames=250000,1000000"),
        ("optim.lr=1e-3", "optim.lr=1e-3"),
        ("optim.lr=1.25e1", "optim.lr=1.25e1"),
        ("logger.exp_name='1e6'", "logger.exp_name='1e6'"),
        ("out=1e6", "out=1e6"),
        ("task.max_steps=range(1,4)", "task.max_steps=range(1,4)"),
        ("--config-dir=möbel", "--config-dir=möbel"),
        ("garden", "garden"),
    ],
)
def test_home_directories_are_filled_in_and_odd_names_are_quoted(
    typed: str, read: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", "/home/me")
    monkeypatch.chdir(tmp_path)
    assert readable(typed) == read


def test_an_existing_path_is_quoted_whatever_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    name = "it's [1], a {room}"
    Path(name).mkdir()
    word = readable(f"scene={name}")
    assert word == r"scene='it\'s [1], a {room}'" and bare(word.partition("=")[2]) == name
    assert [bare(text) for text in ("", "'", "a", "'a'", '"a"', "'a\"")] == ["", "'", "a", "a", "a", "'a\""]


def test_scenes_runs_and_lists_of_scenes_may_lie_in_the_home_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    home = tmp_path / "Anna (2), möbel"
    (home / "run").mkdir(parents=True)
    (home / "run" / "config.yaml").touch()
    tiny_overrides(home)
    monkeypatch.setenv("HOME", str(home))
    assert load_config(command_line("train", ["scene=~/tiny.ply"])).scene.path == str(home / "tiny.ply")
    assert load_config(["scene=~/tiny.ply"]).scene.path == str(home / "tiny.ply")
    many = load_config(["scene=many", "scene.paths=['~/tiny.ply',yard:3]"])
    assert many.scene.places[0].scene.path == str(home / "tiny.ply")
    assert command_line("export", ["run=~/run"]) == [readable(f"run={home}/run")]
