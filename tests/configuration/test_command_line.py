"""The words of a command line: what is accepted, refused with what to type instead, and passed to Hydra."""

import shlex
from pathlib import Path

import pytest

from splatrl.configuration import (
    command_line,
    load_config,
    typed_overrides,
)
from splatrl.configuration.grammar import overrides_parser
from splatrl.configuration.sweeps import directed
from splatrl.scenes import write_gaussians
from tests.tiny import tiny_gaussians


def test_a_mistyped_key_is_refused_with_the_valid_keys() -> None:
    with pytest.raises(SystemExit, match=r"loss.gama: no such key, did you mean loss.gamma\? .*clip_epsilon"):
        command_line("train", ["scene=backyard", "loss.gama=0.9"])
    with pytest.raises(SystemExit, match=r"sede: no such key, did you mean seed\? .*collector"):
        command_line("train", ["sede=1"])
    with pytest.raises(SystemExit, match=r"no such key\. evaluation\.seed has no keys"):
        command_line("train", ["evaluation.seed.x=1"])
    with pytest.raises(SystemExit, match=r"task\.motion\.turn: no such key.*time_step"):
        command_line("train", ["task=fps", "motion@task.motion=drive", "task.motion.turn=1"])


@pytest.mark.parametrize(
    "arguments",
    [
        ["-m", "seed=0,1", "curriculum=distance,none", "hydra.run.dir=x", "+extra=1", "~loss.gamma"],
        ["+own.key=1", "~own.key", "~motion@task.motion", "~task.goal"],
        ["+rewards@own.rewards=unit", "~own.rewards.goal"],
        ["--cfg", "job", "scene=kitchen", "scene.path=/a/b.spz"],
        ["task=fps", "motion@task.motion=drive", "task.motion.time_step=0.1", "rewards@task.rewards=unit"],
    ],
)
def test_valid_overrides_sweeps_and_hydra_options_are_accepted_unchanged(arguments: list[str]) -> None:
    assert command_line("train", arguments) == arguments


def test_options_precede_what_a_scene_proposes_so_that_hydra_accepts_both(tmp_path: Path) -> None:
    write_gaussians(tmp_path / "room.ply", tiny_gaussians())
    (tmp_path / "scene.yaml").write_text("splat: room.ply\nrobot_height: 0.5\n")
    words = command_line("train", ["seed=1", f"scene={tmp_path}", "--cfg", "job"])
    assert words[:2] == ["--cfg", "job"]
    assert words[2:] == ["robot.height=0.5", "seed=1", "scene=file", f"scene.path='{tmp_path}'"]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["sensors=[lidar,sonar]"], "sensors: expected one of compass, .*, got sonar"),
        (["scene={0},{0}"], "scene: expected one value, got .*; type scene=many 'scene.paths=.* for several, or -m"),
        (["scene=[{0},{0}]"], "scene: expected one scene, got .*; type scene=many 'scene.paths="),
        (
            ["-m", "scene=backyard,{0}"],
            "scene: expected only names of configs, only existing paths, or only seeds .*, got /.* among others",
        ),
        (["-m", "scene=backyard,yard:1"], "scene: expected only names .*, got yard:1 among others"),
        (
            ["scene=yard:1,yard:2"],
            "scene: expected one value, got .*; type scene=many 'scene.paths=.* or -m for a sweep",
        ),
        (["scene=yards", "scene.count=1,2"], "scene.count: expected one value, got 1,2; .* or sweep trainings with -m"),
    ],
)
def test_invalid_lists_are_refused_with_what_to_type_instead(words: list[str], message: str, tmp_path: Path) -> None:
    (tmp_path / "blocks.yaml").touch()
    with pytest.raises(SystemExit, match=message):
        command_line("train", [word.format(tmp_path) for word in words])


@pytest.mark.parametrize("words", [["scene=yards"], ["scene=many", "scene.paths=[yard:1,yard:2]"]])
@pytest.mark.parametrize("name", ["view", "record"])
def test_a_command_for_one_scene_refuses_several_before_any_is_made(
    name: str, words: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for made in ("make_yards", "yard_proposals"):
        monkeypatch.setattr(f"splatrl.configuration.scene_files.{made}", lambda *made: pytest.fail("it made yards"))
    with pytest.raises(SystemExit, match=f"splatrl-{name}: scene: expected one scene .* got {words[0]}; type one of"):
        command_line(name, words)


@pytest.mark.parametrize("name", ["a,b", "a,$b"])
def test_a_path_with_a_comma_is_refused_with_the_quotes_that_it_needs(name: str, tmp_path: Path) -> None:
    (tmp_path / name).mkdir()
    with pytest.raises(SystemExit) as refused:
        command_line("train", ["scene=file", f"scene.path={tmp_path / name}"])
    said, _, typed = str(refused.value.code).partition("; type ")
    assert said == "splatrl-train: scene.path: expected quotes around a path with a comma"
    (word,) = shlex.split(typed)
    assert overrides_parser().parse_override(word).value() == str(tmp_path / name)


@pytest.mark.parametrize(
    "words", [["-m", "seed=0,1", "--cfg", "job"], ["--multirun", "--info=all"], ["-m", "-c", "all"]]
)
def test_a_sweep_that_would_only_be_shown_is_refused(words: list[str]) -> None:
    with pytest.raises(
        SystemExit, match=r"splatrl-train: -.*: expected no -m beside it, .*; leave out -m and all sweeps"
    ):
        command_line("train", words)


def test_a_pattern_sweeps_over_the_options_that_match_it() -> None:
    words = ["-m", "curriculum=glob(*)", "curriculum.first=3", "task=glob(*nav)", "task.goals=5"]
    assert command_line("train", words) == words


@pytest.mark.parametrize(
    ("typed", "added"),
    [
        (["hydra/sweeper=optuna"], ["hydra.sweeper.direction=maximize"]),
        (["hydra/sweeper=basic", "hydra/sweeper='optuna'"], ["hydra.sweeper.direction=maximize"]),
        (["hydra/sweeper=optuna", "hydra/sweeper=basic"], []),
        (["seed=0,1"], []),
    ],
)
def test_optuna_looks_for_the_highest_success_rate_unless_another_direction_is_typed(
    typed: list[str], added: list[str]
) -> None:
    for words in (["task=fps", *typed], [*typed, "hydra.sweeper.direction=minimize"]):
        assert directed(words) == [*added, *words], "Hydra takes the last direction"


def test_optuna_is_given_its_direction_after_options_whatever_the_config(monkeypatch: pytest.MonkeyPatch) -> None:
    words = ["hydra/sweeper=optuna", "optim.lr=interval(0.001,0.01)"]
    monkeypatch.setattr(typed_overrides, "_check_plugin", str)
    for option in ([], ["--config-dir", "mine"]):
        expected = ["-m", *option, "hydra.sweeper.direction=maximize", *words]
        assert command_line("train", ["-m", *option, *words]) == expected


def test_of_two_choices_from_a_group_the_last_one_holds() -> None:
    assert load_config(command_line("train", ["task=grid", "task=fps"])) == load_config(["task=grid", "task=fps"])
    assert load_config(["task=grid", "task=fps"]) == load_config(["task=fps"])
