"""Reading and writing a folder of demonstrations: tensordict's memory-mapped files and a JSON file that describes them.

``memmap/`` has the format that ``TensorDict.load_memmap`` reads, so TorchRL's replay buffers can use it directly. This
module reads it without tensordict, whose loader would unpickle files from an untrusted source.
"""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDict
from torch import Tensor

from splatrl.datasets.demonstrations import AFTER, FASTEST, Demonstrations
from splatrl.documents import read_json, write_json
from splatrl.files import checked_name, require_room
from splatrl.values import require_number

FACTS, MEMMAP = "demonstrations.json", "memmap"
VERSION = 3
MAX_HEADER = 2**20
"""Maximum size of a JSON file in the folder, bytes."""
DTYPES = {str(kind): kind for kind in (torch.uint8, torch.int64, torch.float32, torch.float64, torch.bool)}
ROUNDED = 8192
"""Disk space to allow per file besides its contents, bytes: the rest of its last block, and its part of the headers."""
NEEDED = {"episode", "frame", "pixels", "action", "state", "next"}


def write_demonstrations(folder: Path, demonstrations: Demonstrations, facts: Mapping[str, Any] | None = None) -> None:
    """Write demonstrations into an existing folder.

    Args:
        folder: the folder to write to; create it with ``new_folder``, so that it appears complete or not at all.
        demonstrations: the demonstrations to write.
        facts: further entries for the JSON file that describes them; plain values.

    Raises:
        OSError: if the disk does not have enough space; names the folder.
    """
    frames = TensorDict(demonstrations.frames.to_dict(), [len(demonstrations)])
    require_room(folder, sum(values.nbytes + ROUNDED for values in frames.values(True, True)))
    frames.memmap(folder / MEMMAP)
    own = {
        "version": VERSION,
        "episodes": len(demonstrations.starts),
        "frames": len(demonstrations),
        "fps": demonstrations.fps,
        "repeats": demonstrations.repeats,
        "action_names": list(demonstrations.action_names),
        "scene": demonstrations.scene,
    }
    write_json(folder / FACTS, own | dict(facts or {}))


def read_demonstrations(folder: Path) -> Demonstrations:
    """Memory-map a folder of demonstrations, which may be untrusted: its files are read purely as data.

    Raises:
        FileNotFoundError: for a folder without demonstrations.
        ValueError: for files that are damaged or are not complete episodes in order; names the file.
    """
    path = folder / FACTS
    if not path.is_file():
        raise FileNotFoundError(f"{folder}: expected a folder of demonstrations with {FACTS}, found none")
    facts = read_json(path, MAX_HEADER)
    version = facts.get("version") if isinstance(facts, dict) else None
    if version != VERSION:
        raise ValueError(
            f"{path}: expected demonstrations of format version {VERSION}, got {version!r:.80}; record them again"
        )
    names = facts.get("action_names")
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise ValueError(f"{path}: expected a list of names under action_names, got {names!r:.80}")
    fps, repeats = facts.get("fps"), facts.get("repeats")
    for key, value, most in (("fps", fps, FASTEST), ("repeats", repeats, 1000)):
        require_number(f"{path}: {key}", value, 1, most, whole=True)
    scene = facts.get("scene")
    if not isinstance(scene, str | None):
        raise ValueError(f"{path}: expected a fingerprint under scene, got {scene!r:.80}")
    here = folder / MEMMAP
    values = _tensors(here, NEEDED)
    values["next"] = _tensors(here / "next", set(AFTER))
    shapes = {len(each) for each in [*values["next"].values(), *(v for k, v in values.items() if k != "next")]}
    if len(shapes) != 1 or not min(shapes):
        raise ValueError(f"{here}: expected the same number of frames for every key, at least 1, got {sorted(shapes)}")
    _check_kinds(here, values)
    optimal = values.get("optimal")
    if optimal is not None and (optimal.dtype, optimal.shape[1:]) != (torch.bool, (len(names),)):
        got = f"{optimal.dtype} {list(optimal.shape)}"
        raise ValueError(f"{here}: expected optimal as torch.bool [N, {len(names)}], got {got}")
    result = Demonstrations(TensorDict(values, [shapes.pop()]), tuple(names), fps, repeats, scene)
    try:
        result.check()
    except ValueError as error:
        raise ValueError(f"{here}: {error}") from error
    return result


def _tensors(folder: Path, needed: set[str]) -> dict[str, Any]:
    """Map the tensors of one level of a memory-mapped TensorDict, by name.

    Raises:
        ValueError: for a header that describes anything but plain tensors whose sizes match their files.
    """
    path = folder / "meta.json"
    header = read_json(path, MAX_HEADER)
    entries = (
        {key: value for key, value in header.items() if isinstance(value, dict)} if isinstance(header, dict) else {}
    )
    if missing := needed - entries.keys():
        raise ValueError(f"{path}: expected entries for {', '.join(sorted(missing))}, found none")
    return {
        key: _tensor(folder, checked_name(f"{path}: a key", key), entry, path)
        for key, entry in entries.items()
        if key != "next"
    }


def _tensor(folder: Path, key: str, entry: Mapping[str, Any], header: Path) -> Tensor:
    shape, dtype, path = entry.get("shape"), DTYPES.get(str(entry.get("dtype"))), folder / f"{key}.memmap"
    whole = isinstance(shape, list) and 1 <= len(shape) <= 8
    if not whole or not all(type(side) is int and side >= 1 for side in shape or ()) or dtype is None:
        known = ", ".join(DTYPES)
        raise ValueError(f"{header}: expected a shape and a dtype ({known}) for {key}, got {entry!r:.120}")
    assert shape is not None
    if not path.is_file():
        raise ValueError(f"{path}: expected a file, found none")
    count, size = math.prod(shape), path.stat().st_size
    if count * dtype.itemsize != size:
        raise ValueError(f"{path}: expected {count * dtype.itemsize:,} bytes, as stated in its header, got {size:,}")
    return torch.from_file(str(path), shared=False, size=count, dtype=dtype).reshape(shape)


def _check_kinds(folder: Path, values: Mapping[str, Any]) -> None:
    """Refuse tensors whose shapes or dtypes are not those of frames."""
    after = values["next"]
    flags = (after[name] for name in ("done", "terminated", "truncated", "success"))
    right = (
        values["pixels"].ndim == 4
        and values["pixels"].shape[-1] == 3
        and values["pixels"].dtype == torch.uint8
        and all(values[name].ndim == 1 and values[name].dtype == torch.int64 for name in ("episode", "frame"))
        and all(flag.shape[1:] == (1,) and flag.dtype == torch.bool for flag in flags)
        and (after["reward"].shape[1:], after["reward"].dtype) == ((1,), torch.float32)
        and (after["outcome"].shape[1:], after["outcome"].dtype) == ((1,), torch.int64)
        and (after["state"].shape, after["state"].dtype) == (values["state"].shape, values["state"].dtype)
    )
    if not right:
        raise ValueError(
            f"{folder}: expected the shapes and dtypes of frames (such as uint8 [N, H, W, 3] for pixels), got others"
        )
