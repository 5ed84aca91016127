"""A walk with a phone stays in free space, passes every free place, and looks in every direction."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from splatrl.collision.occupancy import Occupancy
from splatrl.evaluation.phone_walk import Sides, Stroll, camera_poses, free_places, phone_walk
from splatrl.evaluation.walks import Hand
from splatrl.geometry import first_not_rigid

STILL = Hand(place=0.0, height=0.0, pitch_deg=0.0, roll_deg=0.0, yaw_deg=0.0)
STROLL = Stroll((-1.9, -1.4), (1.9, 1.4), 0.6, hand=STILL)


def hall() -> Occupancy:
    """Return a hall of 4 × 3 m with walls, a floor, a pillar in the middle, and a ceiling above the phone."""
    lower = [[-2, -1.5, -0.1], [-0.3, -0.3, 0], [-2, -1.5, 1.5], [-2.1, -1.6, 0], [2, -1.6, 0]]
    lower += [[-2, -1.6, 0], [-2, 1.5, 0]]
    upper = [[2, 1.5, 0], [0.3, 0.3, 1.2], [2, 1.5, 1.6], [-2, 1.6, 1.2], [2.1, 1.6, 1.2]]
    upper += [[2, -1.5, 1.2], [2, 1.6, 1.2]]
    return Occupancy.from_boxes(np.array(lower, float), np.array(upper, float))


def test_a_walk_stays_in_free_space_and_within_its_heights_and_speed() -> None:
    walk = phone_walk(hall(), STROLL, 1200, 30.0).numpy()
    assert Sides(hall(), 0.5, 0.7).clearance(walk[:, :2]).min() >= STROLL.radius
    assert walk[:, 2].min() == pytest.approx(0.5, abs=0.01) and walk[:, 2].max() == pytest.approx(0.7, abs=0.01)
    steps = np.linalg.norm(np.diff(walk[:, :2], axis=0), axis=1)
    assert 0.5 * STROLL.speed < 30 * steps.mean() <= STROLL.speed
    assert np.linalg.norm(walk[0, :2] - walk[-1, :2]) < 0.1


def test_a_walk_passes_every_free_place_and_looks_in_every_direction() -> None:
    walk = phone_walk(hall(), STROLL, 1800, 30.0).numpy()
    places = free_places(Sides(hall(), 0.5, 0.7), STROLL)
    apart = np.linalg.norm(places[:, None] - walk[None, ::10, :2], axis=2)
    assert apart.min(1).max() < 0.5
    shares = np.histogram(walk[:, 3] % math.tau, 8, (0.0, math.tau))[0] / len(walk)
    assert shares.min() > 0.04


def test_the_view_turns_slowly_and_avoids_nearby_walls() -> None:
    walk = phone_walk(hall(), STROLL, 1800, 30.0).numpy()
    sides = Sides(hall(), 0.5, 0.7)
    ahead = sides.reach(walk[:, :2], walk[:, 3:4], 3.0)[:, 0]
    even = sides.reach(walk[:, :2], walk[:, 3:4] + np.linspace(0, math.tau, 16, endpoint=False), 3.0).mean(1)
    assert ahead.mean() > 1.25 * even.mean() and (ahead < 0.6).mean() < 0.15
    speeds = np.degrees(np.abs(np.diff(walk[:, 3]))) * 30
    assert speeds.max() < 360 / STROLL.turn + 15.1 and 10 < speeds.mean() < 25


def test_the_reach_of_a_view_ends_at_walls() -> None:
    sides = Sides(hall(), 0.5, 0.7)
    found = sides.reach(np.array([[-1.0, 0.0]]), np.array([[0.0, math.pi, 0.5 * math.pi]]), 5.0)[0]
    assert (found > [0.55, 0.85, 1.2]).all() and (found <= [0.7, 1.0, 1.6]).all()


def test_camera_poses_follow_the_position_yaw_pitch_and_roll_of_the_walk() -> None:
    walk = torch.tensor([[1.0, 2.0, 3.0, 0.5 * math.pi, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0, 0.5, 0.2]]).double()
    poses = camera_poses(walk)
    assert first_not_rigid(poses) is None
    torch.testing.assert_close(poses[0, :3, :3].T, torch.tensor([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]).double())
    assert poses[0, :3, 3].tolist() == [1.0, 2.0, 3.0]
    assert poses[1, 2, 2] == pytest.approx(-math.sin(0.5))
    assert poses[1, 2, 0] == pytest.approx(-math.sin(0.2) * math.cos(0.5))  # the camera's right side leans down


def test_a_seed_fixes_the_walk_and_another_seed_changes_all_of_it() -> None:
    stroll = replace(STROLL, hand=Hand())
    first = phone_walk(hall(), stroll, 300, 30.0)
    assert torch.equal(first, phone_walk(hall(), stroll, 300, 30.0))
    assert (first - phone_walk(hall(), stroll, 300, 30.0, seed=1)).abs().amax(0).gt(1e-3).all()


def test_the_sway_of_the_hand_does_not_depend_on_the_frame_rate() -> None:
    stroll = replace(STROLL, hand=Hand())
    slow, fast = (phone_walk(hall(), stroll, int(10 * fps), fps)[:, 5] for fps in (15.0, 60.0))
    assert float(slow.std() / fast.std()) == pytest.approx(1.0, abs=0.05)
    assert float(slow.diff().abs().mean() / fast.diff().abs().mean()) == pytest.approx(4.0, rel=0.1)


def test_a_walk_in_a_place_too_large_for_its_speed_stays_around_the_middle() -> None:
    street = Occupancy.from_boxes(np.array([[-2.0, -12.0, -0.1]]), np.array([[2.0, 12.0, 0.0]]))
    stroll = replace(STROLL, lower=(-1.0, -11.0), upper=(1.0, 11.0))
    walk = phone_walk(street, stroll, 900, 30.0).numpy()
    steps = np.linalg.norm(np.diff(walk[:, :2], axis=0), axis=1)
    assert 0.5 * STROLL.speed < 30 * steps.mean() <= STROLL.speed
    assert np.ptp(walk[:, 1]) > 2.0 and np.abs(walk[:, :2].mean(0)).max() < 1.0
    moment = phone_walk(street, stroll, 3, 30.0).numpy()
    assert np.ptp(moment[:, :2], axis=0).max() < 0.5


def test_the_walk_is_in_the_larger_of_two_separate_parts() -> None:
    wall = Occupancy.from_boxes(np.array([[0.7, -2, 0]]), np.array([[0.8, 2, 1]]), 0.05)
    assert phone_walk(wall, STROLL, 300, 30.0)[:, 0].max() < 0.7 - STROLL.radius


def test_a_place_without_room_and_invalid_settings_are_refused() -> None:
    with pytest.raises(ValueError, match=r"places to walk, 1\.5 m from anything solid, got 0 between \(-1\.9"):
        phone_walk(hall(), replace(STROLL, radius=1.5), 300, 30.0)
    with pytest.raises(ValueError, match="lower, upper: expected lower below upper"):
        Stroll((1.0, 0.0), (0.0, 1.0), 0.5)
    with pytest.raises(ValueError, match=r"speed: expected a number above 0\.0, got 0"):
        replace(STROLL, speed=0)
    with pytest.raises(ValueError, match="at least 2 frames"):
        phone_walk(hall(), STROLL, 1, 30.0)
