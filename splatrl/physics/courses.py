"""Draws courses of places to pass in order, where a scene has room for them."""

import inspect
import json
import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from hashlib import blake2b
from itertools import islice
from pathlib import Path
from typing import ClassVar

import numpy as np

from splatrl.array_files import Arrays
from splatrl.files import digest_of
from splatrl.physics.room import Floats, Room
from splatrl.physics.terrain import Terrain
from splatrl.scenes.cache import cached_arrays
from splatrl.values import are_numbers, require_number


@dataclass(frozen=True)
class CourseSettings(ABC):
    """Settings of courses; a subclass defines what the places are, and draws a course.

    Attributes:
        distance: shortest and longest distance from one place to the next, metres.
        turn_deg: maximum turn of the path at a place, degrees.
        clearance: free space to keep around the robot's path, metres.

    Raises:
        ValueError: for a number out of range.
    """

    distance: Sequence[float]
    turn_deg: float
    clearance: float

    tries: ClassVar[int]
    """Maximum number of draws for each course."""
    places: ClassVar[str]
    """Name of the attribute that holds the number of places."""

    def __post_init__(self) -> None:
        require_number(f"task.course.{self.places}", getattr(self, self.places), 1, 64, whole=True)
        require_number("task.course.turn_deg", self.turn_deg, 0.0, 120.0)
        require_number("task.course.clearance", self.clearance, 0.0, 10.0)
        self._require_range("distance")

    @property
    def length(self) -> int:
        """Number of places in a course, P."""
        return int(getattr(self, self.places))

    @abstractmethod
    def drawn(self, room: Room, draw: np.random.Generator) -> Iterator[Floats | None]:
        """Search a room for a course without end: yield the course once it is complete, and None after other draws.

        The start faces the first place. Whoever takes the course decides after how many draws to give up.

        Yields:
            [1 + P, 4] float64: x, y, z and yaw of the start and of each place.
        """

    def _require_range(self, name: str) -> None:
        """Refuse a value that is not a range of metres above 0."""
        value = getattr(self, name)
        if not (are_numbers(value, 2) and 0.0 < value[0] <= value[1] <= 1e3):
            raise ValueError(f"task.course.{name}: expected 0 < lowest ≤ highest, got {value}")


def draw_courses(
    terrain: Terrain,
    lower: Sequence[float],
    upper: Sequence[float],
    settings: CourseSettings,
    count: int,
    seed: int,
    ceiling: float = math.inf,
) -> Floats:
    """Draw courses within bounds, or take them from the cache; each depends only on the seed and its own number.

    Args:
        terrain: ground and boxes.
        lower: smallest x and y, metres.
        upper: largest x and y, metres.
        settings: settings of the courses.
        count: number of courses, N.
        seed: seed of the draws.
        ceiling: height above the ground below which courses stay, metres.

    Returns:
        [N, 1 + P, 4] float64: x, y, z in metres, world, and yaw of the start and of each place.

    Raises:
        ValueError: if there is no room for a course.
    """
    complaint = (
        f"task.course: expected room for {settings.length} {settings.places}, found none in {settings.tries:,} draws; "
        f"type wider task.motion.lower and upper, a larger task.course.turn_deg, or fewer task.course.{settings.places}"
    )
    if math.isfinite(ceiling):
        complaint += ", or a higher task.motion.ceiling"
    room = Room(terrain, lower, upper, ceiling)

    def each(number: int) -> Floats:
        rng = np.random.default_rng([seed, number])
        drawn = islice(settings.drawn(room, rng), settings.tries)
        if (course := next((course for course in drawn if course is not None), None)) is None:
            raise ValueError(complaint)
        return course

    code = digest_of([*sorted(Path(__file__).parent.glob("*.py")), Path(inspect.getfile(type(settings)))])
    known = [list(lower), list(upper), ceiling, asdict(settings), count, seed, code]
    digest = blake2b(json.dumps(known, default=list).encode(), digest_size=16)
    for part in (terrain.plane, terrain.boxes):
        digest.update(part.numpy().tobytes())
    name = f"{settings.places}-{digest.hexdigest()}"

    def build() -> Arrays:
        return {"courses": np.stack([each(number) for number in range(count)])}

    return cached_arrays(name, build, what="courses")["courses"]
