"""The schedule of a curriculum, which is a pure state machine."""

import math
from typing import Any

import pytest
import torch
from hypothesis import example, given
from hypothesis import strategies as st
from torch import Tensor

from splatrl.curriculum import Schedule

ROWS = 5
Flags = list[bool]
Counts = tuple[Tensor, Tensor]  # progress and members


def start(schedule: Schedule, rows: int = ROWS) -> Counts:
    return schedule.start(), torch.zeros(rows, dtype=torch.bool)


def begun(schedule: Schedule, counts: Counts, rows: Flags) -> Counts:
    return schedule.begin(*counts, torch.tensor(rows))


def ended(schedule: Schedule, counts: Counts, rows: Flags, success: Flags) -> Counts:
    return schedule.advance(*counts, torch.tensor(rows), torch.tensor(success))


schedules = st.builds(Schedule, levels=st.integers(1, 4), threshold=st.floats(0.05, 1.0), window=st.integers(1, 12))
flags = st.lists(st.booleans(), min_size=ROWS, max_size=ROWS)
turns = st.lists(st.tuples(flags, flags, flags), max_size=25)  # rows that begin, rows that end, and that succeed


@given(schedules, turns)
def test_progress_matches_a_tally_in_plain_python(schedule: Schedule, turns: list[tuple[Flags, Flags, Flags]]) -> None:
    counts = start(schedule)
    level, joined, results, members = 0, 0, list[bool](), set[int]()

    def leave(rows: list[int], won: Flags) -> None:
        nonlocal level, joined
        results.extend(won[row] for row in rows if row in members)
        members.difference_update(rows)
        if promoted := sum(results) >= schedule.threshold * schedule.window - 1e-9:
            level = min(level + 1, schedule.levels - 1)
        if promoted or sum(results) + schedule.window - len(results) < schedule.threshold * schedule.window - 1e-9:
            joined = 0
            results.clear()
            members.clear()

    for begins, ends, won in turns:
        counts = begun(schedule, counts, begins)
        rows = [row for row in range(ROWS) if begins[row]]
        leave(rows, [False] * ROWS)
        for row in rows[: schedule.window - joined]:
            members.add(row)
            joined += 1
        assert counts[0].tolist() == [level, len(results), sum(results)]
        counts = ended(schedule, counts, ends, won)
        leave([row for row in range(ROWS) if ends[row]], won)
        assert counts[0].tolist() == [level, len(results), sum(results)]
        assert counts[1].tolist() == [row in members for row in range(ROWS)]


@given(schedules, turns)
def test_the_level_never_falls_or_jumps_or_leaves_its_range(
    schedule: Schedule, turns: list[tuple[Flags, Flags, Flags]]
) -> None:
    counts = start(schedule)
    for begins, ends, won in turns:
        before = counts[0]
        counts = ended(schedule, begun(schedule, counts, begins), ends, won)
        (level, episodes, successes), members = counts
        assert 0 <= level - before[0] <= 1 and level < schedule.levels
        assert 0 <= successes <= episodes and episodes + members.sum() <= schedule.window


def test_advancing_returns_new_tensors_and_leaves_the_given_ones_unchanged() -> None:
    schedule = Schedule(levels=2, window=3)
    first = start(schedule, 1)
    second = begun(schedule, first, [True])
    ended(schedule, second, [True], [True])
    assert first[0].tolist() == second[0].tolist() == [0, 0, 0]
    assert not first[1].any() and second[1].all()


@given(st.integers(1, 200).flatmap(lambda window: st.tuples(st.integers(1, window), st.just(window))))
@example((7, 100))  # whose quotient times 100 is a little more than 7
def test_exactly_the_threshold_promotes_and_one_success_less_starts_a_new_cohort(counts: tuple[int, int]) -> None:
    wins, window = counts
    schedule = Schedule(levels=3, threshold=wins / window, window=window)
    assert schedule.enough == wins
    enough = [True] * wins + [False] * (window - wins)
    for won, level in ((enough, 1), ([False, *enough[1:]], 0)):
        running = begun(schedule, start(schedule, window), [True] * window)
        progress, members = ended(schedule, running, [True] * window, won)
        assert progress.tolist() == [level, 0, 0] and not members.any()


@pytest.mark.parametrize(("won", "ends", "level"), [(True, 3, 1), (False, 2, 0)])
def test_a_cohort_is_decided_as_soon_as_it_is_certain(won: bool, ends: int, level: int) -> None:
    schedule = Schedule(levels=3, threshold=0.75, window=4)
    counts = begun(schedule, start(schedule, 6), [True] * 6)
    for row in range(ends):
        assert counts[1].tolist() == [row <= one < 4 for one in range(6)]
        counts = ended(schedule, counts, [one == row for one in range(6)], [won] * 6)
    assert counts[0].tolist() == [level, 0, 0] and not counts[1].any()
    again = begun(schedule, counts, [True, False] * 3)
    assert again[1].tolist() == [True, False] * 3


def test_episodes_that_begin_after_the_cohort_is_complete_do_not_count() -> None:
    schedule = Schedule(levels=3, threshold=1.0, window=2)
    counts = begun(schedule, start(schedule, 4), [False, True, True, True])
    assert counts[1].tolist() == [False, True, True, False]
    counts = ended(schedule, counts, [False, False, True, True], [True] * 4)
    assert counts[0].tolist() == [0, 1, 1]
    assert begun(schedule, counts, [False, False, True, True])[1].tolist() == [False, True, False, False]


def test_a_member_that_begins_anew_before_it_has_ended_has_failed() -> None:
    schedule = Schedule(levels=3, threshold=0.5, window=4)
    counts = begun(schedule, start(schedule, 3), [True, True, False])
    counts = begun(schedule, counts, [True, False, True])
    assert counts[0].tolist() == [0, 1, 0] and counts[1].all()


def test_quick_successes_do_not_promote_while_slow_failures_still_run() -> None:
    """Half of all episodes succeed, after one step; the others fail after fifty."""
    schedule, generator = Schedule(levels=20), torch.Generator().manual_seed(0)
    left = torch.zeros(1000, dtype=torch.int64)
    counts, ends = start(schedule, 1000), torch.ones(1000, dtype=torch.bool)
    won, quick = torch.zeros_like(ends), 0
    for _ in range(500):
        counts = schedule.begin(*schedule.advance(*counts, ends, won), ends)
        draws = torch.rand(1000, generator=generator) < 0.5
        won = torch.where(ends, draws, won)
        left = torch.where(ends, torch.where(draws, 1, 50), left) - 1
        ends = left == 0
        quick += int((ends & won).sum())
    assert quick > 1000 and counts[0][0] == 0


def test_the_last_level_is_never_left() -> None:
    schedule = Schedule(levels=2, threshold=0.5, window=1)
    counts = start(schedule, 1)
    for _ in range(4):
        counts = ended(schedule, begun(schedule, counts, [True]), [True], [True])
    assert counts[0].tolist() == [1, 0, 0]


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
