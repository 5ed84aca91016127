"""The job of structure from motion, and the file by which it reaches its subprocess."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path

from splatrl.files import replacing

DATABASE, JOB = "database.db", "job.json"


@dataclass(frozen=True)
class Job:
    """Description of what to reconstruct.

    Attributes:
        images: folder of the images.
        names: file names of the images, in the order in which they were taken.
        width: width of every image, pixels.
        height: height of every image, pixels.
        K: [3][3] intrinsics, pixels; None where unknown.
        fixed: whether K is exact and the images are without lens distortion.
        camera_to_world: [N][4][4] known poses, which are not changed; None where they are still to be found.
        seed: seed of every random sample.
        seconds: [N] time at which each image of a film was taken, ascending; None for photos.
        cuts: times at which another take of the film begins.
        mask: image that is black where no features are sought; None to seek them everywhere.
        moving: folder with such an image for each of the images, whose name has ``.png`` after theirs; None without.
    """

    images: str
    names: list[str]
    width: int
    height: int
    K: list[list[float]] | None = None
    fixed: bool = False
    camera_to_world: list[list[list[float]]] | None = None
    seed: int = 0
    seconds: list[float] | None = None
    cuts: tuple[float, ...] = ()
    mask: str | None = None
    moving: str | None = None


def write_job(folder: Path, job: Job) -> None:
    """Write a job to the folder where its results are to appear."""
    with replacing(folder / JOB) as stream:
        stream.write(json.dumps(asdict(job)).encode())


def read_job(folder: Path) -> Job:
    """Read the job that ``write_job`` wrote to a folder."""
    return Job(**json.loads((folder / JOB).read_text("utf-8")))


def tell(what: str, done: int, total: int) -> None:
    """Report the progress of the subprocess to its parent, as a line of output."""
    print(json.dumps([what, done, total]), flush=True)
