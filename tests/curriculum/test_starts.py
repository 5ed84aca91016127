"""Start states of the levels of a curriculum."""

from dataclasses import replace

import pytest
import torch

from splatrl.curriculum import Curriculum, Starts
from tests.tiny import tiny_plan

COUNT = 20000


def draw(starts: Starts, level: int, count: int = COUNT, seed: int = 0) -> torch.Tensor:
    return starts.sample(torch.tensor(level), count, torch.Generator().manual_seed(seed))


def distances(states: torch.Tensor) -> torch.Tensor:
    plan = tiny_plan()
    rows = (states[:, None] == plan.states).all(2).int().argmax(1)
    return plan.distance[rows]


@pytest.mark.parametrize(("first", "stride", "limits"), [(2, 1, range(2, 10)), (3, 4, [3, 7, 11]), (1, 8, [1, 9])])
def test_a_level_starts_within_its_number_of_steps_from_the_goal(first: int, stride: int, limits: list[int]) -> None:
    starts = Starts(tiny_plan(), first, stride)
    assert list(starts.limits) == list(limits) and starts.levels == len(limits)
    assert starts.share(0) < starts.share(len(limits) - 1) == 1
    for level, limit in enumerate(limits):
        steps = distances(draw(starts, level, 2000))
        assert set(steps.tolist()) == set(range(1, min(limit, 9) + 1))


def test_a_scene_without_paths_as_short_as_a_level_draws_its_shortest() -> None:
    plan = tiny_plan()
    far = replace(plan, start_rows=plan.start_rows[plan.distance[plan.start_rows] >= 5])
    generator, scene = torch.Generator().manual_seed(0), torch.tensor([0, 1]).repeat(200)
    steps = distances(Starts([plan, far], first=2).sample(torch.tensor(0), 400, generator, scene))
    assert set(steps[scene == 0].tolist()) == {1, 2} and set(steps[scene == 1].tolist()) == {5}


@pytest.mark.parametrize("first", [None, 9, 50])
def test_a_first_level_that_covers_all_starts_is_the_only_one(first: int | None) -> None:
    assert Starts(tiny_plan(), first).levels == 1


@pytest.mark.parametrize(("first", "stride"), [(2, 1), (3, 4), (None, 1)])
def test_the_last_level_is_the_whole_start_set(first: int | None, stride: int) -> None:
    plan = tiny_plan()
    starts = Starts(plan, first, stride)
    drawn = draw(starts, starts.levels - 1)
    expected = {tuple(state) for state in plan.states[plan.start_rows].tolist()}
    assert {tuple(state) for state in drawn.tolist()} == expected


def test_starts_of_a_level_are_equally_likely() -> None:
    drawn = draw(Starts(tiny_plan(), first=2), level=0)
    _, counts = drawn.unique(dim=0, return_counts=True)
    states = int(((tiny_plan().distance > 0) & (tiny_plan().distance <= 2)).sum())
    assert len(counts) == states
    expected = COUNT / states
    assert ((counts - expected).abs() < 5 * expected**0.5).all()


def test_draws_depend_only_on_the_generator() -> None:
    starts = Starts(tiny_plan())
    assert torch.equal(draw(starts, 1, 50, seed=3), draw(starts, 1, 50, seed=3))
    assert not torch.equal(draw(starts, 1, 50, seed=3), draw(starts, 1, 50, seed=4))


def test_a_longer_draw_begins_with_the_shorter_one() -> None:
    starts = Starts(tiny_plan())
    assert torch.equal(draw(starts, 2, 5), draw(starts, 2, 9)[:5])


def test_the_curriculum_samples_at_its_current_level() -> None:
    curriculum = Curriculum(tiny_plan(), first=2, threshold=1.0, window=1)
    generator = torch.Generator().manual_seed(0)
    assert distances(curriculum.sample(500, generator)).max() == 2
    one = torch.tensor([True])
    curriculum.begin(one)
    curriculum.record(torch.tensor([0]), one, one)
    assert curriculum.level == 1
    assert distances(curriculum.sample(500, generator)).max() == 3


def test_anywhere_draws_from_the_whole_start_set_at_any_level() -> None:
    curriculum = Curriculum(tiny_plan(), first=2)
    drawn = curriculum.anywhere(COUNT, torch.Generator().manual_seed(0))
    expected = {tuple(state) for state in tiny_plan().states[tiny_plan().start_rows].tolist()}
    assert {tuple(state) for state in drawn.tolist()} == expected and curriculum.level == 0


def test_a_plan_with_shorter_paths_has_fewer_levels() -> None:
    near = (tiny_plan().distance > 0) & (tiny_plan().distance <= 5)
    cut = Starts(replace(tiny_plan(), start_rows=near.nonzero().squeeze(1)), first=2)
    assert cut.levels == 4 and distances(draw(cut, 3)).max() == 5


def test_episodes_of_another_level_do_not_count() -> None:
    curriculum, all_rows = Curriculum(tiny_plan(), threshold=1.0, window=3), torch.ones(3, dtype=torch.bool)
    curriculum.begin(all_rows)
    curriculum.record(torch.tensor([-1, 0, 1]), all_rows, all_rows)
    assert curriculum.progress.tolist() == [0, 1, 1] and curriculum.cohort.tolist() == [True, False, True]


def test_a_curriculum_saves_its_progress_and_its_cohort() -> None:
    curriculum, rows = Curriculum(tiny_plan(), window=4), torch.tensor([True, False, True])
    curriculum.begin(rows)
    curriculum.record(torch.zeros(3), torch.tensor([True, False, False]), rows)
    assert list(curriculum.state_dict()) == ["progress", "cohort"]
    other = Curriculum(tiny_plan(), window=4)
    other.load_state_dict(curriculum.state_dict())
    assert other.progress.tolist() == [0, 1, 1] and other.cohort.tolist() == [False, False, True]


def test_another_number_of_robots_keeps_the_level_and_begins_another_cohort() -> None:
    curriculum, one = Curriculum(tiny_plan(), threshold=1.0, window=2), torch.ones(1, dtype=torch.bool)
    for _ in range(3):
        curriculum.begin(one)
        curriculum.record(curriculum.level.clone(), one, one)
    assert curriculum.progress.tolist() == [1, 1, 1]
    other = Curriculum(tiny_plan(), threshold=1.0, window=2)
    other.seat(5)
    other.load_state_dict(curriculum.state_dict())
    other.begin(torch.ones(5, dtype=torch.bool))
    assert other.progress.tolist() == [1, 0, 0] and other.cohort.tolist() == [True, True, False, False, False]


@pytest.mark.parametrize(
    ("first", "stride", "levels", "most"), [(2, 1, 4, 5), (3, 4, 2, 5), (9, 1, 1, 5), (None, 1, 1, 9)]
)
def test_only_a_single_level_of_all_starts_has_any_that_an_episode_is_too_short_for(
    first: int | None, stride: int, levels: int, most: int
) -> None:
    starts = Starts(replace(tiny_plan(), max_steps=5), first, stride)
    assert starts.levels == levels and distances(draw(starts, levels - 1)).max() == most


def test_a_cohort_that_other_settings_decide_is_decided_when_it_is_loaded() -> None:
    saved = {"progress": torch.tensor([2, 3, 2]), "cohort": torch.tensor([True, False])}
    for plan, threshold, expected in (
        (tiny_plan(), 1.0, [2, 0, 0]),
        (tiny_plan(), 0.75, [2, 3, 2]),
        (tiny_plan(), 0.5, [3, 0, 0]),
        (replace(tiny_plan(), max_steps=3), 0.75, [1, 3, 2]),
    ):
        curriculum = Curriculum(plan, threshold=threshold, window=4)
        curriculum.load_state_dict(saved)
        assert curriculum.progress.tolist() == expected
        assert curriculum.cohort.tolist() == [expected[1] > 0, False]


@pytest.mark.parametrize(("first", "stride"), [(0, 1), (2, 0), (None, 0)])
def test_a_first_level_or_stride_of_zero_is_refused(first: int | None, stride: int) -> None:
    with pytest.raises(ValueError, match=r"curriculum\.(first|stride): expected a whole number of at least 1, got 0"):
        Starts(tiny_plan(), first, stride)
