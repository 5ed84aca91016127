"""Tables and sentences of reports."""

import json
import warnings
from pathlib import Path

import pytest

from splatrl.experiments.results import Spread, entries
from splatrl.experiments.tables import (
    chance_of_difference,
    main_table,
    marks_table,
    scores_sentences,
    scores_table,
    verdicts,
)
from tests.experiments.made_up import finish, made_up


def finished(folder: Path, *success: float) -> list[str]:
    """Return the verdicts for success rates of: yard with, hall with, yard without, for seed 0 and then for seed 1."""
    experiment = made_up(folder)
    for run, value in zip(experiment.runs, success, strict=False):
        finish(run, value)
    return verdicts(entries(experiment))


def test_a_lead_that_chance_hardly_explains_wins(tmp_path: Path) -> None:
    first, second = finished(tmp_path, 0.90, 0.5, 0.70, 0.92, 0.5, 0.72)
    assert first == "- **yard, 430 frames**: with it won with 91.0 ± 1.4 %, against without 71.0 ± 1.4 % (p = 0.005)."
    assert second == "- **hall, 430 frames**: with it reaches 50.0 ± 0.0 %, SPL 0.400 ± 0.000, over 2 seeds."


def test_a_lead_that_chance_may_explain_wins_nothing_even_if_it_exceeds_the_spread_of_seeds(tmp_path: Path) -> None:
    assert finished(tmp_path, 0.966, 0.5, 0.893, 0.910, 0.5, 0.891)[0] == (
        "- **yard, 430 frames**: no clear winner; with it 93.8 ± 4.0 %, without 89.2 ± 0.1 %: chance may explain how "
        "the first two differ (p = 0.35)."
    )


def test_the_chance_of_a_difference_is_that_of_welchs_t_test() -> None:
    assert chance_of_difference(Spread((0.1, 0.2, 0.3)), Spread((0.2, 0.4))) == pytest.approx(
        0.4921, abs=1e-4
    )  # t = 0.866 with 1.684 degrees of freedom
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # the same values in one arm are no reason for one
        alike = chance_of_difference(Spread((0.078112, 0.078112)), Spread((0.05, 0.054)))
    assert alike == pytest.approx(0.0487, abs=1e-4)
    assert chance_of_difference(Spread((0.5, 0.5)), Spread((0.5, 0.5))) == pytest.approx(1.0)
    assert chance_of_difference(Spread((0.5,) * 2), Spread((0.6,) * 2)) == pytest.approx(1 / 3)  # of the permutation
    assert chance_of_difference(Spread((0.5,) * 5), Spread((0.6,) * 4)) == pytest.approx(1 / 63)  # test, where t is 0/0


def test_a_single_seed_is_not_conclusive(tmp_path: Path) -> None:
    assert "with it is ahead" in (found := finished(tmp_path, 0.9, 0.5, 0.2)[0])
    assert "a single seed is not conclusive" in found


def test_equal_rates_of_single_seeds_have_no_winner(tmp_path: Path) -> None:
    assert finished(tmp_path, 0.9, 0.5, 0.9)[0] == (
        "- **yard, 430 frames**: with it and without are level with 90.0 %; a single seed is not conclusive."
    )


def test_spl_by_distance_is_preferred_where_a_task_measures_it(tmp_path: Path) -> None:
    experiment = made_up(tmp_path)
    for run in experiment.runs[:2]:
        finish(run, 0.8)
    path = experiment.runs[0].folder / "evaluation.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"spl": 0.123}))
    found = {(entry.scene, entry.label): entry.spl().text(3) for entry in entries(experiment) if entry.runs}
    assert sorted(found.values()) == ["0.123", "0.700"]


def test_the_main_table_has_one_row_per_arm_and_scene(tmp_path: Path) -> None:
    experiment = made_up(tmp_path)
    for run in experiment.runs[:3]:
        finish(run, 0.8, seconds=8.0)
    found = entries(experiment)
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in main_table(found)]
    assert len({len(row) for row in rows}) == 1
    assert rows[2] == ["yard", "with it", "0", "**80.0 %**", "40.0 %", "0.700", "3.0", "400", "8", "50"]
    assert dict(zip(rows[0], rows[3], strict=True))["level"] == "–"  # there is no level without a curriculum
    marks = marks_table(found, experiment)
    assert marks[2] == "| yard | with it | 50.0 % | 95.0 % | 400 | 2.0 | 1 of 1 |"


def test_matches_are_given_for_each_clip_and_for_all_frames_together(tmp_path: Path) -> None:
    experiment = made_up(tmp_path)
    scores = [
        {"run": f"yard-with-s{seed}", "clip": clip, "frames": frames, "matches": matches}
        for seed, clip, frames, matches in [(0, "a", 10, 5), (0, "b", 30, 27), (1, "a", 10, 7), (1, "b", 30, 29)]
    ]
    scores.append({"run": "yard-without-s0", "clip": "a", "frames": 10, "matches": 2})
    rows = scores_table([*scores, {"run": "another", "clip": "a", "frames": 1, "matches": 1}], experiment)[2:]
    assert [row.split(" | ")[1:] for row in rows] == [
        ["a", "10", "60.0 ± 14.1 %", "20.0 % |"],
        ["b", "30", "93.3 ± 4.7 %", "– |"],
        ["**all**", "40", "85.0 ± 7.1 %", "20.0 % |"],
    ]
    assert scores_sentences(scores, experiment) == [
        "- **yard, labelled clips**: fraction of 40 frames in which the actions match: "
        "with it 85.0 ± 7.1 %, without 20.0 %."
    ]


@pytest.mark.parametrize("done", [0, 1, 6])
def test_tables_can_be_made_with_any_number_of_finished_runs(tmp_path: Path, done: int) -> None:
    experiment = made_up(tmp_path)
    for run in experiment.runs[:done]:
        finish(run, 0.5)
    found = entries(experiment)
    assert len(main_table(found)) == len(marks_table(found, experiment)) == 2 + 3
