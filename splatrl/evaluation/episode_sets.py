"""Navigation episodes in files with Habitat's field names: starts, goals and scenes."""

import gzip
import json
import math
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from splatrl.documents import parsed_json
from splatrl.files import refusing, replacing

EPISODES = "episodes.json.gz"
MOST_BYTES = 2**27
"""Maximum size of a file, packed or unpacked, bytes: several hundred thousand episodes."""
INFLATION, SLACK = 100, 2**20
"""Maximum gzip expansion ratio, which stays below 20 in real files, and bytes that any file may unpack to besides."""
MOST_EPISODES = 200_000
LEVEL = 1.0
"""Largest difference between the heights of a start and its goal, metres: robots stay on one plane."""
FARTHEST = 1e6
"""Largest magnitude of a number, such as a coordinate in metres, that a file may hold."""
EXPECTED = "Habitat episodes: a list 'episodes' of entries with scene_id, start_position, start_rotation and goals"


def to_habitat(places: Tensor) -> Tensor:
    """Convert positions [N, 3], metres, from the world (z up, yaw 0 along +x) to Habitat's frame (y up, facing −z)."""
    x, y, z = places.unbind(1)
    return torch.stack([-y, z, -x], 1)


def from_habitat(places: Tensor) -> Tensor:
    """Convert positions [N, 3] from Habitat's frame to the world, metres: the inverse of ``to_habitat``."""
    x, y, z = places.unbind(1)
    return torch.stack([-z, -x, y], 1)


def write_episodes(
    path: Path,
    start: Tensor,
    memory: Mapping[str, Tensor],
    scenes: Sequence[str],
    heights: Tensor,
    radius: float,
) -> None:
    """Write episodes as ``episodes.json.gz``.

    Positions and rotations (x, y, z, w) are in Habitat's frame. The yaw of a goal, which image goals need, is stored as
    ``info.goal_yaw``, radians, world frame.

    Args:
        path: file to write.
        start: [N, 3] starts, x and y in metres and yaw in radians.
        memory: ``goal`` [N, 3], likewise, and ``start_distance`` [N, 1], the geodesic distance to it, metres.
        scenes: name of the scene of each of the N episodes.
        heights: [N] float32, z of each start, at which its goal is written too, metres.
        radius: distance from the goal within which a stop is a success, metres.
    """
    z = heights.double().unsqueeze(1)
    goal = memory["goal"].double()
    starts, goals = (to_habitat(torch.cat([each[:, :2].double(), z], 1)).tolist() for each in (start, goal))
    yaws, far = start[:, 2].double().tolist(), memory["start_distance"].double().flatten().tolist()
    episodes = [
        {
            "episode_id": str(number),
            "scene_id": scenes[number],
            "start_position": starts[number],
            "start_rotation": [0.0, math.sin(yaws[number] / 2), 0.0, math.cos(yaws[number] / 2)],
            "info": {"geodesic_distance": far[number], "goal_yaw": float(goal[number, 2])},
            "goals": [{"position": goals[number], "radius": radius}],
        }
        for number in range(len(start))
    ]
    text = json.dumps({"episodes": episodes})
    with replacing(path) as stream, gzip.GzipFile("", "wb", 9, stream, mtime=0) as packed:  # reproducible bytes
        packed.write(text.encode())


def read_episodes(path: Path, scenes: Sequence[str]) -> tuple[Tensor, Tensor, Tensor]:
    """Read a file of episodes, which may come from a stranger and is treated as untrusted data.

    Args:
        path: a file written by ``write_episodes`` or made for Habitat.
        scenes: names of the available scenes.

    Returns:
        Starts [N, 3] float32, x and y in metres and yaw in radians; goals likewise, with a yaw that depends on
        ``episode_id`` alone if the file gives none, as image goals have in Habitat; and the index of each episode's
        scene, [N] int64.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: for a file that is damaged, too large, of another kind, or names scenes that are not available; for
            an episode of several goals, or whose goal is higher or lower than its start by more than ``LEVEL``.
    """
    require_episodes(path)
    with refusing(path, EXPECTED):
        found = parsed_json(str(path), _unpacked(path))
        rows = found.get("episodes") if isinstance(found, dict) else None
        if not isinstance(rows, list) or not 0 < len(rows) <= MOST_EPISODES:
            got = f"{len(rows):,}" if isinstance(rows, list) else "no list"
            raise ValueError(f"{path}: episodes: expected a list of 1 to {MOST_EPISODES:,}, got {got}")
        read = [_episode(f"{path}: episode {number}", row, scenes) for number, row in enumerate(rows)]
    start, goal = (torch.tensor([row[which] for row in read], dtype=torch.float32) for which in (0, 1))
    return start, goal, torch.tensor([row[2] for row in read], dtype=torch.int64)


def require_episodes(path: Path) -> None:
    """Check that a file of episodes exists.

    Raises:
        FileNotFoundError: if not; the message names it.
    """
    if not path.is_file():
        raise FileNotFoundError(f"{path}: expected an episode file, found none")


def _unpacked(path: Path) -> bytes:
    """Decompress a file, refusing more than ``MOST_BYTES`` or too high an expansion ratio."""
    if path.stat().st_size > MOST_BYTES:
        raise ValueError(f"{path}: expected at most {MOST_BYTES:,} bytes, got {path.stat().st_size:,}")
    packed, text = path.read_bytes(), zlib.decompressobj(wbits=31)
    most = min(MOST_BYTES, INFLATION * len(packed) + SLACK)
    try:
        content = text.decompress(packed, most)
    except zlib.error as error:
        raise ValueError(f"{path}: expected a gzip file, got {error}") from error
    if not text.eof:
        got = "more" if len(content) == most else "a truncated one"
        raise ValueError(f"{path}: expected a complete gzip file of at most {most:,} unpacked bytes, got {got}")
    return content


def _episode(where: str, row: Any, scenes: Sequence[str]) -> tuple[list[float], list[float], int]:
    """Parse an episode into start, goal and scene index."""
    if not isinstance(row, dict):
        raise ValueError(f"{where}: expected keys and values, got {row!r:.80}")
    scene = row.get("scene_id")
    if scene not in scenes:
        raise ValueError(f"{where}: expected scene_id to be {' or '.join(scenes)}, got {str(scene)[:80]!r}")
    goals, info = row.get("goals"), row.get("info") or {}
    if not isinstance(goals, list) or not goals or not isinstance(goals[0], dict) or not isinstance(info, dict):
        raise ValueError(
            f"{where}: expected a list of goals, each with a position, and info as keys and values, got {goals!r:.80} "
            f"and {info!r:.80}"
        )
    if len(goals) != 1:
        raise ValueError(f"{where}.goals: expected one goal, got {len(goals)}")
    places = [
        _numbers(f"{where}.start_position", row.get("start_position"), 3),
        _numbers(f"{where}.goals[0].position", goals[0].get("position"), 3),
    ]
    if abs(places[0][1] - places[1][1]) > LEVEL:
        raise ValueError(
            f"{where}: expected start and goal within {LEVEL:g} m of the same height y, got {places[0][1]:g} and "
            f"{places[1][1]:g}"
        )
    x, y, z, w = rotation = _numbers(f"{where}.start_rotation", row.get("start_rotation"), 4)
    if abs(math.hypot(x, y, z, w) - 1.0) > 1e-3 or math.hypot(x, z) > 1e-3:
        raise ValueError(f"{where}.start_rotation: expected a unit quaternion about the y axis, got {rotation!r:.80}")
    drawn = math.tau * zlib.crc32(f"{row.get('episode_id')}".encode(errors="replace")) / 2**32
    (goal_yaw,) = _numbers(f"{where}.info.goal_yaw", [info.get("goal_yaw", drawn)], 1)
    start, goal = from_habitat(torch.tensor(places, dtype=torch.float64))[:, :2].tolist()
    return [*start, 2.0 * math.atan2(y, w) % math.tau], [*goal, goal_yaw % math.tau], list(scenes).index(str(scene))


def _numbers(key: str, values: Any, count: int) -> list[float]:
    plain = isinstance(values, list) and len(values) == count
    if not plain or not all(isinstance(one, int | float) and not isinstance(one, bool) for one in values):
        raise ValueError(f"{key}: expected {count} numbers, got {values!r:.80}")
    if not all(abs(one) <= FARTHEST for one in values):  # NaN fails this too
        raise ValueError(f"{key}: expected finite numbers of magnitude at most {FARTHEST:g}, got {values!r:.80}")
    return [float(one) for one in values]
