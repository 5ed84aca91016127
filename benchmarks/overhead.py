"""Measures what a call of the env costs where every view is remembered: the work around renderer and checker.

    python benchmarks/overhead.py             # the grid task in the backyard, one thread
    python benchmarks/overhead.py --batches 1 64

``step`` is a step without resets, ``automatic`` one with TorchRL's automatic resets, ``reset one`` a reset of a single
row to a given state. All rows take turns, round by round. To compare two versions, run both, more than once.
"""

import argparse
from collections.abc import Callable
from statistics import median

import torch
from timing import take_turns

import splatrl

CALLS = 20
"""Of a turn: a single call is too short to time."""
WARM_UP = 60
"""Steps that fill the cache of views."""


def calls_of(batch: int) -> dict[str, Callable[[], None]]:
    """The calls of one batch size, each always with the same input, so that its views are remembered."""
    env = splatrl.make_env(["device=cpu", "curriculum=none"], batch_size=[batch])
    torch.manual_seed(0)
    td = env.reset()
    for _ in range(WARM_UP):
        _, td = env.step_and_maybe_reset(env.rand_action(td))
    given = env.rand_action(td)
    one = torch.zeros(batch, 1, dtype=torch.bool)
    one[0] = True
    return {
        "step": lambda: env.step(given.clone()),
        "automatic": lambda: env.step_and_maybe_reset(given.clone()),
        "reset one": lambda: env.reset(given.clone().set("_reset", one.clone()), set_state=True),
    }


def repeated(call: Callable[[], None]) -> Callable[[], None]:
    """A turn."""

    def turn() -> None:
        for _ in range(CALLS):
            call()

    return turn


def main() -> None:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--batches", type=int, nargs="+", default=[1, 8, 64, 512])
    parser.add_argument("--rounds", type=int, default=30)
    options = parser.parse_args()
    torch.set_num_threads(1)
    turns = {(b, name): repeated(call) for b in options.batches for name, call in calls_of(b).items()}
    seconds = take_turns(turns, options.rounds)
    print("| robots | call | µs, median | fastest round |\n| ---: | --- | ---: | ---: |")
    for (batch, name), times in seconds.items():
        print(f"| {batch} | {name} | {1e6 * median(times) / CALLS:,.0f} | {1e6 * min(times) / CALLS:,.0f} |")


if __name__ == "__main__":
    main()
