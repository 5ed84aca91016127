import math
from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from splatrl.cameras import Cameras
from splatrl.collision.occupancy import Occupancy
from splatrl.curriculum import Plan, plan
from splatrl.envs.drawing import Drawing, SceneDrawing, Shot, View
from splatrl.envs.tasks.base import Anywhere, Memory
from splatrl.envs.tasks.module import TaskModule
from splatrl.envs.world import World
from splatrl.evaluation.clip_files import read_clips
from splatrl.evaluation.walk_looks import Lens
from splatrl.evaluation.walks import (
    Hand,
    awkwardness,
    eased,
    emptiness,
    far_paths,
    paths,
    record_walks,
    sway,
    walk,
)
from splatrl.motions import DriveMotion, ForwardMotion, OrbitMotion
from splatrl.motions.base import PlannedMotion
from splatrl.renderers import Parts, RenderOutput
from splatrl.renderers.base import to_pixels
from splatrl.scenes import Scene
from tests.tiny import (
    HEIGHT,
    BlockChecker,
    tiny_gaussians,
    tiny_motion,
    tiny_plan,
    tiny_renderer,
    tiny_robot,
    tiny_task,
)

STILL = Hand(place=0.0, height=0.0, pitch_deg=0.0, roll_deg=0.0, yaw_deg=0.0)
NAMES = ForwardMotion(HEIGHT).action_names


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


@cache
def planar_plan() -> Plan:
    """Plan walks in steps of 0.25 m to a place in the north-east that the walker must face."""
    motion = ForwardMotion(HEIGHT, 0.25, 30.0, (-1.0, -1.5), (1.0, 1.5))

    def reached(state: Tensor) -> Tensor:
        away = torch.tensor([0.7, 1.0]) - state[:, :2]
        turn = torch.atan2(away[:, 1], away[:, 0]) - state[:, 2]
        return (away.norm(dim=1) < 0.4) & (turn.cos() > 0.8)

    return plan(motion, BlockChecker(), reached)


def far(count: int, seed: int = 0) -> list[Tensor]:
    return far_paths(planar_plan(), count, generator(seed), lambda states: awkwardness(planar_plan(), states))


def test_the_sway_of_a_hand_has_the_given_deviations_at_every_frame() -> None:
    hand = Hand()
    walks = torch.stack([sway(hand, 50, generator(seed)) for seed in range(800)])
    sizes = hand.sizes().float()
    for frame in (0, 20, 49):
        assert torch.allclose(walks[:, frame].std(0) / sizes, torch.ones(6), atol=0.08)
        assert (walks[:, frame].mean(0).abs() < 0.15 * sizes).all()
    assert (walks.abs().amax((0, 1)) < 2.83 * sizes).all()
    assert walks[..., 2].abs().max() < 0.0312 and walks[..., 3:5].abs().max() < math.radians(7.1)


def test_a_hand_sways_smoothly() -> None:
    hand = Hand()
    steps = torch.stack([sway(hand, 100, generator(seed)).diff(dim=0) for seed in range(20)])
    assert (steps.abs().amax((0, 1)) < math.sqrt(8) * math.tau / hand.fastest * hand.sizes()).all()
    assert (steps.std((0, 1)) > 0.05 * hand.sizes()).all()


def test_easing_passes_smoothly_through_every_pose_and_turns_the_short_way() -> None:
    poses = torch.tensor([[0.0, 0.0, 6.2], [0.5, 0.0, 6.2], [0.5, 0.0, 0.1]], dtype=torch.float64)
    between = eased(poses, 4)
    assert len(between) == 9
    assert torch.allclose(between[::4], poses)
    turns = between[4:8, 2].diff()
    assert (turns > 0).all() and turns.sum() < 0.1 - 6.2 + math.tau
    assert (between[:, 0].diff() >= 0).all()
    assert between[1, 0] < 0.5 / 4 < between[2, 0] - between[1, 0]


def test_paths_on_a_lattice_are_shortest_from_every_start_and_vary_with_the_seed() -> None:
    found = tiny_plan()
    starts = found.states[found.start_rows]
    walked = paths(found, starts, generator())
    assert [len(states) - 1 for states in walked] == found.distance[found.start_rows].tolist()
    assert all(found.at_goal(states)[-1] and not found.at_goal(states[:-1]).any() for states in walked)
    again = paths(found, starts, generator(1))
    assert any(not torch.equal(one, other) for one, other in zip(walked, again, strict=True))


def test_a_path_of_repeated_actions_has_a_state_for_each_step() -> None:
    task = tiny_task()
    found = plan(task.motion, BlockChecker(), task.reached, repeats=3)
    walked = paths(found, found.starts, generator())
    assert [len(states) - 1 for states in walked] == found.distance[found.start_rows].tolist()
    for states in walked:
        led = torch.stack(
            [found.motion.advance(states[:-1], action.expand(len(states) - 1)) for action in found.actions]
        )
        assert (led == states[1:]).all(2).any(0).all()
        assert found.at_goal(states)[-1] and not found.at_goal(states[:-1]).any()


def test_a_path_repeats_its_action_while_that_is_optimal() -> None:
    found = planar_plan()
    for states in far(4):
        taken = [_action(found, *pair) for pair in pairwise(states)]
        for state, before, now in zip(states[1:], taken, taken[1:], strict=False):
            assert before == now or not found.optimal(state[None])[0, before]


def _action(found: Plan, state: Tensor, ahead: Tensor) -> int:
    moved = found.motion.advance(state.expand(4, 3), found.actions)
    return int((moved - ahead).norm(dim=1).argmin())


def test_a_path_is_awkward_where_it_goes_backwards_comes_too_near_or_ends_too_soon() -> None:
    found = planar_plan()
    away = torch.tensor([[-0.9, 1.0, 0.0], [-0.65, 1.0, 0.0], [-0.4, 1.0, 0.0]])
    assert awkwardness(found, away) == 1.0  # it does not reach the goal
    there = torch.tensor([[0.5, 1.0, 0.0]])
    assert awkwardness(found, torch.cat([away, there])) == 0.0
    assert awkwardness(found, torch.cat([away.flip(0), there])) == pytest.approx(2 / 3)
    near = torch.tensor([[0.3, -0.1, math.pi / 2], [0.3, 0.15, math.pi / 2]])
    assert awkwardness(found, torch.cat([near, there])) == pytest.approx(2 / 3)
    assert awkwardness(found, torch.cat([near.flip(0), there])) == pytest.approx(2 / 3 + 1 / 2)


def test_paths_start_at_distances_that_are_spread_from_far_to_near() -> None:
    found = planar_plan()
    lengths = [found.cost_to_go(states[:1]).item() for states in far(8)]
    every = found.distance[found.start_rows].double()
    assert (every > lengths[0]).double().mean() < 0.1
    assert 0.2 < (every < lengths[-1]).double().mean() < 0.45
    assert all(first > second - 1 for first, second in pairwise(lengths))
    assert max(awkwardness(found, states) for states in far(8)) < 0.5


def test_the_candidate_path_with_the_lowest_penalty_is_taken() -> None:
    asked: list[float] = []

    def eastern(states: Tensor) -> float:
        asked.append(-states[0, 0].item())
        return asked[-1]

    chosen = far_paths(planar_plan(), 3, generator(), eastern)
    for number, states in enumerate(chosen):
        assert -states[0, 0].item() == min(asked[16 * number : 16 * number + 16])


def test_a_path_stops_where_the_plan_oscillates() -> None:
    found = planar_plan()

    def dithers(state: Tensor) -> Tensor:
        return (state[:, 2:] < 0.1) == torch.tensor([False, False, True, False])

    plan_that_errs = Plan(**vars(found))
    object.__setattr__(plan_that_errs, "optimal", dithers)
    (states,) = paths(plan_that_errs, torch.tensor([[-0.9, 1.0, 0.0]]), generator())
    assert len(states) <= 3


def test_emptiness_is_the_part_of_a_path_that_sees_nothing() -> None:
    found, robot = planar_plan(), tiny_robot()
    inside = torch.tensor([[0.5, 0.5, 0.0], [0.5, 0.75, 0.0]])
    outside = torch.tensor([[9.0, 9.0, 0.0], [9.0, 9.25, 0.0]])
    assert emptiness(found, inside, robot, tiny_renderer()) < 0.3
    assert emptiness(found, outside, robot, tiny_renderer()) == 1.0
    assert emptiness(found, torch.cat([inside, outside]), robot, tiny_renderer()) == pytest.approx(0.5, abs=0.15)


def test_a_steady_walk_follows_its_path_and_is_labelled_with_the_actions_taken() -> None:
    found = planar_plan()
    states = far(1)[0]
    walked = walk(found, tiny_robot(), states, STILL, generator())
    poses = walked.planar[:: STILL.frames].float()
    assert torch.allclose(poses[:, :2], states[: len(poses), :2], atol=1e-5)
    assert torch.allclose(walked.cameras.camera_to_world[:, 2, 3], torch.tensor(HEIGHT))
    for row, pair in enumerate(pairwise(states)):
        assert walked.allowed[STILL.frames * row, _action(found, *pair)], row


def test_a_frame_is_labelled_by_the_pose_of_its_camera_and_not_by_the_path() -> None:
    found = planar_plan()
    states = far(1)[0]
    hand = Hand(place=0.05, yaw_deg=12.0, pitch_deg=8.0, roll_deg=8.0)
    walked = walk(found, tiny_robot(), states, hand, generator(1))
    poses = walked.cameras.camera_to_world
    looks = poses[:, :3, :3] @ torch.tensor([0.0, 0.0, 1.0])
    seen_from = torch.stack([poses[:, 0, 3], poses[:, 1, 3], torch.atan2(looks[:, 1], looks[:, 0])], 1)
    assert torch.equal(walked.allowed, found.optimal(torch.cat([seen_from[:, :2], seen_from[:, 2:] % math.tau], 1)))
    steady = walk(found, tiny_robot(), states, STILL, generator(1))
    count = min(len(walked.allowed), len(steady.allowed))
    differ = (walked.allowed[:count] != steady.allowed[:count]).any(1).float().mean()
    assert 0.02 < differ < 0.9


def test_a_walk_ends_with_the_first_frame_at_the_goal() -> None:
    found = planar_plan()
    for seed, states in enumerate(far(3)):
        walked = walk(found, tiny_robot(), states, Hand(), generator(seed))
        assert torch.equal(walked.states, walked.planar.float())
        there = found.at_goal(walked.states)
        assert there[-1] and not there[:-1].any()
        assert not walked.allowed[there].any()


def test_a_walk_over_a_lattice_is_labelled_at_the_nearest_states() -> None:
    found = tiny_plan()
    (states,) = paths(found, found.starts[found.distance[found.start_rows].argmax()][None], generator())
    walked = walk(found, tiny_robot(), states, STILL, generator())
    assert torch.equal(walked.states[:: STILL.frames], states[: len(walked.states[:: STILL.frames])])
    away = (walked.planar - tiny_motion().planar(walked.states))[:, :2].norm(dim=1)
    assert 0 < away.max() <= 0.25 + 1e-6  # half a step
    assert torch.equal(walked.allowed, found.optimal(walked.states))


class Painter:
    """Paints each view with the height of its camera, at a depth of 1 m."""

    def render(self, cameras: Cameras, parts: Parts | None = None, only: Tensor | None = None) -> RenderOutput:
        shape = (len(cameras), cameras.height, cameras.width)
        level = cameras.camera_to_world[:, 2, 3].view(-1, 1, 1, 1)
        return RenderOutput(level.expand(*shape, 3), torch.ones(shape), torch.ones(shape))

    def pixels(self, cameras: Cameras, parts: Parts | None = None, only: Tensor | None = None) -> Tensor:
        return to_pixels(self.render(cameras, parts, only).rgb)


class Stand(TaskModule):
    """A task that places model 3 at each robot, and keeps a target in its memory."""

    def begin(self, state: Tensor, anywhere: Anywhere) -> Memory:
        return {"target": torch.tensor([0.7, 1.0, HEIGHT]).repeat(len(state), 1)}

    def parts(self, state: Tensor, memory: Memory) -> Parts:
        return Parts(torch.full((len(state), 1), 3), self.motion.body_to_world(state).unsqueeze(1))


def world(found: Plan, drawing: Drawing) -> World:
    """Return a world for recording walks, with little more than the plan, robot, task and drawing that they need."""
    gaussians = tiny_gaussians()
    return World(
        scene=Scene("room", gaussians, ((-1.0, -1.5, 0.0), (1.0, 1.5, 1.0))),
        occupancy=Occupancy.empty(),
        checker=BlockChecker(),
        drawing=drawing,
        robot=tiny_robot(),
        task=Stand(found.motion, 20),
        plan=found,
        make_transforms=list,
        device=torch.device("cpu"),
    )


def record(folder: Path, seed: int = 0, count: int = 2, drawing: Drawing | None = None, **options: Any) -> list[Path]:
    place = world(planar_plan(), drawing or SceneDrawing(Painter()))
    return record_walks(folder, place, count, seed, 24, **options)


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_recorded_walks_are_clips_in_the_shape_of_the_robots_image(tmp_path: Path) -> None:
    written = record(tmp_path / "new" / "clips")
    clips = read_clips(tmp_path / "new" / "clips", NAMES)
    assert [clip.source for clip in clips] == written
    for clip in clips:
        images = list(clip.images())
        assert {image.size for image in images} == {(32, 24)}
        assert 0.7 * len(images) < len(clip.labels) < len(images)  # frames at the goal have no label
        assert len(images) - 1 not in clip.labels


def test_a_seed_fixes_the_recorded_bytes_and_another_seed_changes_them(tmp_path: Path) -> None:
    for name, seed in (("a", 3), ("b", 3), ("c", 4)):
        record(tmp_path / name, seed)
    assert contents(tmp_path / "a") == contents(tmp_path / "b") != contents(tmp_path / "c")


class Photographs(SceneDrawing):
    """Draws everything in one grey, and records what it was asked to draw."""

    def __init__(self) -> None:
        super().__init__(Painter())
        self.asked: list[Shot] = []

    def draw(self, shot: Shot) -> View:
        self.asked.append(shot)
        size = (len(shot.cameras), shot.cameras.height, shot.cameras.width, 3)
        return View(torch.full(size, 200, dtype=torch.uint8), {})


def test_walks_are_drawn_by_the_worlds_drawing_with_the_tasks_memory_and_parts(tmp_path: Path) -> None:
    clear, drawing = Lens(exposure=0.0, tint=0.0, blur=0.0, noise=0.0), Photographs()
    record(tmp_path, drawing=drawing, lens=clear, hand=STILL)
    clips = read_clips(tmp_path, NAMES)
    for clip in clips:
        assert all((np.asarray(image) == 200).all() for image in clip.images())
    assert sum(len(shot.cameras) for shot in drawing.asked) == sum(len(list(clip.images())) for clip in clips)
    for cameras, memory, parts, *_ in drawing.asked:
        assert torch.equal(memory["target"], torch.tensor([0.7, 1.0, HEIGHT]).expand(len(cameras), 3))
        assert parts is not None and (parts.model == 3).all()
        places = parts.model_to_world[:, 0, :3, 3]
        assert torch.allclose(places, cameras.camera_to_world[:, :3, 3], atol=1e-5)


def test_a_walk_can_be_recorded_on_a_lattice(tmp_path: Path) -> None:
    record_walks(tmp_path, world(tiny_plan(), SceneDrawing(Painter())), count=1, height=12)
    (clip,) = read_clips(tmp_path, tiny_motion().action_names)
    assert len(clip.labels) > 10


def test_a_failed_recording_leaves_no_partial_clip(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match="no picture"):
        record(tmp_path, drawing=Broken(Painter()))
    assert list(tmp_path.iterdir()) == []
    record(tmp_path, count=1)
    with pytest.raises(ValueError, match="expected a new folder"):
        record(tmp_path, count=1)


class Broken(SceneDrawing):
    """Fails to draw."""

    def draw(self, shot: Shot) -> View:
        raise RuntimeError("no picture")


@pytest.mark.parametrize("motion", [DriveMotion(HEIGHT), OrbitMotion((0.0, 0.0, HEIGHT), elevation_deg=(0.0, 40.0))])
def test_a_motion_that_cannot_be_walked_is_refused(motion: PlannedMotion, tmp_path: Path) -> None:
    other = replace(planar_plan(), moves=replace(planar_plan().moves, motion=motion))
    refused = rf"expected a motion on the ground with named actions.*got {type(motion).__name__}"
    with pytest.raises(ValueError, match=refused):
        record_walks(tmp_path, world(other, SceneDrawing(Painter())))


def test_a_walk_needs_a_goal(tmp_path: Path) -> None:
    aimless = plan(planar_plan().motion, BlockChecker(), lambda state: None)
    with pytest.raises(ValueError, match="expected a task with goal states"):
        record_walks(tmp_path / "clips", world(aimless, SceneDrawing(Painter())))
    assert not (tmp_path / "clips").exists()


@pytest.mark.parametrize(("count", "height"), [(0, 24), (2, 0)])
def test_a_recording_without_clips_or_pixels_is_refused(count: int, height: int, tmp_path: Path) -> None:
    place = world(planar_plan(), SceneDrawing(Painter()))
    with pytest.raises(ValueError, match=rf"expected at least 1 clip and 1 pixel, got {count} and {height}"):
        record_walks(tmp_path, place, count, height=height)
