"""How many threads the C++ core may use."""

import os


def usable_cores() -> int:
    """Cores that this process may use: its affinity mask where the system has one, otherwise all."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


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
