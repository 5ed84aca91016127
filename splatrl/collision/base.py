"""The interface that every collision checker implements."""

from typing import Protocol

from torch import Tensor

from splatrl.bodies import Body


class Checker(Protocol):
    """Tests one body against one occupancy, a batch of poses at a time."""

    body: Body

    def collides(self, body_to_world: Tensor) -> Tensor:
        """Return whether the body touches an occupied voxel at each pose.

        Args:
            body_to_world: [B, 4, 4] float32, metres.

        Returns:
            [B] bool.

        Raises:
            ValueError: names the first row that is not finite or not a rigid pose.
        """
        ...

    def free_fraction(self, start: Tensor, end: Tensor) -> Tensor:
        """Return the fraction of each straight move that is free before the body touches something.

        Args:
            start: [B, 4, 4] float32 body_to_world.
            end: [B, 4, 4] float32 body_to_world.

        Returns:
            [B] float32 in [0, 1]: 1 where nothing is touched along the whole move, both ends included.
        """
        ...

    def sweeps(self, start: Tensor, end: Tensor) -> Tensor:
        """Return whether each move hits anything, ends included: ``free_fraction(start, end) < 1``, [B] bool."""
        ...

    def clearance(self, points: Tensor) -> Tensor:
        """Return a lower bound on the distance from each point to the nearest occupied voxel.

        Args:
            points: [B, 3] float32 world, metres.

        Returns:
            [B] float32 metres, 0 inside an occupied voxel, infinite in an empty occupancy.
        """
        ...

    def ranges(self, body_to_world: Tensor, beams: Tensor, reach: float) -> Tensor:
        """Cast beams from the body's origin and return how far each goes before it enters an occupied voxel.

        The result is exact: the distance at which the ray enters the voxel's box, rounded to single precision. A voxel
        contains its lower faces but not its upper ones, and a ray that only touches an edge may pass.

        Args:
            body_to_world: [B, 4, 4] float32, metres.
            beams: [R, 3] float32 unit vectors, body frame.
            reach: maximum range, metres; anything farther away is not seen.

        Returns:
            [B, R] float32 metres: 0 for a ray that starts in an occupied voxel, ``reach`` where nothing is hit.

        Raises:
            ValueError: for a pose that is not rigid, beams that are not unit vectors, or a reach that is not positive.
        """
        ...
