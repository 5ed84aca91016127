"""Description of the machine and software versions on which an experiment ran, for its report."""

import platform
import subprocess
from importlib.metadata import version
from pathlib import Path

import torch

from splatrl.native.threads import usable_cores

CPU_INFO = Path("/proc/cpuinfo")


def machine(jobs: int) -> str:
    """Describe the processor, its cores, software versions and, in a Git checkout, the commit.

    Args:
        jobs: number of trainings that run at a time.
    """
    cores = usable_cores()
    parts = [
        f"{_processor()}, {cores} core{'s' if cores > 1 else ''}, {jobs} training{'s' if jobs > 1 else ''} at a time",
        f"Python {platform.python_version()}",
        f"torch {torch.__version__}",
        f"splatrl {version('splatrl')}{_commit()}",
    ]
    return "; ".join(parts)


def _processor() -> str:
    if CPU_INFO.is_file():
        for line in CPU_INFO.read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()


def _commit() -> str:
    """Describe the commit of the checkout with this file, and whether it has changes; empty outside a checkout."""
    here = Path(__file__).parent
    try:
        commit = _git(here, "rev-parse", "--short=12", "HEAD")
        tracked = _git(here, "ls-files", Path(__file__).name)
        changed = _git(here, "status", "--porcelain", "--untracked-files=no")
    except (OSError, subprocess.CalledProcessError):
        return ""
    return f" at commit {commit}{' with uncommitted changes' if changed else ''}" if tracked else ""


def _git(folder: Path, *words: str) -> str:
    result = subprocess.run(["git", "-C", str(folder), *words], capture_output=True, text=True, check=True)
    return result.stdout.strip()
