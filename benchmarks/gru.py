"""Measures the GRU of a policy's memory: the compiled one and PyTorch's, on one core, in turns.

    python benchmarks/gru.py             # a minute
    python benchmarks/gru.py --rounds 9

Rows are minibatches of learning from reward and of imitation, forwards and backwards through time. Times are CPU time
of this process, which other work on the machine disturbs less; the ratios are those of single rounds.
"""

import argparse
import os
from collections.abc import Callable
from itertools import product
from statistics import median
from time import process_time

os.environ["SPLATRL_CORES"] = "1"

import torch
from record import print_markdown
from timing import quartiles, take_turns
from torch import Tensor, nn

from splatrl.training import memory
from splatrl.training.memory import gru
from splatrl.training.native_gru import suits

SIZE = 128
"""Size of features and memory."""
SHAPES = {
    "learning, 4 rows of 64 frames": [64] * 4,
    "learning, 8 rows of 64 frames": [64] * 8,
    "learning, 8 rows of 64 frames, 24 episodes": [12, 20, 32] * 8,
    "imitation, 10 episodes": [5, 8, 12, 16, 20, 26, 32, 40, 60, 90],
}
"""Lengths of the episodes whose frames are evaluated together."""
REPEATS = 10
"""Evaluations per round and way."""


def call(lengths: list[int], compiled: bool) -> Callable[[], object]:
    """Make a function that evaluates these episodes and their gradients, in one of the two ways."""
    torch.manual_seed(0)
    module, frames = gru(SIZE, SIZE), sum(lengths)
    begins = torch.tensor([0, *lengths[:-1]]).cumsum(0)
    seen, slope = torch.randn(frames, SIZE).relu().requires_grad_(), torch.randn(frames, SIZE)

    def turn() -> None:
        memory.suits = suits if compiled else _never
        for _ in range(REPEATS):
            torch.autograd.grad(module.along(seen, begins), [seen, *module.parameters()], slope)

    return turn


def _never(features: Tensor, cell: nn.GRU) -> bool:
    return False


def main() -> None:
    """Measure, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=25)
    options = parser.parse_args()
    torch.set_num_threads(1)
    calls = {(name, way): call(SHAPES[name], way) for name, way in product(SHAPES, (False, True))}
    seconds = take_turns(calls, options.rounds, process_time)
    rows = []
    for name, lengths in SHAPES.items():
        theirs, mine = seconds[name, False], seconds[name, True]
        each = [f"{1e6 * median(times) / (REPEATS * sum(lengths)):.1f}" for times in (theirs, mine)]
        low, middle, high = quartiles([a / b for a, b in zip(theirs, mine, strict=True)])
        rows.append([name, *each, f"{middle:.1f}", f"{low:.1f} to {high:.1f}"])
    print_markdown(["shape", "PyTorch, µs a frame", "compiled, µs a frame", "times as fast", "middle half"], rows)


if __name__ == "__main__":
    main()
