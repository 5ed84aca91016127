"""Where two collision checkers disagree, and by how little."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from splatrl.bodies import Body, Box, Capsule
from splatrl.collision.base import Checker

MARGINS = tuple(1e-7 * 2.0**k for k in range(21))
"""Metres by which a body is grown or shrunk, up to a decimetre."""
_SHOWN = 20


@dataclass(frozen=True)
class Disagreement:
    """One query that two checkers answer differently.

    Attributes:
        row: of the batch.
        answer: of the checker.
        expected: answer of the oracle.
        margin: metres by which the body must be grown, or shrunk where the oracle says hit, for the oracle to change
            its mind: the first of ``MARGINS`` at which it does, so less than twice what is needed; infinite if none
            does.
    """

    row: int
    answer: bool
    expected: bool
    margin: float

    def __str__(self) -> str:
        answer, expected = ("hit" if one else "free" for one in (self.answer, self.expected))
        return f"row {self.row}: {answer}, the oracle says {expected}, margin {self.margin:.1e} m"


@dataclass(frozen=True)
class Verification:
    """The result of comparing a checker with an oracle.

    Attributes:
        poses: how many poses, or moves, were compared.
        hits: how many of them the oracle calls hits.
        disagreements: in the order of the rows.
    """

    poses: int
    hits: int
    disagreements: tuple[Disagreement, ...]

    @property
    def agreed(self) -> int:
        """How many got the same answer twice."""
        return self.poses - len(self.disagreements)

    @property
    def missed(self) -> tuple[Disagreement, ...]:
        """Hits of the oracle that the checker calls free."""
        return tuple(one for one in self.disagreements if one.expected)

    def beyond(self, margin: float) -> tuple[Disagreement, ...]:
        """Disagreements with a margin of more than ``margin`` metres."""
        return tuple(one for one in self.disagreements if one.margin > margin)

    def __str__(self) -> str:
        lines = [f"{self.agreed} of {self.poses} agreed; the oracle calls {self.hits} hits"]
        if self.disagreements:
            worst = max(one.margin for one in self.disagreements)
            lines[0] += f"; {len(self.missed)} missed, margins up to {worst:.1e} m"
        widest = sorted(self.disagreements, key=lambda one: -one.margin)
        lines += [f"  {one}" for one in widest[:_SHOWN]]
        if len(widest) > _SHOWN:
            lines.append(f"  and {len(widest) - _SHOWN} with smaller margins")
        return "\n".join(lines)


def verify(checker: Checker, oracle: Checker, poses: Tensor) -> Verification:
    """Compare what two checkers say about poses.

    Args:
        checker: the one under test.
        oracle: the one that is trusted; made anew for other bodies by ``type(oracle)(oracle.occupancy, body)``.
        poses: [B, 4, 4] float32 body_to_world, metres.
    """
    return _compared(checker, oracle, poses, lambda one, rows: one.collides(poses[rows]))


def verify_sweeps(checker: Checker, oracle: Checker, start: Tensor, end: Tensor) -> Verification:
    """Compare what two checkers say about moves; see ``verify``.

    Args:
        checker: the one under test.
        oracle: the one that is trusted.
        start: [B, 4, 4] float32 body_to_world, metres.
        end: [B, 4, 4] float32 body_to_world, metres.
    """
    return _compared(checker, oracle, start, lambda one, rows: one.sweeps(start[rows], end[rows]))


def grown(body: Body, metres: float) -> Body | None:
    """A body whose surface lies ``metres`` further out, or further in below 0; None where nothing is left of it."""
    if isinstance(body, Box):
        x, y, z = (extent + 2.0 * metres for extent in body.size)
        return Box((x, y, z)) if min(x, y, z) > 0 else None
    if isinstance(body, Capsule):
        return replace(body, cap_radius=body.cap_radius + metres) if body.cap_radius + metres > 0 else None
    return replace(body, radius=body.radius + metres) if body.radius + metres > 0 else None


def _compared(
    checker: Checker, oracle: Checker, queries: Tensor, ask: Callable[[Checker, Tensor], Tensor]
) -> Verification:
    if checker.body != oracle.body:
        raise ValueError(f"oracle: expected one for {checker.body}, got one for {oracle.body}")
    everything = torch.arange(len(queries), device=queries.device)
    answers, expected = ask(checker, everything), ask(oracle, everything)
    rows = (answers != expected).nonzero()[:, 0]
    margins = _margins(oracle, rows, expected[rows], ask)
    found = zip(rows.tolist(), answers[rows].tolist(), expected[rows].tolist(), margins, strict=True)
    return Verification(len(queries), int(expected.sum()), tuple(Disagreement(*one) for one in found))


def _margins(oracle: Any, rows: Tensor, hits: Tensor, ask: Callable[[Checker, Tensor], Tensor]) -> list[float]:
    """Metres at which the oracle changes its mind about each row."""
    found = torch.full((len(rows),), torch.inf, dtype=torch.float64)
    for margin in MARGINS:
        for hit, sign in ((True, -1.0), (False, 1.0)):
            open_ = (found.isinf() & (hits.cpu() == hit)).nonzero()[:, 0]
            body = grown(oracle.body, sign * margin)
            if len(open_) and body is not None:
                flipped = ask(type(oracle)(oracle.occupancy, body), rows[open_.to(rows.device)]).cpu() != hit
                found[open_[flipped]] = margin
    return found.tolist()
