"""The things among which a robot stands: their files, which it may push, and what is drawn in their place."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from splatrl.files import expanded
from splatrl.physics.compose import RESERVED
from splatrl.physics.robots import mjcf_path


class Things:
    """Things by name.

    Attributes:
        paths: their MJCF files.
        pushed: names of those that the robot may touch.
        looks: splat files to draw in place of their geoms.

    Args:
        paths: MJCF files, or names of splatrl's own.
        pushed: see the attribute.
        looks: see the attribute.

    Raises:
        FileNotFoundError: for MJCF files that do not exist.
        ValueError: for names that things cannot have in a model, and names of no thing.
    """

    def __init__(self, paths: Mapping[str, str | Path], pushed: Sequence[str], looks: Mapping[str, str | Path]):
        self.paths = {str(name): mjcf_path(str(path)) for name, path in paths.items()}
        self.pushed = tuple(pushed)
        self.looks = {str(name): expanded(path) for name, path in looks.items()}
        if taken := [name for name in self.paths if name in RESERVED or "/" in name]:
            raise ValueError(
                f"task.motion.things: expected names without / and other than {', '.join(RESERVED)}, got {taken[0]}"
            )
        for key, names in (("looks", self.looks), ("pushed", self.pushed)):
            if unknown := set(names) - set(self.paths):
                raise ValueError(
                    f"task.motion.{key}: expected names from task.motion.things, got {', '.join(sorted(unknown))}"
                )

    @property
    def unpushed(self) -> list[str]:
        """Names of the things that the robot must not touch."""
        return [name for name in self.paths if name not in self.pushed]

    def copies(self, count: int) -> "Things":
        """Return ``count`` copies of each thing, with names numbered from 1."""

        def numbered(name: str) -> list[str]:
            return [f"{name}{number}" for number in range(1, count + 1)]

        return Things(
            {one: path for name, path in self.paths.items() for one in numbered(name)},
            [one for name in self.pushed for one in numbered(name)],
            {one: path for name, path in self.looks.items() for one in numbered(name)},
        )
