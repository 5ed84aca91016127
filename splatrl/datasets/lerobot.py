"""Demonstrations in the layout of LeRobotDataset v3.0: parquet, one video, and JSON about them.

The layout is documented at https://huggingface.co/docs/lerobot/lerobot-dataset-v3. States and actions keep their bytes,
and views are compressed as H.264. Tables and video have one file each, whatever their size.
"""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import torch
from PIL import Image
from torch import Tensor

from splatrl.datasets.demonstrations import Demonstrations
from splatrl.envs.tasks.base import Outcome
from splatrl.evaluation.report import write_json
from splatrl.evaluation.video import encode

VIEW = "observation.images.front"
DATA, EPISODES = "data/chunk-000/file-000.parquet", "meta/episodes/chunk-000/file-000.parquet"
VIDEO = f"videos/{VIEW}/chunk-000/file-000.mp4"
CHUNKS = "chunk-{chunk_index:03d}/file-{file_index:03d}"
KEYFRAMES = 2
"""Frames from one that stands alone to the next, so that readers find any frame quickly."""
_MISSING = "LeRobot's layout needs pyarrow: pip install 'splatrl[lerobot]'"


def write_lerobot(folder: Path, demonstrations: Demonstrations, task: str, robot: str = "splatrl") -> None:
    """Write demonstrations into an existing folder, which ``LeRobotDataset(..., root=folder)`` reads.

    Features: ``observation.images.front``, ``observation.state``, ``action``, ``next.reward``, ``next.done`` and
    ``next.success``.

    Args:
        folder: to write to; make it with ``new_folder``, so that it appears whole or not at all.
        demonstrations: what to write.
        task: what is done, in words.
        robot: kind of robot.

    Raises:
        ImportError: without the extra ``lerobot``.
        ValueError: for images with odd sides, which the video's format does not have.
    """
    try:
        import pyarrow
        from pyarrow import parquet
    except ImportError as error:
        raise ImportError(_MISSING) from error
    frames, fps = demonstrations.frames, demonstrations.fps
    height, width = frames["pixels"].shape[1:3]
    if height % 2 or width % 2:
        raise ValueError(f"robot.image_width, robot.image_height: expected even numbers, got {width} and {height}")
    columns = _columns(demonstrations)
    tables = {
        DATA: pyarrow.table({key: _array(pyarrow, value) for key, value in columns.items()}),
        EPISODES: pyarrow.table(_episodes(demonstrations, task)),
        "meta/tasks.parquet": _tasks(pyarrow, task),
    }
    for name, table in tables.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        parquet.write_table(table, folder / name)
    write_json(folder / "meta/info.json", _info(demonstrations, columns, robot))
    write_json(folder / "meta/stats.json", _statistics(columns, frames["pixels"]))
    (folder / VIDEO).parent.mkdir(parents=True)
    encode(_images(frames["pixels"]), folder / VIDEO, fps, {"g": str(KEYFRAMES)})


def _columns(demonstrations: Demonstrations) -> dict[str, Tensor]:
    """The columns of the table of frames: [N] or [N, D]."""
    frames, count = demonstrations.frames, len(demonstrations)
    after = frames["next"]
    return {
        "observation.state": frames["state"].reshape(count, -1),
        "action": frames["action"],
        "next.reward": after["reward"].squeeze(1),
        "next.done": after["done"].squeeze(1),
        "next.success": (after["outcome"] == Outcome.GOAL).squeeze(1),
        "timestamp": frames["frame"].float() / demonstrations.fps,
        "frame_index": frames["frame"],
        "episode_index": frames["episode"],
        "index": torch.arange(count),
        "task_index": torch.zeros(count, dtype=torch.int64),
    }


def _array(pyarrow: Any, values: Tensor) -> Any:
    """A column; rows of several numbers are lists of that length."""
    flat = pyarrow.array(values.reshape(-1).numpy())
    return flat if values.ndim == 1 else pyarrow.FixedSizeListArray.from_arrays(flat, values.shape[1])


def _episodes(demonstrations: Demonstrations, task: str) -> dict[str, Any]:
    """Columns of the table of episodes: where each is in tables and video."""
    starts, lengths = demonstrations.starts, demonstrations.lengths
    ends, zeros = starts + lengths, [0] * len(starts)
    return {
        "episode_index": list(range(len(starts))),
        "tasks": [[task]] * len(starts),
        "length": lengths.tolist(),
        "data/chunk_index": zeros,
        "data/file_index": zeros,
        "dataset_from_index": starts.tolist(),
        "dataset_to_index": ends.tolist(),
        f"videos/{VIEW}/chunk_index": zeros,
        f"videos/{VIEW}/file_index": zeros,
        f"videos/{VIEW}/from_timestamp": (starts.double() / demonstrations.fps).tolist(),
        f"videos/{VIEW}/to_timestamp": (ends.double() / demonstrations.fps).tolist(),
        "meta/episodes/chunk_index": zeros,
        "meta/episodes/file_index": zeros,
    }


def _tasks(pyarrow: Any, task: str) -> Any:
    """The table of tasks, whose words are the index of a pandas data frame."""
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


def _info(demonstrations: Demonstrations, columns: Mapping[str, Tensor], robot: str) -> dict[str, Any]:
    height, width = demonstrations.frames["pixels"].shape[1:3]
    features: dict[str, Any] = {
        key: {"dtype": str(value.dtype).removeprefix("torch."), "shape": list(value.shape[1:] or [1]), "names": None}
        for key, value in columns.items()
    }
    features[VIEW] = {
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


def _statistics(columns: Mapping[str, Tensor], pixels: Tensor) -> dict[str, Any]:
    """Least, largest, mean, standard deviation and number of each feature; views in [0, 1], by channel: [3, 1, 1]."""
    result: dict[str, Any] = {}
    for key, value in columns.items():
        rows = value.double().reshape(len(value), -1)
        found = {"min": rows.amin(0), "max": rows.amax(0), "mean": rows.mean(0), "std": rows.std(0, correction=0)}
        result[key] = {name: numbers.tolist() for name, numbers in found.items()} | {"count": [len(value)]}
    colors = torch.zeros(4, 3, dtype=torch.float64)  # sums of values and squares, one image at a time
    colors[2] = 255.0
    for image in pixels:
        points = image.reshape(-1, 3).double()
        colors[0] += points.mean(0)
        colors[1] += points.square().mean(0)
        colors[2:] = torch.stack([torch.minimum(colors[2], points.amin(0)), torch.maximum(colors[3], points.amax(0))])
    mean = colors[0] / len(pixels)
    std = (colors[1] / len(pixels) - mean.square()).clamp_min(0).sqrt()
    named = {"min": colors[2], "max": colors[3], "mean": mean, "std": std}
    result[VIEW] = {name: (numbers / 255.0).reshape(3, 1, 1).tolist() for name, numbers in named.items()}
    result[VIEW]["count"] = [len(pixels)]
    return result


def _images(pixels: Tensor) -> Iterator[Image.Image]:
    for view in pixels:
        yield Image.fromarray(view.numpy())
