"""Facts that a person states about where a splat file lies in the world; a guess supplies the rest."""

from collections.abc import Sequence
from dataclasses import dataclass

from torch import Tensor

from splatrl.scenes.frame import similarity
from splatrl.scenes.placement import Frame, matrix_frame, rescaled, upright_frame
from splatrl.scenes.upright import Upright


@dataclass(frozen=True, eq=False)
class StatedFrame:
    """The known parts of a file's frame; None for each unknown one.

    Attributes:
        axes: signed axes of the file that become the world's x, y and z, as for ``similarity``.
        transform: [4, 4] float64, from the file to world metres, in place of axes and translation.
        scale: metres per unit; if a transform is given, it is rescaled about the world's origin.
        translation: [3] metres, added last.

    Raises:
        ValueError: for axes that ``similarity`` refuses, a transform beside axes or a translation, or a scale that is
            not finite and above 0.
    """

    axes: Sequence[str] | None = None
    transform: Tensor | None = None
    scale: float | None = None
    translation: Sequence[float] | None = None

    def __post_init__(self) -> None:
        if self.transform is not None and (self.axes is not None or self.translation is not None):
            raise ValueError("transform: expected either a transform or axes and translation, got both")
        if self.axes is not None:
            similarity(self.axes)
        if self.scale is not None and not 0.0 < self.scale < float("inf"):
            raise ValueError(f"scale: expected a positive, finite number of metres per unit, got {self.scale}")

    def up(self) -> list[float] | None:
        """Return the up direction in the file's frame, [3]; None if neither axes nor a transform state it."""
        turned = self.transform if self.axes is None else similarity(self.axes)
        return None if turned is None else turned[2, :3].tolist()

    def frame(self, upright: Upright) -> Frame:
        """Return arguments of ``similarity``: what is stated, and a guess for the rest.

        Args:
            upright: the guess.
        """
        if self.transform is None:
            return upright_frame(upright, self.axes, self.scale, self.translation)
        return matrix_frame(self.transform if self.scale is None else rescaled(self.transform, self.scale))
