"""One body in several scenes: each row of a batch is answered by the checker of its own scene."""

from collections.abc import Callable, Sequence
from typing import Any, cast

import torch
from torch import Tensor

from splatrl.bodies import Body
from splatrl.collision.base import Checker
from splatrl.collision.native import NativeChecker, NativeQueries
from splatrl.device_faults import Faulty
from splatrl.native import _core


class SeveralCheckers:
    """The checkers of one body in several scenes.

    Answers are byte for byte those of the row's own checker. With ``NativeChecker``, one call answers a batch of rows
    in any scenes. Other checkers are each called once: on a CPU for the rows of their scene, and on a GPU, where
    counting rows would synchronise, for all rows.

    Args:
        checkers: one checker for each scene, all of one kind and for one body.

    Raises:
        ValueError: for no checkers, or different bodies.
    """

    def __init__(self, checkers: Sequence[Checker]):
        if not checkers or any(checker.body != checkers[0].body for checker in checkers):
            raise ValueError(
                f"checkers: expected at least one, all for one body, got {[checker.body for checker in checkers]}"
            )
        self.checkers = list(checkers)
        self._native = _natively(self.checkers)

    @property
    def body(self) -> Body:
        """The body under test."""
        return self.checkers[0].body

    def at(self, scene: Tensor) -> Checker:
        """Return a checker for a batch whose rows lie in given scenes.

        Args:
            scene: [B] int64, index of the checker that answers each row.
        """
        if self._native is not None:
            return _NativeRows(self._native, self.checkers, scene, self._threads)
        return _Rows(self.checkers, scene)

    @property
    def _threads(self) -> int:
        return max(checker.threads for checker in self.checkers if isinstance(checker, NativeChecker))

    def raise_faults(self) -> None:
        """Raise the faults that any of the checkers recorded since the last call; see ``Faulty``."""
        for checker in self.checkers:
            if isinstance(checker, Faulty):
                checker.raise_faults()

    def __reduce__(self) -> tuple[type["SeveralCheckers"], tuple[list[Checker]]]:
        return SeveralCheckers, (self.checkers,)


def checkers_of(checker: Checker | SeveralCheckers) -> list[Checker]:
    """Return the checker of each scene, in order: those of a ``SeveralCheckers``, or the only one."""
    return checker.checkers if isinstance(checker, SeveralCheckers) else [checker]


def _natively(checkers: Sequence[Checker]) -> _core.Colliders | None:
    """Join the checkers' grids for one call, if all are native, else return None; the checkers must outlive it."""
    native = [checker for checker in checkers if isinstance(checker, NativeChecker)]
    return _core.Colliders([checker.collider for checker in native]) if len(native) == len(checkers) else None


class _NativeRows(NativeQueries):
    """Answers the queries of ``NativeQueries`` in C++, each row in the grid of its scene."""

    def __init__(self, colliders: _core.Colliders, checkers: Sequence[Checker], scene: Tensor, threads: int):
        self.body, self.threads = checkers[0].body, threads
        self.core, self._rows = _InScenes(colliders, scene), _Rows(checkers, scene)

    def ranges(self, body_to_world: Tensor, beams: Tensor, reach: float) -> Tensor:
        """Cast beams, with one call for each scene; see ``Checker.ranges``."""
        return self._rows.ranges(body_to_world, beams, reach)


class _InScenes:
    """Queries to several grids, with the same arguments as queries to one."""

    def __init__(self, colliders: _core.Colliders, scene: Tensor):
        self._colliders, self._scene = colliders, scene.to("cpu", torch.int64).contiguous()

    def collides(self, poses: int, out: int, count: int, threads: int, /) -> int:
        return self._colliders.collides(self._scenes(count), poses, out, count, threads)

    def free_fraction(self, start: int, end: int, out: int, count: int, threads: int, /) -> int:
        return self._colliders.free_fraction(self._scenes(count), start, end, out, count, threads)

    def sweeps(self, start: int, end: int, out: int, count: int, threads: int, /) -> int:
        return self._colliders.sweeps(self._scenes(count), start, end, out, count, threads)

    def clearance(self, points: int, out: int, count: int, threads: int, /) -> int:
        return self._colliders.clearance(self._scenes(count), points, out, count, threads)

    def _scenes(self, count: int) -> int:
        """Return the address of the rows' scene indices."""
        if len(self._scene) != count:
            raise ValueError(f"scene: expected {count} scene indices, one per row, got {len(self._scene)}")
        return self._scene.data_ptr()


class _Rows:
    """Answers each row with the checker of its scene."""

    def __init__(self, checkers: Sequence[Checker], scene: Tensor):
        self._checkers, self._scene = checkers, scene
        self.body = checkers[0].body

    def collides(self, body_to_world: Tensor) -> Tensor:
        return self._ask(lambda checker: checker.collides, body_to_world)

    def free_fraction(self, start: Tensor, end: Tensor) -> Tensor:
        return self._ask(lambda checker: checker.free_fraction, start, end)

    def sweeps(self, start: Tensor, end: Tensor) -> Tensor:
        return self._ask(lambda checker: checker.sweeps, start, end)

    def clearance(self, points: Tensor) -> Tensor:
        return self._ask(lambda checker: checker.clearance, points)

    def ranges(self, body_to_world: Tensor, beams: Tensor, reach: float) -> Tensor:
        return self._ask(lambda checker: lambda poses: checker.ranges(poses, beams, reach), body_to_world)

    def _ask(self, query: Callable[[Checker], Callable[..., Any]], *values: Tensor) -> Tensor:
        scene, count = self._scene, len(self._checkers)
        if len(scene) != len(values[0]):
            raise ValueError(f"scene: expected {len(values[0])} scene indices, one per row, got {len(scene)}")
        if not len(scene):
            return cast(Tensor, query(self._checkers[0])(*values))
        if scene.device.type == "cpu" and ((scene < 0) | (scene >= count)).any():
            raise ValueError(f"scene: expected indices from 0 to {count - 1}, got {scene.tolist()!r:.80}")
        answer: Tensor | None = None
        for number, checker in enumerate(self._checkers):
            mine = self._scene == number
            if mine.device.type != "cpu":
                asked = query(checker)(*values)
                answer = asked if answer is None else torch.where(mine.view(-1, *[1] * (asked.ndim - 1)), asked, answer)
            elif len(rows := mine.nonzero().squeeze(1)):
                asked = query(checker)(*(value[rows] for value in values))
                answer = asked.new_empty(len(mine), *asked.shape[1:]) if answer is None else answer
                answer[rows] = asked
        assert answer is not None
        return answer
