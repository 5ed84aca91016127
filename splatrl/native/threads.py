"""The number of threads that the C++ core may use."""

import os

CORES = "SPLATRL_CORES"
"""Environment variable: the most cores that a process and its subprocesses may use."""


def usable_cores() -> int:
    """Return the number of cores that this process may use: those of its affinity mask, at most ``SPLATRL_CORES``.

    Where the system has no affinity masks, all cores count.

    Raises:
        ValueError: if the environment variable is not a whole number of at least 1.
    """
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    most = os.environ.get(CORES, str(cores))
    if not most.isdecimal() or int(most) < 1:
        raise ValueError(f"{CORES}: expected a whole number of at least 1, got {most!r}")
    return min(cores, int(most))


def threads_of(asked: int | None) -> int:
    """Return the number of threads to use: as many as asked for, but at most one per core, as each has its own memory.

    Args:
        asked: the requested number of threads; None for all cores.

    Raises:
        ValueError: for anything but None or a whole number of at least 1.
    """
    if asked is None:
        return usable_cores()
    if isinstance(asked, bool) or not isinstance(asked, int) or asked < 1:
        raise ValueError(f"threads: expected a whole number of at least 1, or None for all cores, got {asked!r}")
    return min(asked, usable_cores())
