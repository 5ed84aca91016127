"""Policies are tested in places that their training never saw."""

import json
from pathlib import Path

from omegaconf import OmegaConf

from splatrl.configuration import load_config
from splatrl.experiments import Run, checked, planned
from splatrl.experiments.generalise import PLACES, choose_places, score_in_places, unlearned
from splatrl.experiments.tables import transfer_sentences, transfer_table
from splatrl.experiments.transfer import score_in
from tests.experiments.made_up import NODE, SCENES, compose
from tests.experiments.trained import save_run
from tests.tiny import LONG_STEPS
from tests.two_rooms import overrides, two_rooms


def test_places_are_the_test_places_whose_scenes_are_given(tmp_path: Path) -> None:
    choose_places(tmp_path, {"backyard": ["scene=backyard"], "yards": ["scene=yards"]})
    assert json.loads((tmp_path / PLACES).read_text()) == {"backyard": {"overrides": ["scene=backyard"], "files": None}}


def test_scores_in_other_places_or_files_are_removed(tmp_path: Path) -> None:
    splat, scores = tmp_path / "kitchen.spz", tmp_path / "scores.json"
    splat.write_text("a kitchen")
    both = {"backyard": ["scene=backyard"], "kitchen": ["scene=kitchen", f"scene.path={splat}"]}
    for places, content, stay in (
        (both, "a kitchen", True),
        (both, "a kitchen", True),
        (both, "another kitchen", False),
        ({"backyard": both["backyard"]}, "another kitchen", False),
    ):
        scores.touch()
        splat.write_text(content)
        choose_places(tmp_path, places)
        assert scores.exists() == stay


def test_a_place_named_by_its_scene_yaml_has_the_digest_of_its_folder(tmp_path: Path) -> None:
    west, _ = two_rooms(tmp_path)
    scores, splat = tmp_path / "scores.json", next(west.glob("*.ply"))
    for more, stay in ((b"", True), (b"\n", False)):
        choose_places(tmp_path, {"kitchen": [f"scene={west / 'scene.yaml'}"]})
        scores.touch()
        splat.write_bytes(splat.read_bytes() + more)
        choose_places(tmp_path, {"kitchen": [f"scene={west / 'scene.yaml'}"]})
        assert scores.exists() == stay


def test_a_policy_is_tested_in_several_scenes_at_once_and_in_one(tmp_path: Path) -> None:
    west, east = two_rooms(tmp_path)
    words = [*overrides("fps"), *LONG_STEPS, "evaluation.starts=6", "task.max_steps=8"]
    cfg = load_config([*words, f"scene={west}"])
    save_run(tmp_path / "west-a-s0", cfg, 2)
    config = OmegaConf.to_container(cfg)
    assert isinstance(config, dict)
    settings = {str(key): value for key, value in config.items()}
    run = Run("west", "a", "an arm", 0, tmp_path / "west-a-s0", (f"scene={west}", *words), settings)
    places = {"backyard": ["scene=many", f"scene.paths=[{west},{east}]"], "kitchen": [f"scene={east}"]}
    choose_places(tmp_path, places)
    rows = score_in_places([run], tmp_path)
    assert [(row["place"], row["starts"]) for row in rows] == [("backyard", 6), ("kitchen", 6)]
    choose_places(tmp_path, {"backyard": places["backyard"]})
    assert rows[:1] == score_in_places([run], tmp_path)
    assert all(0 <= row["success_rate"] <= 1 for row in rows)


def test_runs_with_and_without_memory_are_tested_side_by_side(tmp_path: Path) -> None:
    words = [*overrides("pointnav"), "task.max_steps=8", f"scene={two_rooms(tmp_path)[0]}", "evaluation.starts=4"]
    runs = []
    for name, more in (("plain", []), ("gru", ["memory=gru"]), ("told", ["sensors=[pointgoal]"])):
        save_run(tmp_path / name, load_config([*words, *more]), 2)
        runs.append(Run("west", name, name, 0, tmp_path / name, (), {}))
    rows = score_in(runs, {"there": load_config(words)})
    assert [(row["run"], row["starts"]) for row in rows] == [("plain", 4), ("gru", 4), ("told", 4)]


def test_the_table_shows_places_in_which_nothing_was_trained(tmp_path: Path) -> None:
    experiment = planned("tried", checked("tried", NODE), SCENES, tmp_path, compose)
    row = {"run": experiment.runs[0].folder.name, "place": "unseen", "starts": 12, "success_rate": 0.5}
    row |= {"success_rate_argmax": 0.4, "collision_rate": 0.1, "spl": 0.25}
    lines = "\n".join(transfer_table([row], experiment))
    assert "unseen" in lines and "0.250" in lines


def test_baselines_that_learned_nothing_are_tested_too_and_listed_last(tmp_path: Path) -> None:
    place = load_config([*overrides("pointnav"), f"scene={two_rooms(tmp_path)[0]}", "evaluation.starts=16"])
    straight, taught = unlearned("west", place)
    assert (straight["place"], straight["starts"]) == ("west", 16)
    assert straight["success_rate"] <= taught["success_rate"] and taught["success_rate"] > 0.9
    experiment = planned("tried", checked("tried", NODE), SCENES, tmp_path, compose)
    learned = {"run": experiment.runs[0].folder.name, "place": "west", "starts": 16, "success_rate": 0.5}
    learned |= {"success_rate_argmax": 0.4, "collision_rate": 0.1, "spl": 0.25}
    rows = [line for line in transfer_table([straight, taught, learned], experiment) if line.startswith("| west")]
    assert ["straight" in line for line in rows] == [False, True, False] and "teacher" in rows[2]
    assert transfer_sentences([taught], experiment)[0].endswith(" (shortest-path teacher).")
