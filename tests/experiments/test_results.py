"""Results are aggregated over seeds."""

import math
from pathlib import Path

import pytest

from splatrl.experiments.results import Spread, comparable, entries, success_in_tests, success_near
from tests.experiments.made_up import begin, finish, made_up


def test_a_spread_has_the_mean_and_the_sample_standard_deviation() -> None:
    spread = Spread((0.9, 0.8, 1.0))
    assert spread.mean == pytest.approx(0.9)
    assert spread.deviation == pytest.approx(0.1)
    assert spread.percent() == "90.0 ± 10.0 %"


def test_a_spread_of_one_seed_has_no_deviation_and_an_empty_one_has_no_mean() -> None:
    assert Spread((1234.4,)).text() == "1,234"
    assert Spread(()).text() == Spread(()).percent() == "–"


def test_entries_hold_only_finished_runs_and_are_ordered_by_scene(tmp_path: Path) -> None:
    experiment = made_up(tmp_path)
    finish(experiment.runs[0], 0.5)
    begin(experiment.runs[1], 80)
    found = entries(experiment)
    assert [(entry.scene, entry.label, len(entry.runs)) for entry in found] == [
        ("yard", "with it", 1),
        ("yard", "without", 0),
        ("hall", "with it", 0),
    ]
    assert [[entry.label for entry in group] for group in comparable(found)] == [["with it"]]


def test_an_entry_gives_its_values_its_speed_its_median_seed_and_its_test_results(tmp_path: Path) -> None:
    experiment = made_up(tmp_path, selection=None)
    for run, success in zip(experiment.runs, (0.9, 0.1, 0.2, 0.7, 0.3, 0.4), strict=True):
        finish(run, success, seconds=8.0)
    entry = entries(experiment)[0]
    assert entry.spread("success_rate").values == (0.9, 0.7)
    assert entry.spread("no such figure").values == ()
    assert entry.speed().values == (50.0, 50.0)
    assert entry.median().seed == 1
    assert entry.tested_at(200).values == (0.5, 0.5)
    assert entry.frames_to(0.9).values == (400.0, 400.0)
    assert entry.frames_to(0.99).values == ()
    assert entry.minutes_to(0.9).values == (2.0, 2.0)
    assert entry.minutes_to(0.99).values == ()


def test_the_success_of_a_test_counts_for_frames_within_one_batch_of_it() -> None:
    rows = [{"frames": 40.0, "test_success": math.nan}, {"frames": 200.0, "test_success": 0.5}, {"frames": 240.0}]
    assert success_in_tests(rows) == [(200, 0.5)]
    assert success_near(rows, 161) == success_near(rows, 239) == 0.5
    assert success_near(rows, 160) is None
    assert success_near([], 160) is None
    shown = [{"frames": 5, "test_success": 0.1}, {"frames": 45}, {"frames": 85, "test_success": 0.7}]
    assert success_near(shown, 110) == 0.7, "the first row counts five demonstrated frames, which are no batch"
