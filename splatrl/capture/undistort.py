"""Removal of lens distortion from images."""

import json
import shutil
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from splatrl.capture.progress import Progress, silent
from splatrl.extras import require
from splatrl.files import new_folder

SETTINGS = "camera.json"


def undistorted(
    paths: list[Path],
    size: tuple[int, int],
    K: Tensor,
    distortion: np.ndarray,
    made: Path,
    progress: Progress = silent,
) -> tuple[list[Path], Tensor]:
    """Remove the lens distortion of images, so that a pinhole camera explains them, without black edges.

    Args:
        paths: the image files, all of one size.
        size: width and height, pixels.
        K: [3, 3] float64 intrinsics, pixels, with the centre of the first pixel at (0.5, 0.5).
        distortion: OpenCV's k1, k2, p1, p2 (and more).
        made: the folder for the new images, which appears whole or not at all; one that an earlier call made from the
            same files with the same camera is kept.
        progress: called for every image.

    Returns:
        Paths of the new images, of the same size and in the same order, and their K [3, 3] float64; the given ones
        where there is no distortion.
    """
    cv2 = require("cv2", "capture")
    if not np.any(distortion):
        return paths, K
    half = np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])  # OpenCV has the centre of the first pixel at 0
    given = K.numpy() - half
    new, _ = cv2.getOptimalNewCameraMatrix(given, distortion, size, 0, size)
    names = [f"{path.stem}.jpg" for path in paths]
    stamps = [[path.name, path.stat().st_size, path.stat().st_mtime_ns] for path in paths]
    settings = json.dumps([stamps, size, K.tolist(), list(distortion)])
    if not (made / SETTINGS).is_file() or (made / SETTINGS).read_text("utf-8") != settings:
        if (made / SETTINGS).is_file():
            shutil.rmtree(made)
        made.parent.mkdir(parents=True, exist_ok=True)
        maps = cv2.initUndistortRectifyMap(given, distortion, None, new, size, cv2.CV_16SC2)
        with new_folder(made) as temporary:
            for number, (path, name) in enumerate(zip(paths, names, strict=True)):
                progress("undistort", number, len(paths))
                image = cv2.remap(cv2.imread(str(path)), *maps, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
                if not cv2.imwrite(str(temporary / name), image, [cv2.IMWRITE_JPEG_QUALITY, 95]):
                    raise OSError(f"{made / name}: cannot write the undistorted image")
            (temporary / SETTINGS).write_text(settings, "utf-8")
        progress("undistort", len(paths), len(paths))
    return [made / name for name in names], torch.from_numpy(new + half)
