"""Compares the speed of two checkouts: runs the same measurements in both, alternately, and prints ratios.

    git worktree add ../before main && (cd ../before && python -m venv .venv && .venv/bin/pip install -e .)
    python benchmarks/against.py ../before/.venv/bin/python             # everything
    python benchmarks/against.py ../before/.venv/bin/python learn step  # measurements that begin with these words

Each checkout runs in its own process, and the two take turns. The CPU time of all threads is compared, since other
processes disturb it less than wall-clock time. Each ratio is between the two turns of a round; above 1, this checkout
is faster.
"""

import argparse
import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from record import print_markdown
from timing import quartiles
from tqdm import tqdm

TURNS = Path(__file__).with_name("turns.py")


class Checkout:
    """A process that measures in one checkout, in turns with that of the other."""

    def __init__(self, python: str, words: Sequence[str]):
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
        self.process = subprocess.Popen([python, str(TURNS), *words], **pipes)

    def answer(self) -> str | float | None:
        """Read the next line of the process."""
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        if not line:
            raise SystemExit(f"{self.process.args}: expected a measurement, got the end of the process")
        return json.loads(line)

    def ask(self, turns: int) -> float | None:
        """Ask for some turns, and return the median seconds of one; None if the checkout lacks this measurement."""
        assert self.process.stdin is not None
        self.process.stdin.write(f"{turns}\n")
        self.process.stdin.flush()
        return self.answer()


def main() -> None:
    """Measure, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("other", help="Python interpreter in which the other checkout's splatrl is installed")
    parser.add_argument("words", nargs="*", help="beginnings of names of the measurements to run; default all")
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--turns", type=int, default=1, help="turns of each checkout per round")
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
            rows.append([str(name), "", "", "not in both checkouts", ""])
            continue
        low, middle, high = quartiles(ratios)
        milliseconds = [f"{1e3 * quartiles(times)[1]:,.3g}" for times in (theirs, mine)]
        rows.append([str(name), *milliseconds, f"{middle:.2f}", f"{low:.2f} to {high:.2f}"])
    assert there.answer() is None  # wait until it has finished, so that it is not cut off
    print_markdown(["measurement", "other, ms", "this, ms", "times as fast", "middle half of rounds"], rows)


if __name__ == "__main__":
    main()
