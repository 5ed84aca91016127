"""Shows where warps wait, by line of the kernels' source, from a report of the profiler ncu.

    ncu --set full --kernel-name regex:^draw --launch-skip 1 --launch-count 1 --export draw \\
        python benchmarks/gpu_steps.py launch --tolerance 0
    ncu --import draw.ncu-rep --page source --csv --print-source cuda,sass > draw.csv
    python benchmarks/gpu_stalls.py draw.csv       # the lines with the most samples, and why warps waited
"""

import argparse
import csv
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from linecache import getline
from pathlib import Path

from record import print_markdown

NATIVE = Path(__file__).parents[1] / "splatrl" / "native"
SAMPLES, INSTRUCTIONS, STALL = "# Samples", "Instructions Executed", "stall_"
SHOWN = 80
"""Number of characters shown of a source line."""


@dataclass(frozen=True)
class Line:
    """Samples on one line of the source.

    Attributes:
        file: name of the file, without its folder.
        number: number of the line, from 1.
        samples: samples in which a warp was at this line, waiting or not.
        instructions: instructions that warps executed.
        stalls: samples by the reason for which the warp waited.
    """

    file: str
    number: int
    samples: float
    instructions: float
    stalls: Counter[str]


def lines_of(path: Path) -> list[Line]:
    """Read all lines of a report's source page.

    Raises:
        SystemExit: if the file is no such page.
    """
    with open(path, newline="", encoding="utf-8") as stream:
        found = list(_lines(csv.reader(stream)))
    if not found:
        raise SystemExit(f"{path}: expected the output of ncu --page source --csv --print-source cuda,sass")
    return found


def _lines(rows: Iterator[list[str]]) -> Iterator[Line]:
    file, columns = "", dict[str, int]()
    for row in rows:
        if row[:1] == ["File Path"]:
            file = Path(row[1]).name
        elif row[:1] == ["Line No"]:
            columns = {name: column for column, name in enumerate(row)}
        elif columns and row and row[0].isdigit():  # the other rows are the instructions of a line
            values = {name: _number(row[column]) for name, column in columns.items()}
            stalls = {name: value for name, value in values.items() if name.startswith(STALL) and "(" not in name}
            reasons = Counter({name.removeprefix(STALL): value for name, value in stalls.items()})
            yield Line(file, int(row[0]), values[SAMPLES], values[INSTRUCTIONS], reasons)


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return 0.0


def reasons(stalls: Counter[str], samples: float, most: int) -> str:
    """Format the most frequent reasons, each with its fraction of all samples."""
    return ", ".join(f"{name} {value / samples:.1%}" for name, value in stalls.most_common(most) if value > 0)


def main() -> None:
    """Print a table of the lines with the most samples."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("page", type=Path, help="CSV file written by ncu --page source")
    parser.add_argument("--lines", type=int, default=30, help="number of lines to print")
    options = parser.parse_args()
    lines = lines_of(options.page)
    samples, instructions = sum(line.samples for line in lines), sum(line.instructions for line in lines)
    print(f"all: {reasons(sum((line.stalls for line in lines), Counter()), samples, 8)}")
    sources = {path.name: str(path) for path in NATIVE.rglob("*") if path.suffix in (".h", ".cu")}
    rows = []
    for line in sorted(lines, key=lambda line: -line.samples)[: options.lines]:
        text = getline(sources.get(line.file, ""), line.number).strip()[:SHOWN]
        shares = f"{line.samples / samples:.1%}", f"{line.instructions / instructions:.1%}"
        rows.append((f"{line.file}:{line.number}", *shares, reasons(line.stalls, samples, 2), text.replace("|", "\\|")))
    print_markdown(("line", "samples", "instructions", "waiting for", "source"), rows)


if __name__ == "__main__":
    main()
