"""Experiment trackers, which receive numbers during a training, and figures and videos at its end."""

import io
import math
import secrets
from collections.abc import Iterable, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol

from PIL import Image

from splatrl.extras import require
from splatrl.files import checked_name, replacing
from splatrl.values import flat

BACKENDS = ("csv", "tensorboard", "wandb")
MODULES = {"tensorboard": "torch.utils.tensorboard", "wandb": "wandb"}
"""What each backend imports, which the extra of its name installs."""
WIDEST, MOST_FRAMES = 480, 240
"""Maximum width and height, in pixels, and number of frames of a video in TensorBoard, which shows it as a GIF."""
PICTURES, VIDEOS = (".png", ".jpg"), (".mp4",)
RUN_ID = "wandb.txt"


class Tracker(Protocol):
    """A destination for a training's numbers, figures and videos, besides its run folder."""

    def scalars(self, values: Mapping[str, float], frames: int) -> None:
        """Log numbers at a frame count; values that are not finite are left out."""

    def files(self, paths: Iterable[Path], frames: int) -> None:
        """Log pictures and videos, given their files."""

    def close(self) -> None:
        """Write what has not been written yet."""


def make_tracker(
    backend: str,
    folder: Path,
    exp_name: str,
    project: str,
    online: bool,
    settings: Mapping[str, Any],
    frames: int = 0,
) -> Tracker | None:
    """Make the tracker that a config names; None for csv, which the run folder has anyway.

    Args:
        backend: one of ``BACKENDS``.
        folder: the run folder, which holds what the tracker writes.
        exp_name: name of the run.
        project: wandb project to which the run is added.
        online: whether wandb uploads the run while it goes on, rather than leaving that to ``wandb sync``.
        settings: the whole config as plain values, to be shown with the run.
        frames: frames from which the training goes on; what a killed process logged beyond them is replaced.

    Raises:
        ValueError: for any other backend, or a name that cannot be the name of a file.
        ImportError: if an extra is not installed; the message names it.
    """
    check_tracker(backend, exp_name)
    if backend == "csv":
        return None
    if backend == "tensorboard":
        return TensorBoardTracker(folder / exp_name, settings, frames)
    return WandbTracker(folder, exp_name, project, online, settings)


def check_tracker(backend: str, exp_name: str) -> None:
    """Check that a tracker can be made, without making it; see ``make_tracker``."""
    if backend not in BACKENDS:
        raise ValueError(f"logger.backend: expected one of {', '.join(BACKENDS)}, got {backend}")
    checked_name("logger.exp_name", exp_name)
    if backend in MODULES:
        require(MODULES[backend], backend, f"logger.backend={backend} needs {backend}")


class TensorBoardTracker:
    """Event files for ``tensorboard --logdir``.

    Args:
        folder: folder of the event files; a resumed training adds its own beside the first.
        settings: the config, shown as text.
        frames: frames from which the training goes on; TensorBoard hides what earlier files have beyond them.
    """

    def __init__(self, folder: Path, settings: Mapping[str, Any], frames: int):
        self._writer = import_module(MODULES["tensorboard"]).SummaryWriter(str(folder), purge_step=frames + 1)
        self._writer.add_text("config", "\n".join(f"    {key}: {value}" for key, value in flat(settings)))

    def scalars(self, values: Mapping[str, float], frames: int) -> None:
        """See ``Tracker``."""
        for key, value in _finite(values).items():
            self._writer.add_scalar(key, value, frames)

    def files(self, paths: Iterable[Path], frames: int) -> None:
        """See ``Tracker``."""
        from tensorboard.compat.proto.summary_pb2 import Summary

        for path in paths:
            if path.suffix in PICTURES:
                with Image.open(path) as picture:
                    (width, height), data = picture.size, path.read_bytes()
            elif path.suffix in VIDEOS:
                (width, height), data = gif(path)
            else:
                continue
            image = Summary.Image(height=height, width=width, colorspace=3, encoded_image_string=data)
            value = Summary.Value(tag=path.stem, image=image)
            self._writer.file_writer.add_summary(Summary(value=[value]), frames)

    def close(self) -> None:
        """See ``Tracker``."""
        self._writer.close()


class WandbTracker:
    """A run of Weights & Biases, in the folder ``wandb`` of the run folder.

    Args:
        folder: the run folder; a resumed training continues the wandb run that is noted in it.
        name: name of the run.
        project: project of the run.
        online: whether the run is uploaded while it goes on.
        settings: the config, shown with the run.
    """

    def __init__(self, folder: Path, name: str, project: str, online: bool, settings: Mapping[str, Any]):
        self._wandb = import_module(MODULES["wandb"])
        known = folder / RUN_ID
        identity = checked_name(RUN_ID, known.read_text().strip()) if known.is_file() else secrets.token_hex(8)
        with replacing(known) as stream:
            stream.write(identity.encode())
        self._run = self._wandb.init(
            project=project,
            name=name,
            id=identity,
            resume="allow",
            dir=str(folder),
            mode="online" if online else "offline",
            config=dict(settings),
            settings=self._wandb.Settings(console="off", silent=True, save_code=False, disable_git=True),
        )

    def scalars(self, values: Mapping[str, float], frames: int) -> None:
        """See ``Tracker``."""
        self._run.log(_finite(values), step=frames)

    def files(self, paths: Iterable[Path], frames: int) -> None:
        """See ``Tracker``."""
        media = {}
        for path in paths:
            if path.suffix in PICTURES:
                media[path.stem] = self._wandb.Image(str(path))
            elif path.suffix in VIDEOS:
                media[path.stem] = self._wandb.Video(str(path), format="mp4")
        self._run.log(media, step=frames)

    def close(self) -> None:
        """See ``Tracker``."""
        self._run.finish()


def gif(path: Path) -> tuple[tuple[int, int], bytes]:
    """Convert a video to an animated GIF, and return (width, height) in pixels and the file's bytes.

    Args:
        path: a video that this package wrote; frames beyond ``MOST_FRAMES`` are left out.
    """
    import av

    images: list[Image.Image] = []
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        pause = 1000.0 / float(stream.average_rate or 10)
        for frame in container.decode(stream):
            image = frame.to_image()
            image.thumbnail((WIDEST, WIDEST))
            images.append(image)
            if len(images) == MOST_FRAMES:
                break
    memory = io.BytesIO()
    images[0].save(memory, "GIF", save_all=True, append_images=images[1:], duration=pause, loop=0)
    return images[0].size, memory.getvalue()


def _finite(values: Mapping[str, float]) -> dict[str, float]:
    return {key: value for key, value in values.items() if math.isfinite(value)}
