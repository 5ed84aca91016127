"""The schedule of a curriculum, which is a pure state machine."""

import math
from typing import Any

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from splatrl.curriculum import Schedule

Ends = list[tuple[int, bool, bool]]  # level at which the episode began, whether it ended, whether it succeeded


def advance(schedule: Schedule, progress: torch.Tensor, ends: Ends) -> torch.Tensor:
    level, finished, success = (torch.tensor(column) for column in zip(*ends, strict=True))
    return schedule.advance(progress, level, finished, success)


schedules = st.builds(Schedule, levels=st.integers(1, 4), threshold=st.floats(0.05, 1.0), window=st.integers(1, 12))
batches = st.lists(
    st.lists(st.tuples(st.integers(-1, 4), st.booleans(), st.booleans()), min_size=1, max_size=8), max_size=25
)


@given(schedules, batches)
def test_progress_matches_a_tally_in_plain_python(schedule: Schedule, batches: list[Ends]) -> None:
    progress = schedule.start()
    level = episodes = successes = 0
    for ends in batches:
        progress = advance(schedule, progress, ends)
        counted = [won for began, ended, won in ends if ended and began == level]
        episodes, successes = episodes + len(counted), successes + sum(counted)
        if episodes >= schedule.window:
            enough = successes >= schedule.threshold * episodes - 1e-9
            level = min(level + enough, schedule.levels - 1)
            episodes = successes = 0
        assert progress.tolist() == [level, episodes, successes]


@given(schedules, batches)
def test_the_level_never_falls_or_jumps_or_leaves_its_range(schedule: Schedule, batches: list[Ends]) -> None:
    progress = schedule.start()
    for ends in batches:
        later = advance(schedule, progress, ends)
        assert 0 <= later[0] - progress[0] <= 1
        assert 0 <= later[0] < schedule.levels
        assert 0 <= later[2] <= later[1] < schedule.window
        progress = later


def test_advancing_returns_a_new_tensor_and_leaves_the_given_one_unchanged() -> None:
    schedule = Schedule(levels=2, window=3)
    progress = schedule.start()
    advance(schedule, progress, [(0, True, True)])
    assert progress.tolist() == [0, 0, 0]


@given(st.integers(1, 200).flatmap(lambda window: st.tuples(st.integers(1, window), st.just(window))))
def test_exactly_the_threshold_promotes_and_one_success_less_starts_a_new_window(counts: tuple[int, int]) -> None:
    wins, window = counts
    schedule = Schedule(levels=3, threshold=wins / window, window=window)
    enough = [(0, True, True)] * wins + [(0, True, False)] * (window - wins)
    less = [(0, True, False), *enough[1:]]
    assert advance(schedule, schedule.start(), enough).tolist() == [1, 0, 0]
    assert advance(schedule, schedule.start(), less).tolist() == [0, 0, 0]


def test_the_last_level_is_never_left() -> None:
    schedule = Schedule(levels=2, threshold=0.5, window=1)
    progress = schedule.start()
    for level in (0, 1, 1, 1):
        progress = advance(schedule, progress, [(level, True, True)])
    assert progress.tolist() == [1, 0, 0]


def test_episodes_of_another_level_do_not_count() -> None:
    schedule = Schedule(levels=3, threshold=0.5, window=2)
    progress = advance(schedule, torch.tensor([1, 0, 0]), [(0, True, True), (-1, True, True), (2, True, True)])
    assert progress.tolist() == [1, 0, 0]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"levels": 0}, "levels: expected a whole number of at least 1, got 0"),
        ({"threshold": 0.0}, r"threshold: expected a success rate in \(0, 1\], got 0\.0"),
        ({"threshold": 1.1}, "threshold"),
        ({"threshold": math.nan}, "threshold"),
        ({"window": 0}, r"curriculum\.window: expected a whole number of at least 1, got 0"),
    ],
)
def test_invalid_settings_are_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Schedule(**{"levels": 2, **change})
