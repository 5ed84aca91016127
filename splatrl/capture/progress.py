"""How a stage tells how far it is."""

from collections.abc import Callable

Progress = Callable[[str, int, int], None]
"""Called with what is being done, how many units of it are done, and how many there are."""


def silent(what: str, done: int, total: int) -> None:
    """Tell nobody."""
