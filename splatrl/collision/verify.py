"""Compares two collision checkers: where they disagree, and by what margin."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from splatrl.bodies import Body, Box, Capsule
from splatrl.collision.base import Checker

MARGINS = tuple(1e-7 * 2.0**k for k in range(21))
"""Metres by which a body is grown or shrunk to find the margin of a disagreement, up to a decimetre."""
_SHOWN = 20


@dataclass(frozen=True)
class Disagreement:
    """One query that two checkers answer differently.

    Attributes:
        row: row of the batch.
        answer: the checker's answer, True for a hit.
        expected: the oracle's answer.
        margin: metres by which the body must be grown, or shrunk if the oracle says hit, for the oracle's answer to
            flip: the first of ``MARGINS`` that flips it, so less than twice what is needed; infinite if none does.
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
        poses: number of poses, or moves, that were compared.
        hits: number of them that the oracle calls hits.
        disagreements: the disagreements, in row order.
    """

    poses: int
    hits: int
    disagreements: tuple[Disagreement, ...]

    @property
    def agreed(self) -> int:
        """Number of queries that both checkers answer the same."""
        return self.poses - len(self.disagreements)

    @property
    def missed(self) -> tuple[Disagreement, ...]:
        """The oracle's hits that the checker calls free."""
        return tuple(one for one in self.disagreements if one.expected)

    def beyond(self, margin: float) -> tuple[Disagreement, ...]:
        """Return the disagreements with a margin of more than ``margin`` metres."""
        return tuple(one for one in self.disagreements if one.margin > margin)

    def __str__(self) -> str:
        lines = [f"{self.agreed} of {self.poses} agreed; hits by the oracle: {self.hits}"]
        if self.disagreements:
            worst = max(one.margin for one in self.disagreements)
            lines[0] += f"; {len(self.missed)} missed, margins up to {worst:.1e} m"
        widest = sorted(self.disagreements, key=lambda one: -one.margin)
        lines += [f"  {one}" for one in widest[:_SHOWN]]
        if len(widest) > _SHOWN:
            lines.append(f"  and {len(widest) - _SHOWN} with smaller margins")
        return "\n".join(lines)


def verify(checker: Checker, oracle: Checker, poses: Tensor) -> Verification:
    """Compare two checkers' answers for poses.

    Args:
        checker: the checker under test.
        oracle: the trusted checker; rebuilt for grown and shrunk bodies by ``type(oracle)(oracle.occupancy, body)``.
        poses: [B, 4, 4] float32 body_to_world, metres.
    """
    return _compared(checker, oracle, poses, lambda one, rows: one.collides(poses[rows]))


def verify_sweeps(checker: Checker, oracle: Checker, start: Tensor, end: Tensor) -> Verification:
    """Compare two checkers' answers for moves; see ``verify``.

    Args:
        checker: the checker under test.
        oracle: the trusted checker.
        start: [B, 4, 4] float32 body_to_world, metres.
        end: [B, 4, 4] float32 body_to_world, metres.
    """
    return _compared(checker, oracle, start, lambda one, rows: one.sweeps(start[rows], end[rows]))


def grown(body: Body, metres: float) -> Body | None:
    """Return a body whose surface lies ``metres`` further out, or in if negative; None if nothing is left of it."""
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
        raise ValueError(f"oracle: expected a checker for {checker.body}, got one for {oracle.body}")
    everything = torch.arange(len(queries), device=queries.device)
    answers, expected = ask(checker, everything), ask(oracle, everything)
    rows = (answers != expected).nonzero()[:, 0]
    margins = _margins(oracle, rows, expected[rows], ask)
    found = zip(rows.tolist(), answers[rows].tolist(), expected[rows].tolist(), margins, strict=True)
    return Verification(len(queries), int(expected.sum()), tuple(Disagreement(*one) for one in found))


def _margins(oracle: Any, rows: Tensor, hits: Tensor, ask: Callable[[Checker, Tensor], Tensor]) -> list[float]:
    """Return the margin at which the oracle's answer for each row flips, metres."""
    found = torch.full((len(rows),), torch.inf, dtype=torch.float64)
    for margin in MARGINS:
        for hit, sign in ((True, -1.0), (False, 1.0)):
            open_ = (found.isinf() & (hits.cpu() == hit)).nonzero()[:, 0]
            body = grown(oracle.body, sign * margin)
            if len(open_) and body is not None:
                flipped = ask(type(oracle)(oracle.occupancy, body), rows[open_.to(rows.device)]).cpu() != hit
                found[open_[flipped]] = margin
    return found.tolist()
