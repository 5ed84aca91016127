"""Routes of waypoints, drawn from a seed where there is room."""

import math
from itertools import pairwise

import numpy as np
import pytest
import torch

from splatrl.physics import RouteSettings, Terrain, draw_courses
from splatrl.physics.room import Room

LOWER, UPPER = (-2.0, -2.4), (2.2, 2.0)
PLANE = torch.tensor([0.0, 0.0, 1.0, 0.1], dtype=torch.float64)
POSTS = torch.tensor([[0.0, 0.0, 0.3, 0.1, 0.5, 0.3], [1.2, -1.0, 0.3, 0.2, 0.2, 0.2]], dtype=torch.float64)


def drawn(count: int, seed: int = 0) -> np.ndarray:
    return draw_courses(Terrain(PLANE, POSTS), LOWER, UPPER, RouteSettings(waypoints=4), count, seed)


def test_a_route_depends_only_on_the_seed_and_its_number() -> None:
    five = drawn(5)
    assert five.shape == (5, 5, 4)
    assert drawn(3).tobytes() == five[:3].tobytes()
    assert not np.array_equal(drawn(1, seed=1), five[:1])


def test_routes_are_free_and_turn_no_further_than_requested() -> None:
    for route in drawn(12):
        assert route[0, 3] == route[1, 3], "the start heads for the first waypoint"
        for number, (last, waypoint) in enumerate(pairwise(route)):
            assert 0.7 <= math.dist(last[:2], waypoint[:2]) <= 1.3
            assert math.atan2(*(waypoint[:2] - last[:2])[::-1]) == pytest.approx(
                math.remainder(waypoint[3], math.tau), abs=1e-9
            )
            assert number == 0 or abs(waypoint[3] - last[3]) <= math.radians(75.0) + 1e-9
            for share in np.linspace(0.0, 1.0, 40):
                at = last[:2] + share * (waypoint[:2] - last[:2])
                outside = np.maximum(np.abs(at - POSTS[:, :2].numpy()) - POSTS[:, 3:5].numpy(), 0.0)
                assert np.linalg.norm(outside, axis=1).min() > 0.24
                assert (at >= LOWER).all() and (at <= UPPER).all()


def test_an_area_without_room_is_refused() -> None:
    with pytest.raises(ValueError, match=r"task\.course: expected room for 4 waypoints, found none"):
        draw_courses(Terrain(PLANE, POSTS), (-0.5, -0.5), (0.5, 0.5), RouteSettings(waypoints=4), 1, 0)


def test_every_waypoint_counts_as_a_draw_so_that_a_room_for_almost_a_route_is_soon_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ground, drawn = Room.ground, list[float]()

    def counted(room: Room, x: float, y: float) -> float:
        drawn.append(x)
        return ground(room, x, y)

    monkeypatch.setattr(Room, "ground", counted)
    monkeypatch.setattr(RouteSettings, "tries", 100)
    straight = RouteSettings(waypoints=9, turn_deg=0.0, distance=(0.3, 0.4), clearance=0.0)
    with pytest.raises(
        ValueError, match=r"none in 100 draws; type wider .*, a larger task\.course\.turn_deg, or fewer"
    ):
        draw_courses(Terrain(PLANE, POSTS), (-1.0, 1.0), (1.0, 1.2), straight, 1, 0)
    assert 10 < len(drawn) <= 100


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"waypoints": 0}, r"task\.course\.waypoints"),
        ({"distance": (2.0, 1.0)}, r"task\.course\.distance: expected 0 < lowest"),
        ({"turn_deg": 130.0}, r"task\.course\.turn_deg"),
    ],
)
def test_invalid_settings_are_refused(wrong: dict[str, object], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        RouteSettings(**wrong)  # type: ignore[arg-type]
