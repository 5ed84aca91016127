"""Writing demonstrations in the LeRobotDataset v3.0 layout: Parquet tables, videos, and JSON metadata.

The layout is documented at https://huggingface.co/docs/lerobot/lerobot-dataset-v3. States, actions and sensor readings
are stored losslessly, and views are compressed as H.264. Each table and each video is a single file, whatever its size.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from PIL import Image
from torch import Tensor

from splatrl.datasets.demonstrations import Demonstrations
from splatrl.documents import write_json
from splatrl.evaluation.encoding import encode
from splatrl.extras import require

VIEW = "observation.images.front"
KNOWN = {"episode", "frame", "pixels", "state", "action", "optimal", "next"}
"""Frame keys that are written under LeRobot's own names, and ``optimal``, which has no counterpart there."""
DATA, EPISODES = "data/chunk-000/file-000.parquet", "meta/episodes/chunk-000/file-000.parquet"
VIDEO = "videos/{key}/chunk-000/file-000.mp4"
CHUNKS = "chunk-{chunk_index:03d}/file-{file_index:03d}"
KEYFRAMES = 2
"""Keyframe interval of the videos, frames; short, so that readers can seek to any frame quickly."""


def write_lerobot(
    folder: Path,
    demonstrations: Demonstrations,
    task: str,
    robot: str = "splatrl",
    controls: Sequence[str] = (),
) -> None:
    """Write demonstrations into an existing folder that ``LeRobotDataset(..., root=folder)`` can read.

    Features: ``observation.images.front``, ``observation.state``, ``action``, ``next.reward``, ``next.done`` and
    ``next.success``; and ``observation.<key>`` for everything else that is sensed or remembered. Three-channel images
    become videos, ``observation.images.<key>``. ``next.success`` is the env's ``success``: the goals so far are enough.

    Args:
        folder: the folder to write to; create it with ``new_folder``, so that it appears complete or not at all.
        demonstrations: the demonstrations to write.
        task: description of the task, in words.
        robot: kind of robot.
        controls: names of the numbers of a continuous action, ``Motion.controls``; empty if they have none.

    Raises:
        ImportError, ValueError: as ``check_lerobot`` does.
    """
    frames, fps = demonstrations.frames, demonstrations.fps
    height, width = frames["pixels"].shape[1:3]
    check_lerobot(width, height)
    import pyarrow
    from pyarrow import parquet

    columns, videos = _columns(demonstrations), _videos(demonstrations)
    tables = {
        DATA: pyarrow.table({key: _array(pyarrow, value) for key, value in columns.items()}),
        EPISODES: pyarrow.table(_episodes(demonstrations, task, columns, videos)),
        "meta/tasks.parquet": _tasks(pyarrow, task),
    }
    for name, table in tables.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        parquet.write_table(table, folder / name)
    write_json(folder / "meta/info.json", _info(demonstrations, columns, videos, robot, controls))
    write_json(folder / "meta/stats.json", _statistics(columns, videos))
    for key, pixels in videos.items():
        path = folder / VIDEO.format(key=key)
        path.parent.mkdir(parents=True)
        encode(_images(pixels), path, fps, {"g": str(KEYFRAMES)})


def check_lerobot(width: int, height: int) -> None:
    """Refuse what cannot be written, before anything is recorded.

    Args:
        width: width of the views, pixels.
        height: height of the views, pixels.

    Raises:
        ImportError: if the extra ``lerobot`` is not installed.
        ValueError: for an odd width or height, which the video format does not support.
    """
    require("pyarrow", "lerobot", "the LeRobot format needs pyarrow")
    if height % 2 or width % 2:
        raise ValueError(f"robot.image_width, robot.image_height: expected even numbers, got {width} and {height}")


def _is_image(values: Tensor) -> bool:
    return values.ndim == 4 and values.shape[-1] == 3 and values.dtype == torch.uint8


def _videos(demonstrations: Demonstrations) -> dict[str, Tensor]:
    """Return the robot's views and other images that it observes: [N, H, W, 3] uint8 by feature."""
    frames = demonstrations.frames
    others = [key for key in sorted(frames.keys() - KNOWN) if _is_image(frames[key])]
    return {VIEW: frames["pixels"]} | {f"observation.images.{key}": frames[key] for key in others}


def _columns(demonstrations: Demonstrations) -> dict[str, Tensor]:
    """Return the columns of the frame table: [N] for single numbers, otherwise [N, ...]."""
    frames, count = demonstrations.frames, len(demonstrations)
    after = frames["next"]
    others = {key: frames[key] for key in sorted(frames.keys() - KNOWN) if not _is_image(frames[key])}
    return {
        "observation.state": frames["state"].reshape(count, -1),
        "action": frames["action"],
        **{f"observation.{key}": value.squeeze(1) if value[0].numel() == 1 else value for key, value in others.items()},
        "next.reward": after["reward"].squeeze(1),
        "next.done": after["done"].squeeze(1),
        "next.success": after["success"].squeeze(1),
        "timestamp": frames["frame"].float() / demonstrations.fps,
        "frame_index": frames["frame"],
        "episode_index": frames["episode"],
        "index": torch.arange(count),
        "task_index": torch.zeros(count, dtype=torch.int64),
    }


def _array(pyarrow: Any, values: Tensor) -> Any:
    """Convert values to a column; rows of several numbers become fixed-size lists, nested for several axes."""
    result = pyarrow.array(values.reshape(-1).numpy())
    for side in reversed(values.shape[1:]):
        result = pyarrow.FixedSizeListArray.from_arrays(result, side)
    return result


def _episodes(
    demonstrations: Demonstrations, task: str, columns: Mapping[str, Tensor], videos: Mapping[str, Tensor]
) -> dict[str, Any]:
    """Return the columns of the episode table: each episode's place in tables and videos, and its statistics."""
    starts, lengths = demonstrations.starts, demonstrations.lengths
    ends, zeros = starts + lengths, [0] * len(starts)
    begin, end = ((at.double() / demonstrations.fps).tolist() for at in (starts, ends))
    filmed = {
        f"videos/{key}/{name}": values
        for key in videos
        for name, values in (
            ("chunk_index", zeros),
            ("file_index", zeros),
            ("from_timestamp", begin),
            ("to_timestamp", end),
        )
    }
    found = [
        _statistics(*({key: values[first:last] for key, values in each.items()} for each in (columns, videos)))
        for first, last in zip(starts.tolist(), ends.tolist(), strict=True)
    ]
    return {
        "episode_index": list(range(len(starts))),
        "tasks": [[task]] * len(starts),
        "length": lengths.tolist(),
        "data/chunk_index": zeros,
        "data/file_index": zeros,
        "dataset_from_index": starts.tolist(),
        "dataset_to_index": ends.tolist(),
        **filmed,
        "meta/episodes/chunk_index": zeros,
        "meta/episodes/file_index": zeros,
        **{f"stats/{key}/{name}": [each[key][name] for each in found] for key in found[0] for name in found[0][key]},
    }


def _tasks(pyarrow: Any, task: str) -> Any:
    """Return the task table, whose task descriptions are the index of a pandas data frame."""
    index = "__index_level_0__"
    columns: list[dict[str, Any]] = [
        {"name": "task_index", "field_name": "task_index", "pandas_type": "int64", "numpy_type": "int64"},
        {"name": None, "field_name": index, "pandas_type": "unicode", "numpy_type": "object"},
    ]
    pandas = {
        "index_columns": [index],
        "column_indexes": [],
        "columns": [{**column, "metadata": None} for column in columns],
    }
    table = pyarrow.table({"task_index": [0], index: [task]})
    return table.replace_schema_metadata({"pandas": json.dumps(pandas)})


def _info(
    demonstrations: Demonstrations,
    columns: Mapping[str, Tensor],
    videos: Mapping[str, Tensor],
    robot: str,
    controls: Sequence[str],
) -> dict[str, Any]:
    features: dict[str, Any] = {
        key: {"dtype": str(value.dtype).removeprefix("torch."), "shape": list(value.shape[1:] or [1]), "names": None}
        for key, value in columns.items()
    }
    features["action"]["names"] = list(controls) or None
    for key, pixels in videos.items():
        height, width = pixels.shape[1:3]
        features[key] = {
            "dtype": "video",
            "shape": [height, width, 3],
            "names": ["height", "width", "channels"],
            "info": {
                "video.height": height,
                "video.width": width,
                "video.channels": 3,
                "video.codec": "h264",
                "video.pix_fmt": "yuv420p",
                "video.is_depth_map": False,
                "video.fps": demonstrations.fps,
                "has_audio": False,
            },
        }
    return {
        "codebase_version": "v3.0",
        "robot_type": robot,
        "total_episodes": len(demonstrations.starts),
        "total_frames": len(demonstrations),
        "total_tasks": 1,
        "chunks_size": 1000,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": demonstrations.fps,
        "splits": {"train": f"0:{len(demonstrations.starts)}"},
        "data_path": f"data/{CHUNKS}.parquet",
        "video_path": f"videos/{{video_key}}/{CHUNKS}.mp4",
        "features": features,
        "action_names": list(demonstrations.action_names),
    }


def _statistics(columns: Mapping[str, Tensor], videos: Mapping[str, Tensor]) -> dict[str, Any]:
    """Return min, max, mean, standard deviation and count of each feature; views in [0, 1], per channel: [3, 1, 1]."""
    result: dict[str, Any] = {}
    for key, value in columns.items():
        rows = value.double().reshape(len(value), *(value.shape[1:] or [1]))
        found = {"min": rows.amin(0), "max": rows.amax(0), "mean": rows.mean(0), "std": rows.std(0, correction=0)}
        result[key] = {name: numbers.tolist() for name, numbers in found.items()} | {"count": [len(value)]}
    return result | {key: _colors(pixels) for key, pixels in videos.items()}


def _colors(pixels: Tensor) -> dict[str, Any]:
    """Return the statistics of a video [N, H, W, 3], per channel."""
    colors = torch.zeros(4, 3, dtype=torch.float64)  # sum, sum of squares, min and max, updated per image
    colors[2] = 255.0
    for image in pixels:
        points = image.reshape(-1, 3).double()
        colors[0] += points.mean(0)
        colors[1] += points.square().mean(0)
        colors[2:] = torch.stack([torch.minimum(colors[2], points.amin(0)), torch.maximum(colors[3], points.amax(0))])
    mean = colors[0] / len(pixels)
    std = (colors[1] / len(pixels) - mean.square()).clamp_min(0).sqrt()
    named = {"min": colors[2], "max": colors[3], "mean": mean, "std": std}
    result = {name: (numbers / 255.0).reshape(3, 1, 1).tolist() for name, numbers in named.items()}
    return result | {"count": [len(pixels)]}


def _images(pixels: Tensor) -> Iterator[Image.Image]:
    for view in pixels:
        yield Image.fromarray(view.numpy())
