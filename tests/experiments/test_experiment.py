"""Experiments are data, from which their runs are planned."""

from pathlib import Path
from typing import Any

import pytest

from splatrl.experiments import Selection
from tests.experiments.made_up import NODE, made_up


def test_every_arm_is_trained_in_its_scenes_with_its_seeds(tmp_path: Path) -> None:
    names = {run.folder.relative_to(tmp_path).as_posix() for run in made_up(tmp_path).runs}
    places = ("yard-with", "hall-with", "yard-without")
    assert names == {f"tried/{place}-s{seed}" for place in places for seed in (0, 1)}


def test_every_arm_runs_its_first_seed_before_any_arm_runs_its_second(tmp_path: Path) -> None:
    assert [run.seed for run in made_up(tmp_path).runs] == [0, 0, 0, 1, 1, 1]


def test_a_run_has_its_overrides_its_config_and_a_whole_number_of_batches(tmp_path: Path) -> None:
    run = made_up(tmp_path).runs[-1]
    assert run.overrides == ("scene=yard", "curriculum=no", "seed=1")
    assert run.config["seed"] == 1
    assert (run.budget, run.frames) == (430, 400)
    assert not run.has_curriculum


def test_seeds_frames_and_scenes_can_be_chosen(tmp_path: Path) -> None:
    runs = made_up(tmp_path, selection=Selection(seeds=[7], frames=120, scenes=["hall"])).runs
    assert [(run.scene, run.seed, run.frames) for run in runs] == [("hall", 7, 120)]
    assert "collector.total_frames=120" in runs[0].overrides


def test_an_arm_that_frames_make_equal_to_another_is_left_out_and_the_report_says_so(tmp_path: Path) -> None:
    with_it = NODE["arms"]["with"]
    longer = {"label": "with it, longer", "overrides": ["curriculum=yes", "collector.total_frames=900"]}
    node: dict[str, Any] = NODE | {"arms": NODE["arms"] | {"long": with_it | longer | {"seeds": [0]}}}
    whole, short = made_up(tmp_path, node), made_up(tmp_path, node, Selection(frames=120, scenes=["hall"]))
    assert {run.arm for run in whole.runs} == {"with", "without", "long"} and not whole.left_out
    assert {run.arm for run in short.runs} == {"with"}
    said = "hall: with it, longer is left out, since with 120 frames it is the same training as with it."
    assert short.left_out == (said,)


def test_an_unknown_key_of_an_arm_is_named(tmp_path: Path) -> None:
    node: dict[str, Any] = NODE | {"arms": {"with": NODE["arms"]["with"] | {"sedes": [0]}}}
    with pytest.raises(ValueError, match=r"experiments\.tried\.arms\.with: expected the keys .*, got .*sedes"):
        made_up(tmp_path, node)


def test_a_missing_key_of_an_experiment_is_named(tmp_path: Path) -> None:
    node = {key: value for key, value in NODE.items() if key != "question"}
    with pytest.raises(ValueError, match=r"experiments\.tried: expected the keys .*question"):
        made_up(tmp_path, node)


@pytest.mark.parametrize(("arms", "where"), [([1], r"\.arms: expected an arm"), ({"one": 1}, r"\.arms\.one: expected")])
def test_arms_that_are_none_are_named(tmp_path: Path, arms: object, where: str) -> None:
    with pytest.raises(ValueError, match=rf"experiments\.tried{where}"):
        made_up(tmp_path, NODE | {"arms": arms})


@pytest.mark.parametrize("value", [None, "yard"])
@pytest.mark.parametrize("key", ["overrides", "scenes", "seeds"])
def test_lists_of_an_arm_that_are_none_are_named(tmp_path: Path, key: str, value: object) -> None:
    node: dict[str, Any] = NODE | {"arms": {"with": NODE["arms"]["with"] | {key: value}}}
    with pytest.raises(ValueError, match=rf"experiments\.tried\.arms\.with\.{key}: expected a list, got {value!r}"):
        made_up(tmp_path, node)


def test_an_experiment_of_ones_own_need_not_say_what_the_paper_found(tmp_path: Path) -> None:
    node = {key: value for key, value in NODE.items() if key != "paper"}
    assert made_up(tmp_path, node).paper is None
