"""Steps along the heading and turns on the spot: the motion of the fps task."""

from collections.abc import Sequence

from splatrl.motions.steps import StepMotion

CELL = 0.05
"""Smallest distance between the positions at which paths are computed, metres."""


class ForwardMotion(StepMotion):
    """Moves forward and back by a step along the heading, and turns left and right by an angle, tied to no lattice.

    A state is [..., 3] float32: x and y in metres and yaw in radians. The four actions, in the published order, are
    forward, back, left (counter-clockwise) and right.

    Args:
        height: z of every pose, metres.
        step: length of a step, metres.
        angle_step_deg: angle of a turn, degrees; must divide 360.
        lower: smallest x and y, metres.
        upper: largest x and y, metres.
        spacing: distance between neighbouring starts, metres; None takes the step. Starts have every heading that is a
            whole number of turns.

    Raises:
        ValueError: for a step that is not positive, an angle that does not divide 360°, or bounds without area.
    """

    def __init__(
        self,
        height: float,
        step: float = 0.1,
        angle_step_deg: float = 10.0,
        lower: Sequence[float] = (-1.0, -1.0),
        upper: Sequence[float] = (1.0, 1.0),
        spacing: float | None = None,
    ):
        actions = {"forward": (1, 0), "back": (-1, 0), "left": (0, 1), "right": (0, -1)}
        apart, cell = step if spacing is None else spacing, max(0.5 * step, CELL)
        super().__init__(actions, step, angle_step_deg, height, lower, upper, apart, None, cell)
