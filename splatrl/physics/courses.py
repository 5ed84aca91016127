"""Courses of places to be passed in order, drawn where a scene has room for them."""

import inspect
import json
import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from hashlib import blake2b
from pathlib import Path
from typing import ClassVar

import numpy as np

from splatrl.files import digest_of
from splatrl.physics import room as room_module
from splatrl.physics.room import Floats, Room
from splatrl.physics.terrain import Terrain
from splatrl.scenes.cache import cached_arrays
from splatrl.values import require_number


@dataclass(frozen=True)
class CourseSettings(ABC):
    """What courses are like; a subclass says what stands at their places, and draws one.

    Attributes:
        distance: shortest and longest way from one place to the next, metres.
        turn_deg: the most that the way turns at a place, degrees.
        clearance: around what a robot passes on its way, metres.

    Raises:
        ValueError: for a number out of range.
    """

    distance: Sequence[float]
    turn_deg: float
    clearance: float

    tries: ClassVar[int]
    """Courses that are begun for each that is asked for, at most."""
    places: ClassVar[str]
    """The attribute that counts the places."""

    def __post_init__(self) -> None:
        require_number(f"task.course.{self.places}", getattr(self, self.places), 1, 64, whole=True)
        require_number("task.course.turn_deg", self.turn_deg, 0.0, 120.0)
        require_number("task.course.clearance", self.clearance, 0.0, 10.0)
        self._require_range("distance")

    @property
    def length(self) -> int:
        """Number of places of a course, P."""
        return int(getattr(self, self.places))

    @abstractmethod
    def drawn(self, room: Room, draw: np.random.Generator) -> Floats | None:
        """One course in a room: [1 + P, 4], x, y, z and yaw of the start and of each place; None where no way leads on.

        The start heads for the first place.
        """

    def _require_range(self, name: str) -> None:
        """Refuse what is no range of metres."""
        value = getattr(self, name)
        if not (len(value) == 2 and 0.0 < value[0] <= value[1] <= 1e3):
            raise ValueError(f"task.course.{name}: expected 0 < lowest ≤ highest, got {list(value)}")


def draw_courses(
    terrain: Terrain,
    lower: Sequence[float],
    upper: Sequence[float],
    settings: CourseSettings,
    count: int,
    seed: int,
    ceiling: float = math.inf,
) -> Floats:
    """Draw courses between bounds, once for each terrain; each depends on the seed and its own number alone.

    Args:
        terrain: ground and boxes.
        lower: smallest x and y, metres.
        upper: largest x and y, metres.
        settings: what courses are like.
        count: how many, N.
        seed: of what is drawn.
        ceiling: height above the ground below which courses stay, metres.

    Returns:
        [N, 1 + P, 4] float64: x, y, z in metres, world, and yaw of the start and of each place.

    Raises:
        ValueError: where there is no room.
    """
    complaint = (
        f"task.course: expected room for {settings.length} {settings.places}, found none in {settings.tries} tries; "
        f"type wider task.motion.lower and upper, or fewer task.course.{settings.places}"
    )
    if math.isfinite(ceiling):
        complaint += ", or a higher task.motion.ceiling"
    room = Room(terrain, lower, upper, ceiling)

    def each(number: int) -> Floats:
        rng = np.random.default_rng([seed, number])
        drawn = (settings.drawn(room, rng) for _ in range(settings.tries))
        if (course := next((course for course in drawn if course is not None), None)) is None:
            raise ValueError(complaint)
        return course

    code = digest_of([Path(__file__), Path(room_module.__file__), Path(inspect.getfile(type(settings)))])
    known = [list(lower), list(upper), ceiling, asdict(settings), count, seed, code]
    digest = blake2b(json.dumps(known, default=list).encode(), digest_size=16)
    for part in (terrain.plane, terrain.boxes):
        digest.update(part.numpy().tobytes())
    name = f"{settings.places}-{digest.hexdigest()}"
    return cached_arrays(name, lambda: {"courses": np.stack([each(number) for number in range(count)])})["courses"]
