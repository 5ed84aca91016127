"""Tracks of gates, drawn from a seed where there is room."""

import math
from itertools import pairwise

import numpy as np
import pytest
import torch

from splatrl.physics import Terrain, TrackSettings, draw_courses

LOWER, UPPER, CEILING = (-2.0, -2.4), (2.2, 2.0), 2.0
PLANE = torch.tensor([0.0, 0.0, 1.0, 0.1], dtype=torch.float64)
POSTS = torch.tensor([[0.0, 0.0, 1.0, 0.1, 0.6, 0.9], [1.2, -1.0, 0.3, 0.2, 0.2, 0.2]], dtype=torch.float64)
TRACK = TrackSettings(gates=3)


def drawn(count: int, seed: int = 0, settings: TrackSettings = TRACK) -> np.ndarray:
    return draw_courses(Terrain(PLANE, POSTS), LOWER, UPPER, settings, count, seed, CEILING)


def test_a_track_depends_only_on_the_seed_and_its_number() -> None:
    five = drawn(5)
    assert five.shape == (5, 4, 4)
    assert drawn(3).tobytes() == five[:3].tobytes()
    assert not np.array_equal(drawn(1, seed=1), five[:1])
    assert len({track.tobytes() for track in five}) == 5


def test_gates_and_the_paths_between_them_are_free() -> None:
    for track in drawn(12):
        for number, (before, gate) in enumerate(pairwise(track)):
            ahead = np.array([math.cos(gate[3]), math.sin(gate[3]), 0.0])
            side = np.array([-ahead[1], ahead[0], 0.0])
            assert 1.0 <= math.dist(before[:2], gate[:2]) <= 1.7
            assert 0.7 <= gate[2] - 0.1 <= 1.3
            begin = before[:3] + (0.5 * np.array([math.cos(before[3]), math.sin(before[3]), 0.0]) if number else 0.0)
            for share in np.linspace(0.0, 1.0, 50):
                points = [begin + share * (gate[:3] - begin), gate[:3] + 0.5 * share * ahead]
                points += [gate[:3] + a * side + [0.0, 0.0, b] for a in (-0.4, 0.4) for b in (0.8 * share - 0.4,)]
                for point in points:
                    outside = np.maximum(np.abs(point - POSTS[:, :3].numpy()) - POSTS[:, 3:].numpy(), 0.0)
                    assert np.linalg.norm(outside, axis=1).min() > 0.0
                    assert (point[:2] >= LOWER).all() and (point[:2] <= UPPER).all() and 0.1 < point[2] < 2.1
        apart = [math.dist(a[:3], b[:3]) for i, a in enumerate(track[1:]) for b in track[2 + i :]]
        assert min(apart) > 0.7


def test_a_gate_is_approached_from_its_front() -> None:
    for track in drawn(12):
        for before, gate in pairwise(track):
            way = np.arctan2(*(gate[:2] - before[:2])[::-1])
            off = (gate[3] - way + math.pi) % math.tau - math.pi
            assert abs(off) <= math.radians(25.0) + 1e-9
        assert track[0][3] == pytest.approx(math.atan2(*(track[1][:2] - track[0][:2])[::-1]))


def test_an_area_without_room_is_refused() -> None:
    with pytest.raises(ValueError, match=r"task\.course: expected room for 3 gates, found none"):
        draw_courses(Terrain(PLANE, POSTS), (-0.6, -0.6), (0.6, 0.6), TRACK, 1, 0, CEILING)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"gates": 0}, "task.course.gates"),
        ({"distance": (2.0, 1.0)}, "task.course.distance: expected 0 < lowest"),
        ({"opening": 0.9}, "task.course.opening: expected a size below task.course.frame"),
        ({"opening": None}, "task.course.opening: expected a number"),
        ({"gates": 2.5}, "task.course.gates: expected a whole number from 1 to 64, got 2.5"),
        ({"turn_deg": 130.0}, "task.course.turn_deg"),
    ],
)
def test_invalid_settings_are_refused(wrong: dict[str, object], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        TrackSettings(**wrong)  # type: ignore[arg-type]
