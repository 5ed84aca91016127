"""The gates task."""

import math
from typing import Any

import pytest
import torch

from splatrl.envs.tasks import Gates, Outcome
from splatrl.geometry import axis_rotations, rigid
from splatrl.motions import PhysicsMotion
from splatrl.physics import Terrain, TrackSettings
from tests.envs.tasks.courses import NOTHING, PLANE, CourseContract, cache, judged, wander
from tests.envs.test_configured_tasks import ConfiguredContract

__all__ = ["cache"]

POST = torch.tensor([[0.0, 0.0, 1.0, 0.1, 0.1, 1.0]], dtype=torch.float64)
HOVER = torch.tensor([1.0, 0.0, 0.0, 0.0])


def gates(courses: int = 2, test_courses: int = 3, **settings: Any) -> Gates:
    """Make the task around a post, with tracks of two gates."""
    things = {"gate": "gate"}
    motion = PhysicsMotion(
        "quadrotor", "eye", things, time_step=0.05, linear=(-1.0, 1.0), angular_deg=90.0, lower=(-2.0, -2.0),
        upper=(2.0, 2.0), ceiling=2.0, threads=1,
    )  # fmt: skip
    motion.stand_on(Terrain(PLANE, POST))
    task = Gates(motion, course=TrackSettings(gates=2), courses=courses, test_courses=test_courses, **settings)
    task.generate_courses()
    return task


def seen_from(task: Gates, track: int, number: int, local: tuple[float, float, float]) -> torch.Tensor:
    """Return a state [1, n] at a position in a gate's frame: ahead, left and up from its centre."""
    x, y, z, yaw = task.places[track, 1 + number].tolist()
    ahead, left, up = local
    state = task.motion.home[None].clone()
    state[0, task.motion.layout.model] = track
    place = (x + math.cos(yaw) * ahead - math.sin(yaw) * left, y + math.sin(yaw) * ahead + math.cos(yaw) * left, z + up)
    state[0, task.motion.layout.position] = torch.tensor(place, dtype=torch.float64)
    return state


@pytest.mark.parametrize(
    ("start", "end", "passes"),
    [
        ((-0.1, 0.0, 0.0), (0.1, 0.0, 0.0), True),
        ((-0.1, 0.34, -0.34), (0.01, 0.34, -0.34), True),
        ((-0.1, 0.36, 0.0), (0.1, 0.36, 0.0), False),
        ((-0.1, 0.0, 0.36), (0.1, 0.0, 0.36), False),
        ((-0.1, 0.2, 0.0), (0.1, 0.6, 0.0), False),  # it crosses at 0.4
        ((-0.3, 0.24, 0.0), (0.1, 0.4, 0.0), False),  # at 0.36
        ((-0.3, 0.18, 0.0), (0.1, 0.4, 0.0), True),
        ((0.1, 0.0, 0.0), (-0.1, 0.0, 0.0), False),  # backwards
        ((-0.2, 0.0, 0.0), (-0.1, 0.0, 0.0), False),
    ],
)
def test_a_gate_is_passed_through_its_opening_from_its_front(start: Any, end: Any, passes: bool) -> None:
    task = gates()
    verdict = judged(task, seen_from(task, 1, 0, start), seen_from(task, 1, 0, end))
    assert (verdict.outcome.item() == Outcome.GOAL) == passes
    assert verdict.memory["passed"].item() == int(passes)
    assert not verdict.terminated.item()
    place = task.places[1, 2 if passes else 1].float()
    assert torch.equal(verdict.memory["next_place"][0], place)


def test_beams_meet_the_gates_of_their_own_track_and_pass_through_the_openings() -> None:
    task = gates()
    below = seen_from(task, 1, 0, (-1.0, 0.0, -0.39))
    rows = [seen_from(task, 0, 0, (-1.0, 0.39, 0.0)), seen_from(task, 1, 0, (-1.0, 0.0, 0.0)), below]
    state, yaw = torch.cat(rows), task.places[[0, 1, 1], 1, 3]
    poses = rigid(axis_rotations(2, yaw), state[:, task.motion.layout.position]).float()
    ahead = task.motion.ranges(state, poses, torch.eye(3)[:1], 1.2)
    torch.testing.assert_close(ahead, torch.tensor([[0.97], [1.2], [0.97]]))


def test_gates_count_only_in_order_and_the_last_one_ends_the_episode() -> None:
    task, way = gates(), ((-0.1, 0.0, 0.0), (0.1, 0.0, 0.0))
    early = judged(task, *(seen_from(task, 0, 1, at) for at in way), passed=0)
    assert early.outcome.item() == Outcome.RUNNING and early.memory["passed"].item() == 0
    last = judged(task, *(seen_from(task, 0, 1, at) for at in way), passed=1)
    assert last.outcome.item() == Outcome.GOAL and last.terminated.item() and last.memory["passed"].item() == 2
    assert task.goals_for_success == 2


def test_touching_leaving_and_falling_end_an_episode_and_pass_no_gate() -> None:
    task, way = gates(), ((-0.1, 0.0, 0.0), (0.1, 0.0, 0.0))
    crash = judged(task, *(seen_from(task, 0, 0, at) for at in way), free=0.5)
    assert crash.outcome.item() == Outcome.COLLISION and crash.terminated.item() and crash.memory["passed"].item() == 0
    for column, value, outcome in ((0, 2.1, Outcome.OUT_OF_BOUNDS), (2, 2.1, Outcome.OUT_OF_BOUNDS),
                                   (2, 0.12, Outcome.COLLISION)):  # fmt: skip
        state = seen_from(task, 0, 0, (-0.5, 0.0, 0.0))
        state[0, task.motion.layout.position][column] = value
        verdict = judged(task, state, state)
        assert verdict.outcome.item() == outcome and verdict.terminated.item(), (column, value)


def test_the_reward_is_progress_plus_a_bonus_per_gate() -> None:
    task = gates()
    nearer = judged(task, seen_from(task, 0, 0, (-0.5, 0.0, 0.0)), seen_from(task, 0, 0, (-0.3, 0.0, 0.0)))
    assert nearer.reward.item() == pytest.approx(0.2 - 0.01, abs=1e-6)
    through = judged(task, seen_from(task, 0, 0, (-0.1, 0.0, 0.0)), seen_from(task, 0, 0, (0.1, 0.0, 0.0)))
    assert through.reward.item() == pytest.approx(0.1 + 1.0 - 0.01, abs=1e-6)


def test_each_track_has_its_gates_in_its_own_physics() -> None:
    """A quadrotor inside a post of one track's gate touches it, but nothing on another track."""
    task = gates()
    inside = seen_from(task, 0, 0, (0.0, 0.39, 0.0))
    elsewhere = inside.clone()
    elsewhere[0, 0] = 1
    move = task.motion.move(torch.cat([inside, elsewhere]), HOVER.expand(2, 4), NOTHING)
    assert move.free_fraction.tolist() == [0.0, 1.0]


def test_the_next_gate_is_lit_and_stands_where_its_boxes_are() -> None:
    task = gates()
    state = seen_from(task, 1, 0, (-1.0, 0.0, 0.0))
    parts = task.parts(state, {"passed": torch.tensor([[1]])})
    dull, lit = len(task.models) - 1, len(task.models)
    assert parts.model[0, -2:].tolist() == [dull, lit]
    x, y, z, yaw = task.places[1, 2].tolist()
    assert parts.model_to_world[0, -1, :3, 3].tolist() == pytest.approx([x, y, z], abs=1e-6)
    assert parts.model_to_world[0, -1, :2, 0].tolist() == pytest.approx([math.cos(yaw), math.sin(yaw)], abs=1e-6)
    colour = task.models[-1].sh.mean((0, 1))
    assert colour[0] > colour[1] > colour[2]


def test_a_hovering_quadrotor_passes_no_gate() -> None:
    assert wander(gates(), 40, (1.0, 0.0, 0.0, 0.0)).max() == 0


def test_things_other_than_one_gate_are_refused() -> None:
    with pytest.raises(ValueError, match=r"task\.motion\.things: expected only the gate of .* got gate1, gate2"):
        Gates(gates().motion)


def test_a_track_has_as_many_gates_as_its_settings_say() -> None:
    assert list(gates().motion.things.paths) == ["gate1", "gate2"]


@pytest.mark.parametrize("lit", [(1.0, 0.5), (255, 0, 0), "red"])
def test_a_lit_colour_that_is_invalid_is_refused(lit: Any) -> None:
    with pytest.raises(ValueError, match=r"task\.lit: expected red, green and blue in \[0, 1\], got"):
        gates(lit=lit)


class TestGates(ConfiguredContract, CourseContract):
    taught = 200

    @classmethod
    def overrides(cls) -> tuple[str, ...]:
        return ("gates",)

    def course(self, courses: int = 2, test_courses: int = 3) -> Gates:
        return gates(courses, test_courses)
