"""Statistics of an occupancy."""

from dataclasses import dataclass

NOTHING_SOLID = "nothing is solid within bounds; is the scale right?"
"""What to say of an occupancy without solid voxels, in which robots would pass through everything."""


@dataclass(frozen=True)
class OccupancyReport:
    """Counts and volumes of the voxels in a grid.

    Attributes:
        resolution: edge of a voxel, metres.
        shape: number of voxels along x, y and z.
        occupied: number of solid voxels.
        components: number of 26-connected components that they form.
        occupied_volume: volume of the solid voxels, cubic metres.
        free_volume: volume of the grid's other voxels, cubic metres.
        floaters: number of voxels dropped because their component was too small to be real.
        filled: number of voxels made solid because nothing can reach them.
    """

    resolution: float
    shape: tuple[int, int, int]
    occupied: int
    components: int
    occupied_volume: float
    free_volume: float
    floaters: int
    filled: int

    def __str__(self) -> str:
        x, y, z = self.shape
        pieces = "1 piece" if self.components == 1 else f"{self.components:,} pieces"
        return "\n".join(
            [
                *([] if self.occupied else [f"problem     {NOTHING_SOLID}"]),
                f"grid        {x} × {y} × {z} voxels of {self.resolution:g} m",
                f"occupied    {self.occupied:,} voxels, {self.occupied_volume:.3f} m³, in {pieces}",
                f"free        {self.free_volume:.3f} m³",
                f"filled      {self.filled:,} voxels that cannot be reached",
                f"floaters    {self.floaters:,} voxels dropped",
            ]
        )
