"""Stages of a training: parts of what precedes learning from reward."""

from collections.abc import Callable, Iterable, Mapping
from typing import Any, Protocol, runtime_checkable

Stage = Callable[[], Iterable[dict[str, float]]]
"""A part of what precedes learning from reward, which yields rows of the history."""


@runtime_checkable
class Resumable(Protocol):
    """A stage that can be continued where it yields a row, and where it calls ``paused``."""

    paused: Callable[[], object]

    def __call__(self) -> Iterable[dict[str, float]]:
        """Run the stage, or what is left of it."""
        ...

    def state_dict(self) -> dict[str, Any]:
        """Return what the rest of the stage depends on, besides PPO's state."""
        ...

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Continue from a ``state_dict()``."""
        ...
