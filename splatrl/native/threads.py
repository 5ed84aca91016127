"""How many threads the C++ core may use."""

import os


def usable_cores() -> int:
    """Cores that this process may use: its affinity mask where the system has one, otherwise all."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
