"""Matches between the features of pairs of images, and which of them a camera in a place that stands still explains."""

from pathlib import Path
from typing import Any

from splatrl.capture.sfm.job import DATABASE, Job

PAIRS = "pairs.txt"


def match_pairs(pycolmap: Any, folder: Path, job: Job) -> None:
    """Match the pairs of images that a job's ``PAIRS`` names; what the database already holds is kept.

    Args:
        pycolmap: the module.
        folder: the job's folder.
        job: the job that the folder describes.
    """
    pairing = pycolmap.ImportedPairingOptions(block_size=50, match_list_path=str(folder / PAIRS))
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = job.seed
    options = pycolmap.FeatureMatchingOptions(num_threads=1)  # with two, one pair in a thousand varies between runs
    pycolmap.match_image_pairs(folder / DATABASE, options, pairing, verification, pycolmap.Device.cpu)
