"""Callbacks by which the stages report their progress and outcome."""

from collections.abc import Callable

Progress = Callable[[str, int, int], None]
"""Called with the name of the work in progress, the number of units done, and their total."""
Say = Callable[[str], object]
"""Called with the outcome of a stage, as one line or several."""


def silent(what: str, done: int, total: int) -> None:
    """Ignore all progress."""
