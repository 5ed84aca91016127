"""How many threads the C++ core may use."""

import os

CORES = "SPLATRL_CORES"
"""Environment variable: how many cores a process and those it starts may use, at most."""


def usable_cores() -> int:
    """Cores that this process may use: its affinity mask where the system has one, at most ``SPLATRL_CORES``.

    Raises:
        ValueError: for an environment variable that is no whole number of at least 1.
    """
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    most = os.environ.get(CORES, str(cores))
    if not most.isdecimal() or int(most) < 1:
        raise ValueError(f"{CORES}: expected a whole number of at least 1, got {most!r}")
    return min(cores, int(most))


def threads_of(asked: int | None) -> int:
    """How many threads to use: as many as asked, but no more than there are cores, since each has its own memory.

    Args:
        asked: how many; None for all cores.

    Raises:
        ValueError: for anything but None or a whole number of at least 1.
    """
    if asked is None:
        return usable_cores()
    if isinstance(asked, bool) or not isinstance(asked, int) or asked < 1:
        raise ValueError(f"threads: expected at least 1, or None for all cores, got {asked!r}")
    return min(asked, usable_cores())
