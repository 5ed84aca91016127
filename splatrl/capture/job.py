"""What structure from motion has to do, and where its process finds that."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path

from splatrl.files import replacing

DATABASE, JOB = "database.db", "job.json"


@dataclass(frozen=True)
class Job:
    """What to reconstruct.

    Attributes:
        images: folder of the images.
        names: of the images, in the order in which they were taken.
        width: of every image, pixels.
        height: of every image, pixels.
        K: [3][3] intrinsics, pixels; None where unknown.
        fixed: whether K is exact and the images are without lens distortion.
        camera_to_world: [N][4][4] known poses, which stay as they are; None where they are to be found.
        seed: of every random sample.
        seconds: [N] when each image of a film was taken, ascending; None for photos.
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


def write_job(folder: Path, job: Job) -> None:
    """Describe a job in the folder where its results are to appear."""
    with replacing(folder / JOB) as stream:
        stream.write(json.dumps(asdict(job)).encode())


def read_job(folder: Path) -> Job:
    """The job that ``write_job`` described in a folder."""
    return Job(**json.loads((folder / JOB).read_text("utf-8")))


def tell(what: str, done: int, total: int) -> None:
    """Say how far the process is."""
    print(json.dumps([what, done, total]), flush=True)
