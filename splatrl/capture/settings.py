"""Settings of a capture."""

from dataclasses import dataclass, field

from splatrl.capture.base import Reconstruction
from splatrl.capture.fitting.fit import FitSettings
from splatrl.capture.marker import MARKER_SIDE
from splatrl.capture.resolution import Resolution
from splatrl.capture.scale import Distance
from splatrl.scenes.description import SPLAT


@dataclass(frozen=True)
class CaptureSettings:
    """Settings of a capture.

    Attributes:
        count: minimum and maximum number of images that are taken from a video.
        longest: maximum pixels along the longer side of these images.
        force: whether to go on with a capture that a first look refuses, or without the images that cannot be joined,
            and to replace an existing scene.
        seed: seed of everything that is random.
        camera_height: mean height of the camera above the floor, metres, where that sets the scale.
        distance: distance between two points in images, where that sets the scale.
        marker: side of a printed marker's black square, metres.
        splat: name of the splat file in the scene's folder; one that ends in .spz is small.
        fit: settings of the fit.
        still: whether nothing moved while it was filmed, so that moving things need not be looked for.
        resolution: sets the width and the cap of the fit by the robots' image size; None takes those of ``fit``.
    """

    count: tuple[int, int] = (120, 200)
    longest: int = 960
    force: bool = False
    seed: int = 0
    camera_height: float | None = None
    distance: Distance | None = None
    marker: float = MARKER_SIDE
    splat: str = SPLAT
    fit: FitSettings = field(default_factory=FitSettings)
    still: bool = False
    resolution: Resolution | None = None

    def fit_of(self, found: Reconstruction) -> FitSettings:
        """Return the settings of the fit to a reconstruction's photos."""
        return self.fit if self.resolution is None else self.resolution.of(found, self.fit)
