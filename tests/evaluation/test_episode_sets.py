"""Files of navigation episodes are written, read back, and refused with a one-line error where they are wrong."""

import gzip
import json
import math
from pathlib import Path
from typing import Any

import pytest
import torch

from splatrl.evaluation import episode_sets
from splatrl.evaluation.episode_sets import from_habitat, read_episodes, to_habitat, write_episodes

STATE = torch.tensor([[1.0, 2.0, 0.5], [-0.5, 0.25, 3.0]])
MEMORY = {
    "goal": torch.tensor([[3.0, -1.0, 0.25], [0.0, 1.5, 4.0]]),
    "start_distance": torch.tensor([[4.5], [2.0]]),
}


def written(folder: Path) -> Path:
    path = folder / "episodes.json.gz"
    write_episodes(path, STATE, MEMORY, ["yard", "kitchen"], torch.tensor([0.4, 1.05]), 0.2)
    return path


def content(path: Path) -> Any:
    return json.loads(gzip.decompress(path.read_bytes()))


def test_a_file_has_habitats_fields_in_habitats_frame(tmp_path: Path) -> None:
    first = content(written(tmp_path))["episodes"][0]
    assert first["episode_id"] == "0" and first["scene_id"] == "yard"
    assert first["start_position"] == pytest.approx([-2.0, 0.4, -1.0])  # in our frame, ahead is x and left is y
    assert first["start_rotation"] == pytest.approx([0.0, math.sin(0.25), 0.0, math.cos(0.25)])
    assert first["goals"] == [{"position": pytest.approx([1.0, 0.4, -3.0]), "radius": 0.2}]
    assert first["info"]["geodesic_distance"] == pytest.approx(4.5)


def test_a_start_and_its_goal_are_at_the_height_of_the_robot_in_their_scene(tmp_path: Path) -> None:
    for height, row in zip((0.4, 1.05), content(written(tmp_path))["episodes"], strict=True):
        assert row["start_position"][1] == row["goals"][0]["position"][1] == pytest.approx(height)


def test_episodes_are_read_back_as_written_and_their_file_is_reproducible(tmp_path: Path) -> None:
    path = written(tmp_path)
    state, goal, scene = read_episodes(path, ["kitchen", "yard"])
    torch.testing.assert_close(state, STATE)
    torch.testing.assert_close(goal, MEMORY["goal"])
    assert scene.tolist() == [1, 0]
    (tmp_path / "again").mkdir()
    assert path.read_bytes() == written(tmp_path / "again").read_bytes()


def test_goals_without_a_yaw_face_in_a_direction_that_the_episodes_name_alone_decides(tmp_path: Path) -> None:
    rows = content(written(tmp_path))["episodes"]
    many = [{**rows[0], "episode_id": str(number), "info": {}} for number in range(200)]
    path = tmp_path / "others.json.gz"

    def yaws(episodes: list[Any]) -> torch.Tensor:
        path.write_bytes(gzip.compress(json.dumps({"episodes": episodes}).encode()))
        return read_episodes(path, ["kitchen", "yard"])[1][:, 2]

    found = yaws(many)
    assert torch.equal(yaws(many[::-1]), found.flip(0))
    assert (torch.histc(found, 8, 0.0, math.tau) > 10).all()  # 25 in each eighth of a turn, were they spread evenly


def test_the_conversions_to_and_from_habitats_frame_are_inverses() -> None:
    places = torch.randn(10, 3, generator=torch.Generator().manual_seed(0))
    assert torch.equal(from_habitat(to_habitat(places)), places)
    assert torch.equal(to_habitat(torch.eye(3)), torch.tensor([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]))


@pytest.mark.parametrize(
    ("key", "value", "match"),
    [
        ("scene_id", "moon", "episode 0: expected scene_id to be yard or kitchen, got 'moon'"),
        ("scene_id", ["x"], "scene_id"),
        ("start_position", [0.0, 1.0], r"episode 0\.start_position: expected 3 numbers, got \[0\.0, 1\.0\]"),
        ("start_position", [0.0, 1.0, math.nan], r"start_position"),
        ("start_position", [0.0, 1.0, 1e30], r"start_position: expected finite numbers .*, got \[0\.0, 1\.0, 1e\+30\]"),
        ("start_position", ["0", 1.0, 2.0], r"start_position: expected 3 numbers, got \['0', 1\.0, 2\.0\]"),
        ("start_position", ["0" * 999], r"start_position: expected 3 numbers, got \['0{78}$"),
        ("start_rotation", [1.0, 0.0, 0.0, 0.0], r"quaternion about the y axis, got \[1\.0, 0\.0, 0\.0, 0\.0\]"),
        ("start_rotation", [0.0, 0.0, 0.0, 0.0], r"start_rotation"),
        ("goals", [], r"expected a list of goals, .*, got \[\] and {'geodesic"),
        ("goals", [{"position": None}], r"goals\[0\]\.position: expected 3 numbers, got None"),
        ("goals", [{"position": [0.0, 0.4, 0.0]}] * 2, r"episode 0\.goals: expected one goal, got 2$"),
        (
            "start_position",
            [1.3, -1.7, 0.4],
            "within 1 m of the same height y, got -1.7 and 0.4",
        ),
        ("info", {"goal_yaw": "north"}, r"info\.goal_yaw: expected 1 numbers, got \['north'\]"),
    ],
)
def test_an_invalid_episode_is_refused_in_one_line_that_names_the_field(
    key: str, value: Any, match: str, tmp_path: Path
) -> None:
    path = written(tmp_path)
    wrong = content(path)
    wrong["episodes"][0][key] = value
    path.write_bytes(gzip.compress(json.dumps(wrong).encode()))
    with pytest.raises(ValueError, match=match) as caught:
        read_episodes(path, ["yard", "kitchen"])
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("data", "match"),
    [
        (b"", "expected a complete gzip file of .* got a truncated one"),
        (b"no gzip", "expected a gzip file, got Error -3"),
        (gzip.compress(b"{"), "expected JSON, got"),
        (gzip.compress(b"[]"), "episodes: expected a list of 1 to 200,000, got no list"),
        (gzip.compress(b'{"episodes": []}'), "episodes: expected a list of 1 to 200,000, got 0"),
        (gzip.compress(b'{"episodes": [1]}'), "episode 0: expected keys and values, got 1"),
        (gzip.compress(b"[" * 100_000), "expected JSON, got"),
        (gzip.compress(b'{"episodes": [{}]}')[:-9], "expected a complete gzip file of .* got a truncated one"),
    ],
    ids=[
        "empty-file",
        "not-gzip",
        "incomplete-json",
        "not-an-object",
        "no-episodes",
        "episode-is-a-number",
        "deeply-nested",
        "truncated-gzip",
    ],
)
def test_a_damaged_file_is_refused_in_one_line(data: bytes, match: str, tmp_path: Path) -> None:
    path = tmp_path / "episodes.json.gz"
    path.write_bytes(data)
    with pytest.raises(ValueError, match=rf"episodes\.json\.gz: {match}") as caught:
        read_episodes(path, ["yard"])
    assert "\n" not in str(caught.value) and str(caught.value).count("expected") == 1


def test_a_file_that_unpacks_to_too_many_bytes_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(episode_sets, "MOST_BYTES", 1000)
    path = tmp_path / "episodes.json.gz"
    path.write_bytes(gzip.compress(b" " * 100_000 + b'{"episodes": []}'))
    with pytest.raises(ValueError, match="at most 1,000 unpacked bytes, got more"):
        read_episodes(path, ["yard"])


def test_a_missing_episode_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"none\.json\.gz: expected an episode file, found none"):
        read_episodes(tmp_path / "none.json.gz", ["yard"])
