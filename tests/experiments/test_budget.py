"""Budgets of experiments: what is left to train, and how long it takes."""

from pathlib import Path

import pytest

from splatrl.experiments import budget, statement
from tests.experiments.made_up import NODE, begin, finish, made_up


def test_a_budget_subtracts_frames_of_begun_runs_and_uses_the_expected_speed(tmp_path: Path) -> None:
    experiment = made_up(tmp_path)
    begin(experiment.runs[0], 120)
    found = budget(experiment)
    assert (found.trainings, found.finished, found.seeds) == (6, 0, (0, 1))
    assert (found.frames, found.frames_left) == (2400, 2280)
    assert found.seconds_left == 2280 / 100 + 6 * 10
    assert "expected" in str(found)


def test_a_budget_uses_the_measured_speed_of_finished_runs(tmp_path: Path) -> None:
    experiment = made_up(tmp_path)
    for run in experiment.runs[:2]:
        finish(run, 0.5, seconds=20.0)
    found = budget(experiment)
    assert (found.speed, found.measured, found.finished) == (20.0, 2, 2)
    assert found.seconds_left == 1600 / 20 + 4 * 10


@pytest.mark.parametrize(("jobs", "time"), [(1, "3.3 h"), (4, "49 min")])
def test_the_statement_sums_over_experiments(tmp_path: Path, jobs: int, time: str) -> None:
    experiments = [made_up(tmp_path / name, NODE | {"overhead": 980}) for name in "ab"]
    *each, last = statement([budget(experiment) for experiment in experiments], jobs).splitlines()
    assert len(each) == 2
    assert last == f"12 of 12 trainings to do, 4,800 frames, about {time}, {jobs} at a time"
