"""Demonstrations in LeRobot's format: the contents of the tables, the video and the JSON files."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from splatrl.building import build_world
from splatrl.configuration import load_config
from splatrl.datasets import Demonstrations, planner_episodes, write_lerobot
from splatrl.envs.tasks import Outcome
from splatrl.images import open_video
from tests.tiny import tiny_overrides

parquet = pytest.importorskip("pyarrow.parquet", reason="needs the extra lerobot")

KEY = "observation.images.front"


SENSING = ["sensors=[rgb,depth,gps,compass,contact,lidar]", "sensors.lidar.beams=5"]
RECORDED = {"plain": ("grid", []), "continuous": ("drive", ["task.motion.spacing=0.5"]), "sensing": ("grid", SENSING)}


@pytest.fixture(scope="module", params=list(RECORDED))
def shown(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Demonstrations:
    task, more = RECORDED[request.param]
    return planner_episodes(
        build_world(load_config([*tiny_overrides(tmp_path_factory.mktemp("room"), task), *more])), 9
    )


def controls(shown: Demonstrations) -> list[str]:
    """Return the names of the numbers of a continuous action."""
    return ["forward (m/s)", "turn (rad/s)"] if shown.frames["action"].is_floating_point() else []


@pytest.fixture(scope="module")
def folder(shown: Demonstrations, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("lerobot")
    write_lerobot(path, shown, "Grid in room", controls=controls(shown))
    return path


def info(folder: Path) -> dict[str, Any]:
    return json.loads((folder / "meta" / "info.json").read_text())


def table(folder: Path, pattern: str) -> Any:
    """Read the table at a path pattern, which ``info.json`` names or LeRobot defines."""
    return parquet.read_table(folder / pattern.format(chunk_index=0, file_index=0))


def sensed(shown: Demonstrations) -> dict[str, torch.Tensor]:
    """Return the sensor readings other than the view."""
    return {key: shown.frames[key] for key in ("depth", "gps", "compass", "contact", "lidar") if key in shown.frames}


def test_tables_hold_the_bytes_of_states_and_actions(shown: Demonstrations, folder: Path) -> None:
    found = table(folder, info(folder)["data_path"])
    for key, expected in (
        ("action", shown.frames["action"]),
        ("observation.state", shown.frames["state"]),
        ("next.reward", shown.frames["next", "reward"].squeeze(1)),
        ("next.done", shown.frames["next", "done"].squeeze(1)),
        ("episode_index", shown.frames["episode"]),
        ("frame_index", shown.frames["frame"]),
        *((f"observation.{key}", values) for key, values in sensed(shown).items()),
    ):
        values = np.array(found[key].to_pylist(), expected.numpy().dtype)
        assert values.tobytes() == expected.contiguous().numpy().tobytes(), key
    assert found["index"].to_pylist() == list(range(len(shown)))
    assert np.allclose(found["timestamp"].to_numpy(), shown.frames["frame"] / shown.fps)
    success = np.array(found["next.success"].to_pylist())
    assert success.sum() == 9 and np.array_equal(success, found["next.done"].to_numpy())


def test_success_is_what_the_env_calls_success(shown: Demonstrations, tmp_path: Path) -> None:
    frames = shown.frames.clone()  # a task that goes on after its goals, of which the first is not enough
    frames["next", "outcome"] = torch.full_like(frames["next", "outcome"], Outcome.GOAL)
    frames["next", "success"] = frames["frame"].unsqueeze(1) > 0
    write_lerobot(tmp_path, Demonstrations(frames, shown.action_names), "x")
    found = table(tmp_path, info(tmp_path)["data_path"])["next.success"].to_pylist()
    assert found == frames["next", "success"].flatten().tolist() and any(found) and not all(found)


def test_each_sensor_is_a_feature(shown: Demonstrations, folder: Path) -> None:
    features = info(folder)["features"]
    for key, values in sensed(shown).items():
        feature = features[f"observation.{key}"]
        dtype = str(values.dtype).removeprefix("torch.")
        assert (feature["dtype"], feature["shape"]) == (dtype, list(values.shape[1:] or [1]))


def test_images_from_a_sensor_become_a_video(shown: Demonstrations, tmp_path: Path) -> None:
    frames = shown.frames.clone()
    frames["imagegoal"] = frames["pixels"].flip(2)
    write_lerobot(tmp_path, Demonstrations(frames, shown.action_names), "x")
    feature = info(tmp_path)["features"]["observation.images.imagegoal"]
    assert (feature["dtype"], feature["shape"]) == ("video", [12, 16, 3])
    path = tmp_path / info(tmp_path)["video_path"].format(
        video_key="observation.images.imagegoal", chunk_index=0, file_index=0
    )
    with open_video(path) as video:
        views = np.stack([image.to_ndarray(format="rgb24") for image in video.decode(video=0)])
    assert len(views) == len(shown)
    error = np.square(views - frames["imagegoal"].numpy().astype(float)).mean()
    assert -10 * np.log10(error / 255**2) > 25, "the loss of the codec"
    episodes = table(tmp_path, "meta/episodes/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet")
    for name in ("from_timestamp", "to_timestamp", "chunk_index", "file_index"):
        assert episodes[f"videos/observation.images.imagegoal/{name}"] == episodes[f"videos/{KEY}/{name}"]


def test_features_describe_the_columns(shown: Demonstrations, folder: Path) -> None:
    facts = info(folder)
    assert (facts["codebase_version"], facts["total_episodes"], facts["total_frames"]) == ("v3.0", 9, len(shown))
    found = table(folder, facts["data_path"])
    assert {KEY, *found.column_names} == facts["features"].keys() == {*json_keys(folder)}
    for key in found.column_names:
        feature = facts["features"][key]
        assert feature["names"] == (controls(shown) or None if key == "action" else None)
        first = np.atleast_1d(found[key][0].as_py())
        assert feature["shape"] == list(first.shape)
        kind = found.schema.field(key).type
        while hasattr(kind, "value_type"):
            kind = kind.value_type
        named = str(kind).replace("float", "float32").replace("double", "float64")
        assert feature["dtype"] == named


def json_keys(folder: Path) -> list[str]:
    return list(json.loads((folder / "meta" / "stats.json").read_text()))


def test_each_episode_is_found_in_tables_and_video(shown: Demonstrations, folder: Path) -> None:
    facts = info(folder)
    episodes = table(folder, "meta/episodes/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet").to_pylist()
    path = folder / facts["video_path"].format(video_key=KEY, chunk_index=0, file_index=0)
    with open_video(path) as video:
        stream = video.streams.video[0]
        assert stream.average_rate == facts["fps"] == shown.fps
        views = [(float(image.time), image.to_ndarray(format="rgb24")) for image in video.decode(stream)]
    assert len(views) == len(shown)
    for number, episode in enumerate(episodes):
        begin, end = episode["dataset_from_index"], episode["dataset_to_index"]
        assert episode["episode_index"] == number and episode["length"] == end - begin == int(shown.lengths[number])
        assert episode["tasks"] == ["Grid in room"] and begin == int(shown.starts[number])
        assert episode[f"videos/{KEY}/to_timestamp"] == pytest.approx(end / shown.fps)
        for row in range(begin, end):
            at = episode[f"videos/{KEY}/from_timestamp"] + float(shown.frames["frame"][row]) / shown.fps
            time, view = min(views, key=lambda each: abs(each[0] - at))
            assert time == pytest.approx(at, abs=1e-4)
            error = np.square(view - shown.frames["pixels"][row].numpy().astype(float)).mean()
            assert -10 * np.log10(error / 255**2) > 25, "the loss of the codec"


def test_statistics_match_the_frames(shown: Demonstrations, folder: Path) -> None:
    found = json.loads((folder / "meta" / "stats.json").read_text())
    state, pixels = shown.frames["state"].double(), shown.frames["pixels"].double() / 255
    for name, value in (("mean", state.mean(0)), ("std", state.std(0, correction=0)), ("max", state.amax(0))):
        assert found["observation.state"][name] == pytest.approx(value.tolist())
    flat = pixels.reshape(-1, 3)
    for name, value in (("mean", flat.mean(0)), ("std", flat.std(0, correction=0)), ("min", flat.amin(0))):
        assert np.array(found[KEY][name]).shape == (3, 1, 1)
        assert np.ravel(found[KEY][name]) == pytest.approx(value.numpy(), abs=1e-9)
    assert all(each["count"] == [len(shown)] for each in found.values())


def test_each_episode_has_its_own_statistics(shown: Demonstrations, folder: Path) -> None:
    found = table(folder, "meta/episodes/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet").to_pylist()
    all_frames = json.loads((folder / "meta" / "stats.json").read_text())
    named = {f"stats/{key}/{name}" for key, each in all_frames.items() for name in each}
    for row, first, length in zip(found, shown.starts.tolist(), shown.lengths.tolist(), strict=True):
        assert {key for key in row if key.startswith("stats/")} == named
        state, pixels = (shown.frames[key][first : first + length].double() for key in ("state", "pixels"))
        assert row["stats/observation.state/mean"] == pytest.approx(state.mean(0).tolist())
        assert row["stats/observation.state/std"] == pytest.approx(state.std(0, correction=0).tolist())
        assert np.array(row[f"stats/{KEY}/max"]).shape == (3, 1, 1)
        assert np.ravel(row[f"stats/{KEY}/max"]) == pytest.approx(pixels.reshape(-1, 3).amax(0).numpy() / 255)
        assert row["stats/action/count"] == row[f"stats/{KEY}/count"] == [length]


def test_tasks_are_indexed_by_their_description(folder: Path) -> None:
    found = parquet.read_table(folder / "meta" / "tasks.parquet")
    assert found["task_index"].to_pylist() == [0]
    (index,) = json.loads(found.schema.metadata[b"pandas"])["index_columns"]
    assert found[index].to_pylist() == ["Grid in room"]


def test_images_with_odd_sides_are_refused(shown: Demonstrations, tmp_path: Path) -> None:
    frames = shown.frames.clone()
    frames["pixels"] = torch.zeros(len(frames), 11, 16, 3, dtype=torch.uint8)
    with pytest.raises(ValueError, match="expected even numbers, got 16 and 11"):
        write_lerobot(tmp_path, Demonstrations(frames, shown.action_names), "x")
    assert not list(tmp_path.iterdir())
