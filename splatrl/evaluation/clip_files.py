"""Labelled clips on disk, filmed or simulated; they are read as untrusted data and written atomically.

For each clip, a folder of clips holds either a sub-folder of photos (PNG, JPEG or WebP, in the order of their
numbers) with ``actions.csv``, or a video (``name.mp4`` or ``name.mov``) with ``name.csv`` beside it. The CSV has the
columns ``frame,action``, separated by commas, semicolons or tabs: frames count from 0, and actions are names, joined by
``|`` where any of several is correct. Frames that are not listed are shown to the policy but not scored.
"""

import csv
import io
import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from PIL import Image
from torch import Tensor

from splatrl.decoding import Damage, decoded
from splatrl.files import natural, new_folder
from splatrl.hdr import usual_range
from splatrl.images import PHOTO_SUFFIXES, displayed, open_video, pixel_aspect, read_photo

VIDEOS = (".mp4", ".mov")
ACTIONS = "actions.csv"
HEADER = ["frame", "action"]
SEPARATORS = ",;\t"
"""What may separate columns: spreadsheets write semicolons where the comma is the decimal sign."""
MAX_CSV_BYTES = 4 * 2**20


@dataclass(frozen=True)
class Clip:
    """A sequence of frames, some of which are labelled.

    Attributes:
        name: name of its folder or file.
        source: the folder of images, or the video file.
        table: the CSV file with the labels.
        labels: indices of the correct actions, by frame number.
        lines: line of the CSV that holds each label, by frame number.
    """

    name: str
    source: Path
    table: Path
    labels: Mapping[int, frozenset[int]]
    lines: Mapping[int, int]

    def images(self) -> Iterator[Image.Image]:
        """Yield the frames in order, RGB and upright.

        Raises:
            ValueError: for a frame that cannot be read or is too large, or a label beyond the last frame.
        """
        count = 0
        for image in film_images(self.source):
            yield image
            count += 1
        beyond = [frame for frame in self.labels if frame >= count]
        if beyond:
            place = f"{self.table}, line {self.lines[beyond[0]]}"
            raise ValueError(f"{place}: expected a frame number from 0 to {count - 1}, got {beyond[0]}")


def film_images(source: Path) -> Iterator[Image.Image]:
    """Iterate over the frames of a video, or the photos of a folder, in order, RGB and upright.

    Raises:
        ValueError: for a frame that cannot be read or is too large.
    """
    return map(read_photo, _listed(source)) if source.is_dir() else _video(source)


def read_clips(folder: Path, action_names: Sequence[str]) -> list[Clip]:
    """Find the clips in a folder and read their labels; frames are read only when they are needed.

    Args:
        folder: folder of clips.
        action_names: names of the task's actions, by index.

    Returns:
        The clips, ordered by name.

    Raises:
        ValueError: if there are no clips, a clip has no labels or images, or a label is invalid.
    """
    if not folder.is_dir():
        raise ValueError(f"{folder}: expected a folder of clips, found none")
    found = []
    for path in sorted(folder.iterdir(), key=natural):
        if path.name.startswith("."):
            continue
        if path.is_dir():
            if not _listed(path):
                raise ValueError(f"{path}: expected images ({', '.join(PHOTO_SUFFIXES)}), found none")
            found.append((path.name, path, path / ACTIONS))
        elif path.suffix.lower() in VIDEOS:
            found.append((path.stem, path, path.with_suffix(".csv")))
        elif path.suffix.lower() == ".csv" and not any(path.with_suffix(kind).is_file() for kind in VIDEOS):
            raise ValueError(f"{path}: expected a video of the same name ({', '.join(VIDEOS)}) next to it, found none")
    if not found:
        raise ValueError(f"{folder}: expected sub-folders of images or videos ({', '.join(VIDEOS)}), found none")
    return [Clip(name, source, table, *read_labels(table, action_names)) for name, source, table in found]


def read_labels(path: Path, action_names: Sequence[str]) -> tuple[dict[int, frozenset[int]], dict[int, int]]:
    """Read the labels of a clip from its CSV file.

    Args:
        path: the CSV file.
        action_names: names of the task's actions, by index.

    Returns:
        ``labels`` and ``lines``, as in ``Clip``.

    Raises:
        ValueError: for any invalid content; the message names file and line.
    """
    if not path.is_file():
        raise ValueError(f"{path}: expected a CSV file with the columns frame,action, found none")
    if path.stat().st_size > MAX_CSV_BYTES:
        raise ValueError(f"{path}: expected at most {MAX_CSV_BYTES:,} bytes, got {path.stat().st_size:,}")
    labels: dict[int, frozenset[int]] = {}
    lines: dict[int, int] = {}
    try:
        text = path.read_text("utf-8-sig")
        rows = csv.reader(io.StringIO(text, newline=""), delimiter=_separator(text))
        header = [cell.strip() for cell in next(rows, [])]
        if header != HEADER:
            raise ValueError(f"{path}, line 1: expected {','.join(HEADER)}, got {','.join(header)[:80]!r}")
        for row in rows:
            if not any(cell.strip() for cell in row):
                continue
            place = f"{path}, line {rows.line_num}"
            if len(row) != 2:
                raise ValueError(f"{place}: expected a frame number and an action, got {len(row)} cells")
            frame = _frame(row[0].strip(), place)
            if frame in labels:
                raise ValueError(f"{place}: expected each frame once, got {frame}, already on line {lines[frame]}")
            labels[frame], lines[frame] = _actions(row[1], action_names, place), rows.line_num
    except (UnicodeDecodeError, csv.Error) as error:
        raise ValueError(f"{path}: expected a CSV file in UTF-8, got one that cannot be read: {error}") from error
    if not labels:
        raise ValueError(f"{path}: expected at least one labelled frame, got none")
    return labels, lines


def _separator(text: str) -> str:
    """Return what separates the columns of a table, according to its header."""
    header, _, _ = text.partition("\n")
    return next((each for each in SEPARATORS if each in header), SEPARATORS[0])


def _frame(cell: str, place: str) -> int:
    if not re.fullmatch(r"[0-9]{1,9}", cell):
        raise ValueError(f"{place}: expected a frame number (0 or more), got {cell[:80]!r}")
    return int(cell)


def _actions(cell: str, action_names: Sequence[str], place: str) -> frozenset[int]:
    names = [name.strip() for name in cell.split("|")]
    for name in names:
        if name not in action_names:
            raise ValueError(f"{place}: expected one or more of {', '.join(action_names)}, got {name[:80]!r}")
    return frozenset(action_names.index(name) for name in names)


def _listed(folder: Path) -> list[Path]:
    files = (path for path in folder.iterdir() if not path.name.startswith("."))
    return sorted((path for path in files if path.suffix.lower() in PHOTO_SUFFIXES), key=natural)


def _video(path: Path) -> Iterator[Image.Image]:
    damage = Damage()
    with open_video(path) as container:
        aspect = pixel_aspect(container)
        for frame in decoded(path, container, damage):
            yield usual_range(displayed(frame, aspect), frame.color_trc)
    if said := _damaged(path, damage):
        warnings.warn(said, stacklevel=3)


def _damaged(path: Path, damage: Damage) -> str:
    """Return a warning that says how many frames of a video are lost or damaged; empty where none are.

    Corrupt frames are shown all the same, so that those after them keep their numbers.
    """
    said, corrupt = [], damage.corrupt
    if lost := damage.refused + damage.silent:
        said.append(f"{lost} of {damage.frames} frames cannot be decoded; labels after them may belong to other frames")
    if corrupt:
        said.append(f"{len(corrupt)} of {damage.frames} frames are damaged, the first at {corrupt[0]:.1f} s")
    if damage.missing:
        said.append(f"the film breaks off, and its last {damage.missing} frames are missing")
    return f"{path}: {'; '.join(said)}" if said else ""


def write_clip(folder: Path, images: Tensor, allowed: Tensor, action_names: Sequence[str]) -> None:
    """Write a clip atomically, as a folder of PNGs with ``actions.csv``.

    Args:
        folder: the clip's folder, whose parent exists.
        images: [T, H, W, 3] uint8.
        allowed: [T, A] bool, the correct actions; frames without any get no label.
        action_names: names of the A actions.

    Raises:
        ValueError: if a file or folder of that name exists.
    """
    assert len(images) == len(allowed), (images.shape, allowed.shape)
    table = io.StringIO(newline="")
    writer = csv.writer(table)
    writer.writerow(HEADER)
    for frame, row in enumerate(allowed.tolist()):
        names = [name for name, right in zip(action_names, row, strict=True) if right]
        if names:
            writer.writerow([frame, "|".join(names)])
    digits = max(3, len(str(len(images) - 1)))
    with new_folder(folder) as made:
        for number, image in enumerate(images.to("cpu", torch.uint8).numpy()):
            Image.fromarray(image).save(made / f"{number:0{digits}}.png")
        (made / ACTIONS).write_text(table.getvalue(), "utf-8", newline="")
