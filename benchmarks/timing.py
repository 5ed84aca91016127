"""Fair timing on a machine that drifts: all calls take turns, round by round."""

import time
from collections.abc import Callable, Hashable, Sequence
from statistics import quantiles
from typing import TypeVar

from tqdm import tqdm

Key = TypeVar("Key", bound=Hashable)


def take_turns(
    calls: dict[Key, Callable[[], object]], rounds: int, clock: Callable[[], float] = time.perf_counter
) -> dict[Key, list[float]]:
    """Measure the seconds of every call in each round, after a round to warm up, by wall-clock time or another clock.

    A shared machine drifts by tens of per cent within seconds: compare only medians, and only of the same run.
    """
    seconds: dict[Key, list[float]] = {key: [] for key in calls}
    with tqdm(total=(rounds + 1) * len(calls), desc="warming up") as bar:
        for number in range(rounds + 1):
            for key, call in calls.items():
                start = clock()
                call()
                if number > 0:
                    seconds[key].append(clock() - start)
                bar.update()
            bar.set_description(f"round {min(number + 1, rounds)} of {rounds}")
    return seconds


def quartiles(values: Sequence[float]) -> tuple[float, float, float]:
    """Return the lower quartile, the median and the upper quartile of measurements; a single one is all three."""
    low, middle, high = quantiles(values, n=4) if len(values) > 1 else 3 * list(values)
    return low, middle, high
