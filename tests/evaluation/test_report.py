"""Summaries of episodes, and the JSON files that hold them."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from splatrl.envs.tasks import Outcome
from splatrl.evaluation import Episodes, summarise
from splatrl.evaluation.evaluate import remove_results
from splatrl.evaluation.report import by_scene


def episodes(outcomes: list[Outcome], lengths: list[int]) -> Episodes:
    count, outcome = len(outcomes), torch.tensor(outcomes)
    reached, paid = outcome == Outcome.GOAL, torch.arange(count, dtype=torch.float32)
    return Episodes(torch.zeros(count, 3), outcome, torch.tensor(lengths), paid, 3 * reached, reached)


def test_rates_are_over_all_episodes_and_each_episode_has_the_shortest_path_of_its_start() -> None:
    sampled = episodes([Outcome.GOAL, Outcome.COLLISION, Outcome.GOAL, Outcome.OUT_OF_BOUNDS], [2, 9, 6, 1])
    argmax = episodes([Outcome.TIMEOUT, Outcome.GOAL], [200, 3])
    summary = summarise(sampled, argmax, torch.tensor([2, 3]))  # starts 0, 0, 1, 1
    assert (summary["success_rate"], summary["mean_goals"]) == (0.5, 1.5)
    assert summary["step_spl"] == pytest.approx((2 / 2 + 3 / 6) / 4)
    assert (summary["collision_rate"], summary["out_of_bounds_rate"], summary["timeout_rate"]) == (0.25, 0.25, 0)
    assert (summary["mean_return"], summary["mean_length"], summary["episodes"]) == (1.5, 4.5, 4)
    assert (summary["success_rate_argmax"], summary["step_spl_argmax"], summary["timeout_rate_argmax"]) == (
        0.5,
        0.5,
        0.5,
    )


def test_the_success_rate_has_the_interval_of_wilson() -> None:
    some = episodes([Outcome.GOAL] * 8 + [Outcome.TIMEOUT] * 2, [1] * 10)
    every, none = (episodes([outcome] * 20, [1] * 20) for outcome in (Outcome.GOAL, Outcome.TIMEOUT))
    found = summarise(some, every, None)
    assert found["success_interval"] == pytest.approx([0.49016, 0.94331], abs=1e-5)  # Wilson 1927
    assert found["success_interval_argmax"] == pytest.approx([0.83887, 1.0], abs=1e-5)
    assert by_scene(["one"], none, some)[0]["success_interval"] == pytest.approx([0.0, 0.16113], abs=1e-5)


def test_where_collisions_are_counted_their_rate_is_the_share_of_episodes_with_any() -> None:
    touched = torch.tensor([[0, 3, 1, 0], [0, 0, 0, 2]])
    metres = {key: torch.ones(4) for key in ("distance_to_goal", "start_distance", "path_length")}
    sampled, argmax = (
        replace(
            episodes([Outcome.GOAL, Outcome.OUT_OF_BOUNDS, Outcome.TIMEOUT, Outcome.STOPPED], [2, 9, 6, 1]),
            measures={**metres, "collisions": count},
            scene=torch.tensor([0, 0, 0, 1]),
        )
        for count in touched
    )
    summary = summarise(sampled, argmax, None)
    assert (summary["collision_rate"], summary["collision_rate_argmax"], summary["collisions"]) == (0.5, 0.25, 1.0)
    assert summary["timeout_rate"] == 0.25
    assert summary["out_of_bounds_rate"] == 0.25 and summary["timeout_rate_argmax"] == 0.25
    assert [row["collision_rate"] for row in by_scene(["one", "other"], sampled, argmax)] == [2 / 3, 0.0]


def test_a_training_that_goes_on_keeps_no_result_of_its_own_evaluation(tmp_path: Path) -> None:
    maps = ["starts.png", "success_map.png", "rollouts.mp4"]
    found = ["evaluation.json", "scenes.png", *maps, *(f"scenes/0-yard/{name}" for name in maps)]
    kept = ["learning_curve.png", "episodes.json.gz", "progress.csv", "places/seed=1/starts.png"]
    for path in (tmp_path / name for name in found + kept):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    remove_results(tmp_path)
    assert {str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*") if path.is_file()} == set(kept)
