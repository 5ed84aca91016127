"""Numerical results of an evaluation, for ``evaluation.json``."""

from collections.abc import Sequence
from typing import Any

from torch import Tensor

from splatrl.evaluation.rollouts import Episodes


def summarise(sampled: Episodes, argmax: Episodes, shortest: Tensor | None) -> dict[str, Any]:
    """Summarise the episodes of an evaluation, with sampled and with most likely actions.

    Args:
        sampled: episodes with actions sampled from the policy, repetitions of a start in a row; the headline results.
        argmax: episodes with the policy's most likely actions, one from each start.
        shortest: [N] int64, length of the shortest path from each start, steps; None if there are no such paths, or
            if episodes do not end at a goal.

    Returns:
        Rates in [0, 1] (``Episodes.mishaps``), mean numbers of goals, mean returns and mean lengths; for navigation
        tasks also the measures of ``Episodes.navigation``; with shortest paths also ``step_spl`` and their mean length.
        ``success_interval`` is as of ``success_interval``. Keys for ``argmax`` end in ``_argmax``.
    """
    summary: dict[str, Any] = {}
    for suffix, episodes in (("", sampled), ("_argmax", argmax)):
        summary |= {
            f"success_rate{suffix}": episodes.success.double().mean().item(),
            f"success_interval{suffix}": success_interval(episodes),
            f"mean_goals{suffix}": episodes.goals.double().mean().item(),
            **{f"{key}{suffix}": value for key, value in episodes.mishaps().items()},
            f"mean_return{suffix}": episodes.episode_return.mean().item(),
            f"mean_length{suffix}": episodes.length.double().mean().item(),
        }
        summary |= {f"{key}{suffix}": value for key, value in episodes.navigation().items()}
        if shortest is not None:
            repeats = len(episodes.outcome) // len(shortest)
            summary[f"step_spl{suffix}"] = episodes.step_spl(shortest.repeat_interleave(repeats))
    summary["episodes"] = len(sampled.outcome)
    if shortest is not None:
        summary["mean_shortest"] = shortest.double().mean().item()
    return summary


def success_interval(episodes: Episodes) -> list[float]:
    """Return the lowest and the highest success rate that agree with episodes, at 95 % confidence.

    It is the interval of Wilson (1927), which takes episodes as independent draws. It covers what the episodes of one
    policy leave open, not how much policies of other training seeds differ. It is wider than need be where every start
    pose has its episode, since then only actions and transforms are left to chance, and narrower where few start poses
    have several each.
    """
    from scipy.stats import binomtest  # slow to import

    found = binomtest(int(episodes.success.sum()), len(episodes.success)).proportion_ci(0.95, "wilson")
    return [float(found.low), float(found.high)]


def by_scene(names: Sequence[str], sampled: Episodes, argmax: Episodes) -> list[dict[str, Any]]:
    """Summarise success in each of several scenes that had episodes, in their order.

    Args:
        names: names of the scenes.
        sampled: episodes in all scenes with sampled actions.
        argmax: episodes in all scenes with the most likely actions.
    """
    return [
        {
            "scene": name,
            "success_rate": own.success.double().mean().item(),
            "success_interval": success_interval(own),
            "success_rate_argmax": argmax.of(number).success.double().mean().item(),
            "collision_rate": own.mishaps()["collision_rate"],
            "episodes": len(own.outcome),
        }
        for number, name in enumerate(names)
        if len((own := sampled.of(number)).outcome)
    ]
