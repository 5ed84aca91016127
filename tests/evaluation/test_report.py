"""Summaries of episodes, and the JSON files that hold them."""

import pytest
import torch

from splatrl.envs.tasks import Outcome
from splatrl.evaluation import Episodes, summarise


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
