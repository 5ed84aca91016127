"""What every collision checker promises."""

from typing import Protocol

from torch import Tensor

from splatrl.bodies import Body


class Checker(Protocol):
    """Tests one body against one occupancy, a batch of poses at a time."""

    body: Body

    def collides(self, body_to_world: Tensor) -> Tensor:
        """Whether the body touches an occupied voxel.

        Args:
            body_to_world: [B, 4, 4] float32, metres.

        Returns:
            [B] bool.

        Raises:
            ValueError: names the first row that is not finite or not a rigid pose.
        """
        ...

    def free_fraction(self, start: Tensor, end: Tensor) -> Tensor:
        """How much of a straight move is free before the body touches something.

        Args:
            start: [B, 4, 4] float32 body_to_world.
            end: [B, 4, 4] float32 body_to_world.

        Returns:
            [B] float32 in [0, 1]: 1 where nothing is touched on the way, ends included.
        """
        ...

    def sweeps(self, start: Tensor, end: Tensor) -> Tensor:
        """Whether anything is hit on the way, ends included: ``free_fraction(start, end) < 1``, [B] bool."""
        ...

    def clearance(self, points: Tensor) -> Tensor:
        """A lower bound on the distance from points to the nearest occupied voxel.

        Args:
            points: [B, 3] float32 world, metres.

        Returns:
            [B] float32 metres, 0 inside an occupied voxel, infinite in an empty occupancy.
        """
        ...

    def ranges(self, body_to_world: Tensor, beams: Tensor, reach: float) -> Tensor:
        """How far beams from the body's origin go before they enter an occupied voxel.

        Exact: the distance at which the ray enters the voxel's box, rounded to single precision. A voxel holds its
        lower faces and not its upper ones, and a ray that only touches an edge may pass.

        Args:
            body_to_world: [B, 4, 4] float32, metres.
            beams: [R, 3] float32 unit vectors, body frame.
            reach: metres; what is farther away is not seen.

        Returns:
            [B, R] float32 metres: 0 from inside an occupied voxel, ``reach`` where nothing is met.

        Raises:
            ValueError: for a pose that is not rigid, beams that are no unit vectors, or a reach that is not positive.
        """
        ...
