"""Progress callbacks of the stages."""

from collections.abc import Callable

Progress = Callable[[str, int, int], None]
"""Called with the name of the work in progress, the number of units done, and their total."""


def silent(what: str, done: int, total: int) -> None:
    """Ignore all progress."""
