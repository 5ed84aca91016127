"""Motion on a lattice."""

import math
from typing import Any

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from splatrl.motions import LatticeMotion
from tests.tiny import HEIGHT, tiny_motion

STATES = torch.tensor([[2, 3, 0], [0, 0, 7], [4, 6, 0]])


def test_the_actions_are_steps_along_the_worlds_axes_and_turns() -> None:
    state = torch.tensor([[2, 3, 5]]).expand(6, 3)  # the heading does not matter
    ahead = tiny_motion().advance(state, torch.arange(6))
    assert ahead.tolist() == [[3, 3, 5], [1, 3, 5], [2, 4, 5], [2, 2, 5], [2, 3, 6], [2, 3, 4]]
    assert tiny_motion().action_names == ("+x", "-x", "+y", "-y", "+spin", "-spin")
    assert tiny_motion().action_spec.n == 6


def test_headings_wrap_around_and_positions_do_not() -> None:
    motion = tiny_motion()
    assert motion.advance(torch.tensor([[1, 1, 7], [1, 1, 0]]), torch.tensor([4, 5])).tolist() == [[1, 1, 0], [1, 1, 7]]
    assert motion.advance(STATES[1:], torch.tensor([1, 2])).tolist() == [[-1, 0, 7], [4, 7, 0]]


def test_the_bounds_are_inclusive() -> None:
    motion = tiny_motion()
    assert motion.shape == (5, 7, 8)
    assert motion.inside(torch.tensor([[0, 0, 0], [4, 6, 7], [0, 6, 1], [4, 0, 1]])).all()
    assert not motion.inside(torch.tensor([[-1, 0, 0], [5, 6, 0], [0, -1, 0], [4, 7, 0]])).any()
    corners = motion.planar(torch.tensor([[0, 0, 0], [4, 6, 7]]))
    torch.testing.assert_close(corners[:, :2], torch.tensor([[-1.0, -1.5], [1.0, 1.5]], dtype=torch.float64))


def test_the_published_lattice_has_11_by_11_positions_and_16_headings() -> None:
    assert LatticeMotion(0.9).shape == (11, 11, 16)


def test_states_lists_each_state_once_and_index_finds_it() -> None:
    motion = tiny_motion()
    states = motion.states()
    assert states.shape == (5 * 7 * 8, 3) and motion.inside(states).all()
    assert torch.equal(motion.index(states), torch.arange(len(states)))
    assert motion.state_spec.is_in(states[-1]) and not motion.state_spec.is_in(states[-1] + 1)


@given(st.lists(st.integers(0, 5), max_size=30))
def test_every_walk_can_be_walked_back(actions: list[int]) -> None:
    motion = tiny_motion()
    state = STATES[:1]
    for action in actions:
        state = motion.advance(state, torch.tensor([action]))
    for action in reversed(actions):
        state = motion.advance(state, torch.tensor([action ^ 1]))  # its opposite is next to it
    assert torch.equal(state, STATES[:1])


def test_the_body_faces_its_heading() -> None:
    body_to_world = tiny_motion().body_to_world(torch.tensor([[2, 3, 0], [3, 1, 2], [0, 0, 3]]))
    s = math.sqrt(0.5)
    forward = torch.tensor([[1.0, 0, 0], [0, 1.0, 0], [-s, s, 0]])
    torch.testing.assert_close(body_to_world[:, :3, 0], forward)
    torch.testing.assert_close(body_to_world[:, :3, 2], torch.tensor([[0.0, 0, 1]] * 3))
    place = torch.tensor([[0.0, 0.0, HEIGHT], [0.5, -1.0, HEIGHT], [-1.0, -1.5, HEIGHT]])
    torch.testing.assert_close(body_to_world[:, :3, 3], place)
    assert body_to_world.dtype == torch.float32


def test_a_state_has_the_same_pose_bytes_in_any_batch() -> None:
    motion = tiny_motion()
    together = motion.body_to_world(motion.states())
    for row in (0, 77, 279):
        alone = motion.body_to_world(motion.states()[row : row + 1])
        assert alone.numpy().tobytes() == together[row].numpy().tobytes()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"step": 0.3}, r"step: bounds along x: expected a whole number of steps of 0\.3 in 2, got 6\.6"),
        ({"upper": (1.0, 1.1)}, "step: bounds along y: expected a whole number"),
        ({"step": 0.0}, "step: bounds along x"),
        ({"upper": (-2.0, 1.0)}, r"task\.motion: expected lower < upper in x and y, got \[-1\.0, -1\.0\]"),
        ({"angle_step_deg": 25.0}, r"angle_step_deg: expected a whole number of steps of 25\.0 in 360, got 14\.4"),
        ({"angle_step_deg": -45.0}, "angle_step_deg"),
        ({"step": math.nan}, "step: bounds along x"),
        ({"step": 1e-320}, "step: bounds along x: expected a whole number"),
        ({"upper": (math.inf, 1.0)}, r"task\.motion\.upper: expected a number from .*, got inf"),
        (
            {"lower": (-1e300, -1e300), "upper": (1e300, 1e300)},
            r"task\.motion\.lower: .* got -1e\+300",
        ),
        (
            {"lower": (-1e4, -1e4), "upper": (1e4, 1e4), "step": 0.2},
            r"task\.motion: expected at most 16,777,216 states, got 160,003,200,016 \(100,001 × 100,001 × 16\) "
            r"from \[-10000\.0, -10000\.0\] to \[10000\.0, 10000\.0\] m in steps of 0\.2 m; "
            "choose a larger step or a smaller area",
        ),
        ({"step": 5e-4}, r"expected at most 16,777,216 states, got 256,128,016 \(4,001 × 4,001 × 16\)"),
        ({"angle_step_deg": 1e-6}, "expected at most 16,777,216 states"),
    ],
)
def test_a_lattice_that_does_not_fit_is_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        LatticeMotion(**{"height": HEIGHT, "step": 0.5, **change})


def test_the_nearest_states_are_the_same_however_many_are_compared_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    motion = LatticeMotion(HEIGHT, step=0.5)
    planar = motion.planar(motion.states())
    assert torch.equal(motion.nearest(planar), motion.states()) and len(motion.nearest(planar[:0])) == 0
    monkeypatch.setattr("splatrl.motions.finite.PAIRS", 3 * len(planar))
    assert torch.equal(motion.nearest(planar), motion.states())
