"""Draws tracks of gates to fly through."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from splatrl.physics.courses import CourseSettings
from splatrl.physics.room import Floats, Room, ahead, between
from splatrl.values import require_number

BRANCHES = 12
"""Number of places tried for each gate."""


@dataclass(frozen=True)
class TrackSettings(CourseSettings):
    """Settings of tracks.

    A track begins at a free place, facing its first gate. Each gate stands clear of the boxes, the ground and the other
    gates, and the straight path to it and half a metre beyond it is free. Gates are passed along their yaw.

    Attributes:
        gates: number of gates.
        distance: shortest and longest distance from one gate to the next, metres.
        turn_deg: maximum turn of the path at a gate, degrees.
        skew_deg: maximum angle between a gate's yaw and the path to it, degrees.
        height: lowest and highest centre of a gate above the ground, metres.
        opening: side of a gate's opening, as in its MJCF, metres.
        frame: side of a gate's outer frame, metres.
        clearance: free space to keep around paths and between gates, metres.

    Raises:
        ValueError: for a number out of range.
    """

    gates: int = 4
    distance: Sequence[float] = (1.0, 1.7)
    turn_deg: float = 60.0
    skew_deg: float = 25.0
    height: Sequence[float] = (0.7, 1.3)
    opening: float = 0.7
    frame: float = 0.86
    clearance: float = 0.25

    tries = 400
    places = "gates"

    def __post_init__(self) -> None:
        super().__post_init__()
        require_number("task.course.skew_deg", self.skew_deg, 0.0, 90.0)
        self._require_range("height")
        for name in ("opening", "frame"):
            require_number(f"task.course.{name}", getattr(self, name), 1e-3, 1e3)
        if self.opening >= self.frame:
            raise ValueError(
                f"task.course.opening: expected a size below task.course.frame ({self.frame} m), got {self.opening}"
            )

    def drawn(self, room: Room, draw: np.random.Generator) -> Iterator[Floats | None]:
        """Draw tracks; see ``CourseSettings.drawn``. Every track is a draw."""
        tracks = _Tracks(room, self)
        while True:
            yield tracks.track(draw)


class _Tracks:
    """Draws tracks in a room."""

    def __init__(self, room: Room, settings: TrackSettings):
        self.room, self.settings = room, settings

    def track(self, draw: np.random.Generator) -> Floats | None:
        """Draw a start and gates [1 + G, 4], or return None if the start or some gate does not fit."""
        low, high = self.settings.height
        x, y = draw.uniform(self.room.lower + 0.3, self.room.upper - 0.3)
        track = [np.array([x, y, self.room.ground(x, y) + draw.uniform(low, high), draw.uniform(-math.pi, math.pi)])]
        if not self.room.free(track[0][None, :3], self.settings.clearance).all():
            return None
        while len(track) <= self.settings.gates:
            found = next((gate for _ in range(BRANCHES) if (gate := self.gate(track, draw)) is not None), None)
            if found is None:
                return None
            track.append(found)
        first = track[1][:2] - track[0][:2]
        track[0][3] = math.atan2(first[1], first[0])
        return np.stack(track)

    def gate(self, track: list[Floats], draw: np.random.Generator) -> Floats | None:
        """Draw the next gate of a track, or return None if it does not fit."""
        settings, last = self.settings, track[-1]
        begin = last[:3] + (0.5 * ahead(last[3]) if len(track) > 1 else 0.0)
        turn = math.radians(settings.turn_deg) if len(track) > 1 else math.pi
        way = last[3] + draw.uniform(-turn, turn)
        x, y = last[:2] + draw.uniform(settings.distance[0], settings.distance[1]) * ahead(way)[:2]
        z = self.room.ground(x, y) + draw.uniform(settings.height[0], settings.height[1])
        gate = np.array([x, y, z, way + math.radians(draw.uniform(-settings.skew_deg, settings.skew_deg))])
        end = gate[:3] + 0.5 * ahead(gate[3])
        rim = gate[:3] + self.rim(gate[3])
        flown = np.concatenate([between(begin, gate[:3]), between(gate[:3], end)])
        fits = self.room.free(rim, 0.05).all() and self.room.free(flown, settings.clearance).all()
        apart = 0.5 * settings.frame * math.sqrt(2.0) + settings.clearance
        for other in track[1:]:
            fits &= bool(np.linalg.norm(rim - other[:3], axis=1).min() > apart)
            fits &= other is last or bool(np.linalg.norm(flown - other[:3], axis=1).min() > apart)
            beyond = other[:3] + 0.5 * ahead(other[3])
            fits &= other is last or bool(np.linalg.norm(beyond - gate[:3]) > apart)
        for a, b in pairwise(track):  # it must not stand in an earlier path
            fits &= bool(np.linalg.norm(between(a[:3], b[:3]) - gate[:3], axis=1).min() > apart)
        return gate if fits else None

    def rim(self, yaw: float) -> Floats:
        """Return points on a gate's frame, relative to its centre: [8, 3]."""
        half, side = 0.5 * self.settings.frame, np.array([-math.sin(yaw), math.cos(yaw), 0.0])
        return np.array([half * (a * side + [0.0, 0.0, b]) for a in (-1, 0, 1) for b in (-1, 0, 1) if a or b])
