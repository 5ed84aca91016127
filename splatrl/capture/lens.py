"""The lens of an image: its intrinsics, how it bends straight lines, and the lens without distortion in its place."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splatrl.extras import require

Floats = NDArray[np.float64]

WIDEST = 60.0
"""Maximum angle beside a fisheye's axis, horizontally or vertically, that is kept, degrees: farther out, a straight
image magnifies the lens's pixels more than fourfold, at the expense of its middle."""
STEEPEST = 89.0
"""Maximum angle from a fisheye's axis, degrees; what is farther off counts as at this angle."""
HALF = np.array([[0.0, 0.0, 0.5], [0.0, 0.0, 0.5], [0.0, 0.0, 0.0]])
"""What K [3, 3] has more than OpenCV's, which has the centre of the first pixel at 0."""


@dataclass(frozen=True)
class Lens:
    """Intrinsics of an image of a stated size, pixels, with the centre of the first pixel at (0.5, 0.5).

    Attributes:
        width: width of the image that the intrinsics belong to.
        height: height of that image.
        fx: horizontal focal length.
        fy: vertical focal length.
        cx: principal point, from the left edge.
        cy: principal point, from the upper edge.
        distortion: OpenCV's k1, k2, p1, p2 and k3 (or only the first four), or of a fisheye k1, k2, k3, k4.
        fisheye: whether the lens maps angles rather than their tangents.
    """

    width: float
    height: float
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = (0.0,) * 5
    fisheye: bool = False

    @property
    def bends(self) -> bool:
        """Whether its images show straight lines bent."""
        return self.fisheye or any(self.distortion)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the image, whole pixels."""
        return round(self.width), round(self.height)

    def K(self, size: tuple[int, int]) -> Floats:
        """Return the intrinsics [3, 3] of the same view at a width and height, pixels."""
        across, down = size[0] / self.width, size[1] / self.height
        return np.array([[self.fx * across, 0, self.cx * across], [0, self.fy * down, self.cy * down], [0, 0, 1]])

    def straight(self) -> "Lens":
        """Return the lens without distortion whose image, of the same size, shows as much as this one can fill.

        What is more than ``WIDEST`` beside a fisheye's axis is cut off.
        """
        if not self.bends:
            return self
        if self.fisheye:
            new = self._inside()
        else:
            cv2: Any = require("cv2", "capture")
            new, _ = cv2.getOptimalNewCameraMatrix(self.K(self.size) - HALF, np.array(self.distortion), self.size, 0)
        (fx, _, cx), (_, fy, cy), _ = (new + HALF).tolist()
        return Lens(self.width, self.height, fx, fy, cx, cy)

    def maps(self, size: tuple[int, int], camera: "Lens", seen: tuple[int, int]) -> Any:
        """Return OpenCV's maps for ``remap``, from images of this lens to what a camera in the same place sees.

        Args:
            size: width and height of this lens's images, pixels.
            camera: a lens without distortion.
            seen: width and height of the camera's images, pixels.
        """
        cv2: Any = require("cv2", "capture")
        own, new = self.K(size) - HALF, camera.K(seen) - HALF
        model = cv2.fisheye if self.fisheye else cv2
        return model.initUndistortRectifyMap(own, np.array(self.distortion), np.eye(3), new, seen, cv2.CV_16SC2)

    def straightened(self, places: Floats) -> Floats:
        """Return where pixels are in an image without distortion of focal length 1, around its middle: [N, 2]."""
        K, distortion = self.K(self.size), np.array(self.distortion)
        if self.fisheye:
            return _rays(places, K, distortion)
        cv2: Any = require("cv2", "capture")
        found: Floats = cv2.undistortPoints(places.reshape(-1, 1, 2), K, distortion).reshape(-1, 2)
        return found

    def folds(self, camera: "Lens") -> bool:
        """Return whether distortion maps different directions that a camera without it sees to one pixel."""
        k1, k2, _, _, k3 = self.distortion
        corner = np.hypot(
            max(camera.cx, camera.width - camera.cx) / camera.fx, max(camera.cy, camera.height - camera.cy) / camera.fy
        )
        r2 = np.linspace(0.0, corner, 101) ** 2
        return bool((1.0 + r2 * (3.0 * k1 + r2 * (5.0 * k2 + r2 * 7.0 * k3)) <= 0.0).any())

    def _inside(self) -> Floats:
        """Return K [3, 3], less ``HALF``, of a straight image of the same size that a fisheye fills to the edges."""
        last, new = np.array(self.size) - 1.0, np.eye(3)
        along = np.linspace(0.0, 1.0, 101)
        for axis in (0, 1):
            ends = []
            for edge in (0.0, last[axis]):
                places = along[:, None] * last
                places[:, axis] = edge
                rays = _rays(places, self.K(self.size) - HALF, np.array(self.distortion))
                ends.append(np.abs(rays[:, axis]).min())
            low, high = np.minimum(ends, np.tan(np.radians(WIDEST)))
            new[axis, axis] = last[axis] / (low + high)
            new[axis, 2] = low * new[axis, axis]
        return new


def _rays(pixels: Floats, K: Floats, distortion: Floats) -> Floats:
    """Return where a fisheye's pixels [N, 2] are in a straight image of focal length 1: [N, 2].

    Args:
        pixels: places in the fisheye's image.
        K: [3, 3] its intrinsics, in the same pixels.
        distortion: OpenCV's k1, k2, k3, k4.
    """
    angles = np.linspace(0.0, np.radians(STEEPEST), 4096)
    radii = angles * (1.0 + sum(k * angles ** (2 * power) for power, k in enumerate(distortion.tolist(), 1)))
    outermost = int(radii.argmax()) + 1  # beyond, coefficients describe no lens
    offsets = (pixels - K[:2, 2]) / K.diagonal()[:2]
    radius = np.linalg.norm(offsets, axis=1, keepdims=True)
    return offsets / np.maximum(radius, 1e-12) * np.tan(np.interp(radius, radii[:outermost], angles[:outermost]))
