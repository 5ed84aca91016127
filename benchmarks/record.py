"""What a run leaves: results with the commit, the machine and the day that they belong to."""

import datetime
import json
import subprocess
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from machine import Machine

from splatrl.files import replacing

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "benchmarks" / "results"


def today() -> str:
    """The date in ISO form."""
    return datetime.date.today().isoformat()


def print_markdown(header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """A Markdown table whose columns also line up as plain text."""
    widths = [max(len(row[column]) for row in [header, *rows]) for column in range(len(header))]
    lines = [" | ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) for row in [header, *rows]]
    lines.insert(1, " | ".join("-" * width for width in widths))
    print("\n" + "\n".join(f"| {line} |" for line in lines) + "\n")


def write_json(kind: str, machine: Machine, results: Sequence[Any]) -> Path:
    """Keep results, which are dataclasses, as ``results/<date>-cpu-<kind>.json``."""
    path = RESULTS / f"{today()}-cpu-{kind}.json"
    record = {
        "date": today(),
        "commit": _git("rev-parse", "HEAD"),
        "changed": bool(_git("status", "--porcelain", "--", "splatrl")),  # so the commit is not all that ran
        "machine": asdict(machine),
        "results": [asdict(result) for result in results],
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as stream:
        stream.write((json.dumps(record, indent=2) + "\n").encode())
    return path


def _git(*arguments: str) -> str:
    return subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()
