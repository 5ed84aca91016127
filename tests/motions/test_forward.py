"""Motion by steps along the heading and turns on the spot."""

import math
from typing import Any

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from splatrl.motions import ForwardMotion
from tests.tiny import HEIGHT

FORWARD, BACK, LEFT, RIGHT = range(4)
SMALL: dict[str, Any] = {"step": 0.5, "angle_step_deg": 90.0, "lower": (-1.0, -1.5), "upper": (1.0, 1.5)}


def walk(motion: ForwardMotion, state: list[float], *actions: int) -> Tensor:
    """Return the state that a sequence of actions leads to: [3]."""
    at = torch.tensor([state])
    for action in actions:
        at = motion.advance(at, torch.tensor([action]))
    return at[0]


def assert_pose(state: Tensor, expected: list[float]) -> None:
    """Assert equal positions, and headings that are equal up to whole turns."""
    torch.testing.assert_close(state[:2], torch.tensor(expected[:2]), atol=1e-5, rtol=0)
    turn = float(state[2]) - expected[2]
    assert abs(math.remainder(turn, math.tau)) < 1e-5, (state, expected)


def test_the_published_actions_are_forward_back_left_and_right() -> None:
    motion = ForwardMotion(HEIGHT)
    assert motion.action_names == ("forward", "back", "left", "right") and motion.action_spec.n == 4
    assert motion.actions().tolist() == [FORWARD, BACK, LEFT, RIGHT]
    assert motion.step == 0.1 and motion.angle_step == pytest.approx(math.radians(10))


@pytest.mark.parametrize(
    ("yaw_deg", "dx", "dy"), [(0, 0.1, 0.0), (90, 0.0, 0.1), (180, -0.1, 0.0), (270, 0.0, -0.1), (30, 0.0866025, 0.05)]
)
def test_forward_goes_along_the_heading_and_back_against_it(yaw_deg: float, dx: float, dy: float) -> None:
    motion, yaw = ForwardMotion(HEIGHT), math.radians(yaw_deg)
    assert_pose(walk(motion, [0.3, -0.2, yaw], FORWARD), [0.3 + dx, -0.2 + dy, yaw])
    assert_pose(walk(motion, [0.3, -0.2, yaw], BACK), [0.3 - dx, -0.2 - dy, yaw])


def test_left_is_counter_clockwise_and_right_clockwise() -> None:
    motion, turn = ForwardMotion(HEIGHT), math.radians(10)
    assert_pose(walk(motion, [0.3, -0.2, 0.0], LEFT), [0.3, -0.2, turn])
    assert_pose(walk(motion, [0.3, -0.2, 0.0], RIGHT), [0.3, -0.2, math.tau - turn])
    assert_pose(walk(motion, [0.0, 0.0, 0.0], *[LEFT] * 9, FORWARD), [0.0, 0.1, math.tau / 4])


def test_thirty_six_turns_either_way_make_a_full_circle() -> None:
    motion = ForwardMotion(HEIGHT)
    for turn in (LEFT, RIGHT):
        for count in range(1, 36):
            yaw = float(walk(motion, [0.0, 0.0, 1.0], *[turn] * count)[2])
            assert 0 <= yaw < math.tau and abs(math.remainder(yaw - 1.0, math.tau)) > 0.1
        assert_pose(walk(motion, [0.0, 0.0, 1.0], *[turn] * 36), [0.0, 0.0, 1.0])


@given(st.lists(st.integers(0, 3), max_size=30), st.floats(0, 6.28))
def test_every_walk_can_be_walked_back(actions: list[int], yaw: float) -> None:
    motion = ForwardMotion(HEIGHT)
    there = walk(motion, [0.1, 0.2, yaw], *actions)
    assert_pose(walk(motion, there.tolist(), *(action ^ 1 for action in reversed(actions))), [0.1, 0.2, yaw])


def test_the_bounds_are_inclusive_within_rounding() -> None:
    motion = ForwardMotion(HEIGHT, **SMALL)
    edge = torch.tensor([[1.0, 1.5, 0.0], [-1.0, -1.5, 2.0], [1.000001, 0.0, 0.0], [0.0, -1.500001, 0.0]])
    assert motion.inside(edge).all()
    beyond = torch.tensor([[1.001, 0.0, 0.0], [0.0, 1.501, 0.0], [-1.001, 0.0, 0.0], [0.0, -1.501, 0.0]])
    assert not motion.inside(beyond).any()
    for count, inside in ((20, True), (21, False)):  # twenty steps of 0.1 m are the whole way
        state = walk(ForwardMotion(HEIGHT), [-1.0, 0.0, 0.0], *[FORWARD] * count)
        assert ForwardMotion(HEIGHT).inside(state[None]).item() is inside


def test_episodes_begin_on_a_lattice_of_places_and_headings() -> None:
    motion = ForwardMotion(HEIGHT, **SMALL)
    states = motion.states()
    assert states.shape == (5 * 7 * 4, 3) and states.dtype == torch.float32 and len(states.unique(dim=0)) == len(states)
    torch.testing.assert_close(states[0], torch.tensor([-1.0, -1.5, 0.0]))
    torch.testing.assert_close(states[-1], torch.tensor([1.0, 1.5, 0.75 * math.tau]))
    torch.testing.assert_close(states[:, 1].unique(), torch.linspace(-1.5, 1.5, 7))
    assert motion.inside(states).all()
    spec = motion.state_spec
    assert spec.expand(len(states), *spec.shape).is_in(states)


def test_starts_have_the_requested_spacing() -> None:
    motion = ForwardMotion(HEIGHT, **SMALL, spacing=0.8)
    torch.testing.assert_close(motion.states()[:, 0].unique(), torch.tensor([-1.0, -0.2, 0.6]))
    assert len(ForwardMotion(HEIGHT).states()) == 21 * 21 * 36
    rounded = ForwardMotion(HEIGHT, lower=(0.0, 0.0), upper=(0.7, 0.7))  # in float32, 0.7 is a little less
    torch.testing.assert_close(rounded.states()[:, 0].unique(), torch.linspace(0.0, 0.7, 8))


def test_the_body_faces_its_heading_at_its_height() -> None:
    body_to_world = ForwardMotion(HEIGHT).body_to_world(torch.tensor([[0.3, -0.4, math.pi / 2], [0.1, 0.2, 0.0]]))
    torch.testing.assert_close(body_to_world[:, :3, 0], torch.tensor([[0.0, 1, 0], [1, 0, 0]]), atol=1e-6, rtol=0)
    torch.testing.assert_close(body_to_world[:, :3, 2], torch.tensor([[0.0, 0, 1]] * 2))
    torch.testing.assert_close(body_to_world[:, :3, 3], torch.tensor([[0.3, -0.4, HEIGHT], [0.1, 0.2, HEIGHT]]))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"step": 0.0}, r"task\.motion\.step: expected a number of metres above 0\.0, got 0\.0"),
        ({"step": math.nan}, r"task\.motion\.step"),
        ({"angle_step_deg": 25.0}, r"task\.motion\.angle_step_deg: expected a divisor of 360, got 25\.0"),
        ({"angle_step_deg": -10.0}, r"task\.motion\.angle_step_deg"),
        ({"upper": (-1.0, 1.0)}, r"task\.motion: expected lower < upper in x and y, got \[-1\.0, -1\.5\]"),
        ({"lower": (0.0,)}, r"task\.motion: expected lower < upper in x and y"),
        ({"spacing": 0.0}, r"task\.motion: expected spacing > 0 and headings ≥ 1, got 0\.0 and 4"),
        ({"spacing": -0.1}, r"task\.motion: expected spacing > 0"),
        ({"spacing": math.nan}, r"task\.motion: expected spacing > 0"),
        ({"spacing": math.inf}, r"task\.motion: expected spacing > 0"),
        ({"spacing": 1e-320}, r"task\.motion: expected at most 16,777,216 states"),
        ({"angle_step_deg": 1e-310}, r"task\.motion\.angle_step_deg: expected a divisor of 360"),
        ({"upper": (1.0, math.nan)}, r"task\.motion\.upper: expected a number from .*, got nan"),
        ({"upper": (1e300, 1e300)}, r"task\.motion\.upper: expected a number from .*, got 1e\+300"),
        (
            {"lower": (-1e4, -1e4), "upper": (1e4, 1e4), "spacing": 0.1},
            r"task\.motion: expected at most 16,777,216 states, got [\d,]+ \(200,001 × 200,001 × 4\) from "
            r"\[-10000\.0, -10000\.0\] to \[10000\.0, 10000\.0\] m in steps of 0\.1 m; "
            r"choose a larger task\.motion\.spacing or a smaller area",
        ),
    ],
)
def test_invalid_settings_are_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        ForwardMotion(HEIGHT, **{**SMALL, **change})
