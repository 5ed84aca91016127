"""Compares the speed of two checkouts: the same measurements in both, turn by turn, as ratios.

    git worktree add ../before main && (cd ../before && python -m venv .venv && .venv/bin/pip install -e .)
    python benchmarks/against.py ../before/.venv/bin/python             # everything
    python benchmarks/against.py ../before/.venv/bin/python learn step  # what begins with these words

Each checkout runs in a process of its own, whose turns alternate. What is compared is time of the processor, of all
threads, which other processes disturb less than the clock on the wall. A ratio is that of the two turns of a round:
above 1 this checkout is faster.
"""

import argparse
import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from statistics import quantiles

from record import print_markdown
from tqdm import tqdm

TURNS = Path(__file__).with_name("turns.py")


class Checkout:
    """A process that takes turns with another one."""

    def __init__(self, python: str, words: Sequence[str]):
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
        self.process = subprocess.Popen([python, str(TURNS), *words], **pipes)

    def answer(self) -> str | float | None:
        """The next line that the process says."""
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        if not line:
            raise SystemExit(f"{self.process.args}: expected a measurement, got the end of the process")
        return json.loads(line)

    def ask(self, turns: int) -> float | None:
        """Ask for some turns; the median seconds of one, or None where the checkout has no such thing."""
        assert self.process.stdin is not None
        self.process.stdin.write(f"{turns}\n")
        self.process.stdin.flush()
        return self.answer()


def main() -> None:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("other", help="Python of the other checkout, in which its splatrl is installed")
    parser.add_argument("words", nargs="*", help="beginnings of names of measurements; none is all")
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--turns", type=int, default=1, help="of a round")
    options = parser.parse_args()
    here, there = Checkout(sys.executable, options.words), Checkout(options.other, options.words)
    rows = []
    while (name := here.answer()) is not None:
        assert there.answer() == name, name
        ratios, mine, theirs = [], [], []
        for _ in tqdm(range(options.rounds), desc=str(name)):
            new, old = here.ask(options.turns), there.ask(options.turns)
            if new is None or old is None:
                break
            mine.append(new)
            theirs.append(old)
            ratios.append(old / new)
        here.ask(0)
        there.ask(0)
        if not ratios:
            rows.append([str(name), "", "", "not in both", ""])
            continue
        low, middle, high = quantiles(ratios, n=4)
        milliseconds = [f"{1e3 * quantiles(times, n=4)[1]:,.3g}" for times in (theirs, mine)]
        rows.append([str(name), *milliseconds, f"{middle:.2f}", f"{low:.2f} to {high:.2f}"])
    assert there.answer() is None  # it has said its last word, so that it is not cut off
    print_markdown(["what", "other, ms", "this, ms", "times as fast", "middle half of rounds"], rows)


if __name__ == "__main__":
    main()
