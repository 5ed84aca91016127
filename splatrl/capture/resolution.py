"""Resolution of a fit: as fine as what the robots that are to train in the scene will see."""

import math
from dataclasses import dataclass, replace

from splatrl.capture.base import Reconstruction
from splatrl.capture.fitting.fit import FitSettings
from splatrl.envs.robot import Robot

MARGIN = 2.0
"""Pixels of a photo per pixel of a robot that looks from where the photo was taken: robots go nearer."""
PIXELS = 320 * 240
"""Number of pixels in a fitted image for which ``FitSettings.cap`` is meant."""


@dataclass(frozen=True)
class Resolution:
    """The robots' camera, and values that take precedence over what follows from it.

    Attributes:
        robot_width: width of a robot's image, pixels.
        robot_fov_deg: its horizontal field of view, degrees.
        width: width of the images that are fitted, pixels; None derives it from the robots' camera.
        gaussians: maximum number of Gaussians; None derives it from the number of pixels.

    Raises:
        ValueError: for a camera that sees nothing.
    """

    robot_width: int = Robot.image_width
    robot_fov_deg: float = Robot.fov_deg
    width: int | None = None
    gaussians: int | None = None

    def __post_init__(self) -> None:
        if self.robot_width < 1 or not 0.0 < self.robot_fov_deg < 180.0:
            got = f"{self.robot_width} and {self.robot_fov_deg}"
            raise ValueError(f"robot: expected at least 1 pixel across and a field of view from 0° to 180°, got {got}")

    def of(self, reconstruction: Reconstruction, fit: FitSettings) -> FitSettings:
        """Return settings of a fit with the width and the cap that the robots need.

        The width gives ``MARGIN`` times the pixels per degree of a robot's image, but no less than the settings have
        and no more than the photos. The cap grows with the number of pixels beyond ``PIXELS``.

        Args:
            reconstruction: the reconstruction whose photos are fitted.
            fit: the settings to start from.
        """
        focal = self.robot_width / 2 / math.tan(math.radians(self.robot_fov_deg) / 2)
        needed = math.ceil(MARGIN * focal * reconstruction.width / float(reconstruction.K[0, 0]))
        width = min(max(fit.width, needed) if self.width is None else self.width, reconstruction.width)
        pixels = width * width * reconstruction.height / reconstruction.width
        cap = round(fit.cap * max(1.0, pixels / PIXELS)) if self.gaussians is None else self.gaussians
        return replace(fit, width=width, cap=cap)
