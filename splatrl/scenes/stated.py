"""Facts that a person states about where a splat file lies in the world; a guess supplies the rest."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from torch import Tensor

from splatrl.files import expanded
from splatrl.scenes.formats.ply_header import read_ply_header
from splatrl.scenes.frame import AXES, similarity
from splatrl.scenes.gaussians import Gaussians
from splatrl.scenes.nerfstudio import DATAPARSER, stands, transform_beside
from splatrl.scenes.placement import (
    Frame,
    matrix_frame,
    metres_per_unit,
    nerfstudio_transform,
    rescaled,
    upright_frame,
)
from splatrl.scenes.upright import GIVEN, Guess, Upright, guess_upright
from splatrl.values import require_number, split_words


@dataclass(frozen=True, eq=False)
class StatedFrame:
    """The known parts of a file's frame; None for each unknown one.

    Attributes:
        axes: signed axes of the file that become the world's x, y and z, as for ``similarity``.
        transform: [4, 4] float64, from the file to world metres, in place of axes and translation.
        scale: metres per unit; if a transform is given, it is rescaled about the world's origin.
        translation: [3] metres, added last.
        rough_up: [3] up direction in the file to within about 15°, to be refined by the guess.
        vertical: [3] direction that the file itself calls vertical, which need not be true; helps the guess.

    Raises:
        ValueError: for axes that ``similarity`` refuses, a transform beside axes or a translation, or a scale that is
            not finite and above 0.
    """

    axes: Sequence[str] | None = None
    transform: Tensor | None = None
    scale: float | None = None
    translation: Sequence[float] | None = None
    rough_up: Sequence[float] | None = None
    vertical: Sequence[float] | None = None

    def __post_init__(self) -> None:
        if self.transform is not None and (self.axes is not None or self.translation is not None):
            raise ValueError("transform: expected either a transform or axes and translation, got both")
        if self.axes is not None:
            similarity(self.axes)
        if self.scale is not None:
            require_number("scale", self.scale, above=0.0, unit="metres per unit")

    @property
    def placed(self) -> bool:
        """Whether axes, a transform or a translation state how the file lies among the world's axes."""
        return any(stated is not None for stated in (self.axes, self.transform, self.translation))

    def up(self) -> list[float] | None:
        """Return the up direction in the file's frame, [3]; None if neither axes nor a transform state it."""
        turned = self.transform if self.axes is None else similarity(self.axes)
        return None if turned is None else turned[2, :3].tolist()

    def beside(self, splat: Path) -> tuple["StatedFrame", list[str]]:
        """Add the transform that nerfstudio left beside a splat file, if the frame leaves the file's place open.

        Only its scale is added if ``rough_up`` states the orientation, or if nerfstudio's frame is not z-up. Without a
        transform, the axis that the file calls vertical is added.

        Returns:
            The frame, and a line that says what was added, if anything.

        Raises:
            ValueError: if nerfstudio's file is damaged.
        """
        if self.placed:
            return self, []
        transform = transform_beside(splat)
        if transform is None:
            return replace(self, vertical=vertical_axis(splat)), []
        if stands(transform) and self.rough_up is None:
            return replace(self, transform=transform), [f"frame       from {DATAPARSER} next to the file"]
        scale = float(transform[2, :3].norm()) if self.scale is None else self.scale
        reason = "; its frame is not z-up" if self.rough_up is None else ""
        return replace(self, scale=scale), [f"frame       scale from {DATAPARSER} next to the file{reason}"]

    def guess(self, gaussians: Gaussians, origin: Sequence[float] = (0.0, 0.0, 0.0)) -> Upright:
        """Guess how a file lies, except for what is stated.

        Walls are left out where the file's axes mean something: if axes, a transform or a translation are stated, or if
        the file is georeferenced.

        Args:
            gaussians: the file's Gaussians, in its own frame, relative to ``origin``.
            origin: [3] point in the file's frame.
        """
        roughly = self.rough_up is not None
        upright = guess_upright(gaussians, self.rough_up if roughly else self.up(), roughly, self.vertical)
        upright = replace(upright, origin=origin)
        if self.placed or any(origin):
            upright = replace(upright, walls=None)
        scale = self.scale
        if scale is None and self.transform is not None:
            scale = float(self.transform[:3, 0].norm())
        if scale is None:
            return upright
        return replace(upright, metres_per_unit=scale, units_guess=Guess(GIVEN, "the scale was given, not guessed"))

    def frame(self, upright: Upright) -> Frame:
        """Return arguments of ``similarity``: what is stated, and a guess for the rest.

        Args:
            upright: the guess.
        """
        if self.transform is None:
            return upright_frame(upright, self.axes, self.scale, self.translation)
        return matrix_frame(self.transform if self.scale is None else rescaled(self.transform, self.scale))


def vertical_axis(splat: Path) -> list[float] | None:
    """Return the direction that a PLY file's comment ``Vertical axis:`` states, [3], up or down; None without one.

    nerfstudio names an axis, and Brush states three numbers where it knows them; they may be in brackets. Brush's bare
    ``y`` says nothing: it writes that for every frame.
    """
    comments = read_ply_header(splat).comments if splat.suffix.lower() == ".ply" else ()
    for comment in comments:
        key, _, text = comment.partition(":")
        text = text.strip(" \t[]").lower()
        if key.lower() == "vertical axis" and text != "y":
            try:
                return _direction("comment", text)
            except ValueError:
                return None
    return None


def typed_frame(
    up: str | None = None,
    axes: str | None = None,
    scale: float | None = None,
    translation: str | None = None,
    matrix: str | None = None,
    nerfstudio: Path | None = None,
    distance: str | None = None,
) -> StatedFrame:
    """Return the frame that the options of ``splatrl-scene`` state, from the texts typed after them.

    Args:
        up: an axis such as -y, or 3 numbers.
        axes: 3 signed axes.
        scale: metres per unit.
        translation: 3 numbers, metres.
        matrix: 16 numbers, row by row.
        nerfstudio: a ``dataparser_transforms.json``.
        distance: two points in the file and the metres between them, 7 numbers.

    Raises:
        FileNotFoundError: if the JSON file is missing.
        ValueError: for texts of another form, or options that contradict each other; names the option.
    """
    turns = {"axes": axes, "matrix": matrix, "nerfstudio": nerfstudio, "up": up}
    given = [name for name, value in turns.items() if value is not None]
    if len(given) > 1:
        raise ValueError(
            f"expected at most one of --axes, --matrix, --nerfstudio and --up, got --{' and --'.join(given)}"
        )
    if scale is not None and distance is not None:
        raise ValueError("expected --scale or --distance, got both")
    if translation is not None and given not in ([], ["axes"], ["up"]):
        raise ValueError(f"--translation: expected on its own or with --axes or --up, got it with --{given[0]}")
    transform = None
    if distance is not None:
        values = _numbers("--distance", distance, 7)
        scale = metres_per_unit(values[:3], values[3:6], values[6])
    if matrix is not None:
        transform = similarity(matrix=np.reshape(_numbers("--matrix", matrix, 16), (4, 4)).tolist())
    elif nerfstudio is not None:
        transform = nerfstudio_transform(expanded(nerfstudio))
    return StatedFrame(
        axes=None if axes is None else split_words(axes),
        transform=transform,
        scale=scale,
        translation=None if translation is None else _numbers("--translation", translation, 3),
        rough_up=None if up is None else _direction("--up", up),
    )


def described_upright(gaussians: Gaussians, metric: bool) -> Upright:
    """Return how a scene stands whose ``scene.yaml`` states the frame: z is up and the floor is at z = 0.

    Args:
        gaussians: the scene's Gaussians, world frame.
        metric: False if ``scene.yaml`` says that the scale is unknown or only a guess.
    """
    guessed = guess_upright(gaussians, [0.0, 0.0, 1.0])
    seen = f"the opaque layer is at {round(guessed.floor, 3) + 0.0:g} m ({guessed.floor_guess.confidence})"
    return replace(
        guessed,
        floor=0.0,
        axis_guess=Guess(GIVEN, "z in scene.yaml"),
        sign_guess=Guess(GIVEN, "z in scene.yaml"),
        floor_guess=Guess(GIVEN, f"z = 0 in scene.yaml; {seen}"),
        metres_per_unit=1.0,
        units_guess=Guess(GIVEN, "scene.yaml states the scale" + ("" if metric else ", and that it is uncertain")),
    )


def _direction(option: str, text: str) -> list[float]:
    """Parse an axis or 3 numbers into a direction: [3], file axes."""
    try:
        words = split_words(text)
        axis, sign = AXES[words[0]] if len(words) == 1 else (0, 0.0)
        values = [float(word) for word in words] if len(words) > 1 else [sign * (i == axis) for i in range(3)]
    except (KeyError, ValueError):
        values = []
    if len(values) != 3 or not np.isfinite(values).all() or not np.any(values):
        raise ValueError(f"{option}: expected one of {', '.join(AXES)}, or 3 numbers, got {text!r}")
    return values


def _numbers(option: str, text: str, count: int) -> list[float]:
    try:
        values = [float(word) for word in split_words(text)]
    except ValueError as error:
        raise ValueError(f"{option}: expected {count} numbers, got {text!r}") from error
    if len(values) != count:
        raise ValueError(f"{option}: expected {count} numbers, got {len(values)}: {text!r}")
    return values
