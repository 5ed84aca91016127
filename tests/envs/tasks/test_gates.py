"""The gates task."""

import math
from typing import Any

import pytest
import torch

from splatrl.collision.nothing import NoChecker
from splatrl.envs.tasks import Gates, Outcome, Step, Verdict
from splatrl.envs.tasks.base import Anywhere
from splatrl.motions import Move, PhysicsMotion
from splatrl.motions.physics import FIRST
from splatrl.physics import Terrain, TrackSettings
from tests.envs.test_configured_tasks import ConfiguredContract

NOTHING: Any = NoChecker.__new__(NoChecker)
PLANE = torch.tensor([0.0, 0.0, 1.0, 0.05], dtype=torch.float64)
POST = torch.tensor([[0.0, 0.0, 1.0, 0.1, 0.1, 1.0]], dtype=torch.float64)
HOVER = torch.tensor([1.0, 0.0, 0.0, 0.0])


@pytest.fixture(autouse=True)
def cache(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SPLATRL_CACHE", str(tmp_path))


def gates(tracks: int = 2, test_tracks: int = 3, **settings: Any) -> Gates:
    """The task around a post, with tracks of two gates."""
    things = {"one": "gate", "two": "gate"}
    motion = PhysicsMotion(
        "quadrotor", "eye", things, time_step=0.05, linear=(-1.0, 1.0), angular_deg=90.0, lower=(-2.0, -2.0),
        upper=(2.0, 2.0), ceiling=2.0, threads=1,
    )  # fmt: skip
    motion.settle(Terrain(PLANE, POST))
    task = Gates(motion, track=TrackSettings(gates=2), tracks=tracks, test_tracks=test_tracks, **settings)
    task.settle()
    return task


def anywhere(task: Gates, count: int = 1) -> Anywhere:
    return Anywhere(lambda: task.motion.home.expand(count, -1), torch.Generator().manual_seed(0))


def seen_from(task: Gates, track: int, number: int, local: tuple[float, float, float]) -> torch.Tensor:
    """A state [1, n] at a place in the frame of a gate: ahead, left and up of its centre."""
    x, y, z, yaw = task.places[track, 1 + number].tolist()
    ahead, left, up = local
    state = task.motion.home[None].clone()
    state[0, 0] = track
    place = (x + math.cos(yaw) * ahead - math.sin(yaw) * left, y + math.sin(yaw) * ahead + math.cos(yaw) * left, z + up)
    state[0, FIRST : FIRST + 3] = torch.tensor(place, dtype=torch.float64)
    return state


def judged(task: Gates, before: torch.Tensor, after: torch.Tensor, passed: int = 0, free: float = 1.0) -> Verdict:
    move = Move(after, task.motion.body_to_world(after), torch.tensor([free]), task.motion.inside(after))
    memory = {"gate": torch.tensor([[passed]]), "gate_place": torch.zeros(1, 4)}
    return task.judge(Step(before, HOVER[None], move, memory, torch.zeros(0)), anywhere(task))


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
    assert verdict.memory["gate"].item() == int(passes)
    assert not verdict.terminated.item()
    place = task.places[1, 2 if passes else 1].float()
    assert torch.equal(verdict.memory["gate_place"][0], place)


def test_gates_count_in_their_order_and_the_last_one_ends_the_episode() -> None:
    task, way = gates(), ((-0.1, 0.0, 0.0), (0.1, 0.0, 0.0))
    early = judged(task, *(seen_from(task, 0, 1, at) for at in way), passed=0)
    assert early.outcome.item() == Outcome.RUNNING and early.memory["gate"].item() == 0
    last = judged(task, *(seen_from(task, 0, 1, at) for at in way), passed=1)
    assert last.outcome.item() == Outcome.GOAL and last.terminated.item() and last.memory["gate"].item() == 2
    assert task.goals_for_success == 2


def test_touching_leaving_and_falling_end_an_episode_and_pass_nothing() -> None:
    task, way = gates(), ((-0.1, 0.0, 0.0), (0.1, 0.0, 0.0))
    crash = judged(task, *(seen_from(task, 0, 0, at) for at in way), free=0.5)
    assert crash.outcome.item() == Outcome.COLLISION and crash.terminated.item() and crash.memory["gate"].item() == 0
    for column, value, outcome in ((0, 2.1, Outcome.OUT_OF_BOUNDS), (2, 2.1, Outcome.OUT_OF_BOUNDS),
                                   (2, 0.12, Outcome.COLLISION)):  # fmt: skip
        state = seen_from(task, 0, 0, (-0.5, 0.0, 0.0))
        state[0, FIRST + column] = value
        verdict = judged(task, state, state)
        assert verdict.outcome.item() == outcome and verdict.terminated.item(), (column, value)


def test_reward_is_progress_and_gates() -> None:
    task = gates()
    nearer = judged(task, seen_from(task, 0, 0, (-0.5, 0.0, 0.0)), seen_from(task, 0, 0, (-0.3, 0.0, 0.0)))
    assert nearer.reward.item() == pytest.approx(0.2 - 0.01, abs=1e-6)
    through = judged(task, seen_from(task, 0, 0, (-0.1, 0.0, 0.0)), seen_from(task, 0, 0, (0.1, 0.0, 0.0)))
    assert through.reward.item() == pytest.approx(0.1 + 1.0 - 0.01, abs=1e-6)


def test_each_track_has_its_gates_in_its_own_physics() -> None:
    """A quadrotor inside a post of one track's gate touches it, and on another track nothing."""
    task = gates()
    inside = seen_from(task, 0, 0, (0.0, 0.39, 0.0))
    elsewhere = inside.clone()
    elsewhere[0, 0] = 1
    move = task.motion.move(torch.cat([inside, elsewhere]), HOVER.expand(2, 4), NOTHING)
    assert move.free_fraction.tolist() == [0.0, 1.0]


def test_the_pilot_flies_through_all_gates_of_tracks_that_no_one_trained_on() -> None:
    task = gates(tracks=1, test_tracks=6)
    begun = task.episodes(task.motion.states(), 6, 0)
    state, memory = begun["state"], {key: begun[key] for key in task.memory_spec}
    assert state[:, 0].tolist() == [1, 2, 3, 4, 5, 6]
    outcomes: dict[int, int] = {}
    for _ in range(200):
        action = task.teach(state, memory)
        move = task.motion.move(state, action, NOTHING)
        verdict = task.judge(Step(state, action, move, memory, torch.zeros(0)), anywhere(task, 6))
        for row in verdict.terminated.squeeze(1).nonzero().flatten().tolist():
            outcomes.setdefault(row, int(verdict.outcome[row]))
        state, memory = move.state, dict(verdict.memory)
    assert outcomes == dict.fromkeys(range(6), int(Outcome.GOAL))


def test_without_a_pilot_no_gate_is_passed() -> None:
    task = gates()
    state = task.start(task.motion.home.expand(4, -1), anywhere(task, 4))
    memory = task.begin(state, anywhere(task, 4))
    for _ in range(40):
        move = task.motion.move(state, HOVER.expand(4, 4), NOTHING)
        memory = task.judge(Step(state, HOVER, move, memory, torch.zeros(0)), anywhere(task, 4)).memory
        state = move.state
    assert memory["gate"].flatten().tolist() == [0] * 4


def test_the_next_gate_is_lit_and_stands_where_its_boxes_are() -> None:
    task = gates()
    state = seen_from(task, 1, 0, (-1.0, 0.0, 0.0))
    parts = task.parts(state, {"gate": torch.tensor([[1]])})
    dull, lit = len(task.models) - 1, len(task.models)
    assert parts.model[0, -2:].tolist() == [dull, lit]
    x, y, z, yaw = task.places[1, 2].tolist()
    assert parts.model_to_world[0, -1, :3, 3].tolist() == pytest.approx([x, y, z], abs=1e-6)
    assert parts.model_to_world[0, -1, :2, 0].tolist() == pytest.approx([math.cos(yaw), math.sin(yaw)], abs=1e-6)
    colour = task.models[-1].sh.mean((0, 1))
    assert colour[0] > colour[1] > colour[2]


def test_training_and_tests_fly_different_tracks() -> None:
    task = gates(tracks=2, test_tracks=3)
    flown = task.start(task.motion.home.expand(64, -1), anywhere(task, 64))[:, 0]
    assert set(flown.tolist()) == {0.0, 1.0}
    assert set(task.episodes(task.motion.states(), 9, 0)["state"][:, 0].tolist()) == {2.0, 3.0, 4.0}


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"track": TrackSettings(gates=3)}, "task.motion.things: expected the 3 gates of a track, got 2"),
        ({"tracks": 0}, "task.tracks"),
    ],
)
def test_what_does_not_fit_is_refused(settings: dict[str, Any], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        Gates(gates().motion, **{"track": TrackSettings(gates=2), **settings})


class TestGates(ConfiguredContract):
    @classmethod
    def overrides(cls) -> tuple[str, ...]:
        return ("gates",)
