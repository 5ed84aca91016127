"""Records the results of a run together with its commit, machine and date."""

import datetime
import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from splatrl.documents import write_json as write_document

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "benchmarks" / "results"


def today() -> str:
    """Return the date in ISO format."""
    return datetime.date.today().isoformat()


def print_markdown(header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a Markdown table whose columns also line up as plain text."""
    widths = [max(len(row[column]) for row in [header, *rows]) for column in range(len(header))]
    lines = [" | ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) for row in [header, *rows]]
    lines.insert(1, " | ".join("-" * width for width in widths))
    print("\n" + "\n".join(f"| {line} |" for line in lines) + "\n")


def write_json(
    kind: str,
    machine: Any,
    results: Sequence[Any],
    device: str = "cpu",
    folder: Path = RESULTS,
    commit: str | None = None,
    notes: Sequence[str] = (),
) -> Path:
    """Save results as ``<date>-<device>-<kind>.json``.

    Args:
        kind: name of the benchmark.
        machine: dataclass that describes the machine.
        results: dataclasses; ``what``, where a class has it, is saved as well and names the kind of result.
        device: device that was measured.
        folder: folder of the file.
        commit: commit that was measured; None asks git.
        notes: lines for readers.
    """
    path = folder / f"{today()}-{device}-{kind}.json"
    record = {
        "date": today(),
        "commit": commit or _git("rev-parse", "HEAD"),
        "changed": bool(_git("status", "--porcelain", "--", "splatrl")),  # if so, more than the commit was run
        "machine": asdict(machine),
        "results": [_described(result) for result in results],
        **({"notes": list(notes)} if notes else {}),
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    write_document(path, record)  # what was not measured is null
    return path


def _described(result: Any) -> dict[str, Any]:
    return ({"what": result.what} if hasattr(result, "what") else {}) | asdict(result)


def _git(*arguments: str) -> str:
    """Return the output of git; empty without git or a checkout, so that no result is lost for lack of it."""
    if shutil.which("git") is None:
        return ""
    return subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=False).stdout.strip()
