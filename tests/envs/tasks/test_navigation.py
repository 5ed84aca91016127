"""Point-goal and image-goal navigation: episodes and measures worked out by hand."""

import math
import warnings
from collections.abc import Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import EnvBase
from torchrl.envs.utils import check_env_specs

import splatrl
from splatrl.bodies import Sphere
from splatrl.collision import NativeChecker, Occupancy
from splatrl.curriculum import Curriculum, Plan, plan
from splatrl.curriculum.geodesics import Geodesics
from splatrl.envs import Robot, SplatEnv
from splatrl.envs.drawing import SceneDrawing
from splatrl.envs.sensors import Gps, ImageGoal, PointGoal
from splatrl.envs.tasks import ImageNav, NavigationRewards, NavigationTask, Outcome, PointNav
from splatrl.envs.tasks.imagenav import LOST
from splatrl.evaluation.recording import record_episodes
from splatrl.evaluation.rollouts import Episodes, knowing, run_episodes
from splatrl.experiments.generalise import beeline
from splatrl.geometry import wrapped
from splatrl.motions import DriveMotion, ForwardMotion, NavigateMotion, Site
from splatrl.renderers import NoRenderer, Renderer
from tests.tiny import BLOCK, HEIGHT, tiny_overrides, tiny_renderer

BOUNDS: dict[str, Any] = {"lower": (-1.0, -1.5), "upper": (1.0, 1.5), "spacing": 0.25, "headings": 4}
STOP, FORWARD, LEFT, RIGHT = range(4)
REWARDS = NavigationRewards(progress=1.0, slack=-0.01, success=2.5)
FEW: dict[str, Any] = {"goals": 8, "test_goals": 4, "nearest": 0.3, "farthest": 9.0, "max_steps": 12}


@cache
def checker() -> NativeChecker:
    block = Occupancy.from_boxes([[-BLOCK, -BLOCK, 0.0]], [[BLOCK, BLOCK, 1.0]], 0.05)
    return NativeChecker(block, Sphere(0.1))


def task_of(kind: type[NavigationTask] = PointNav, sliding: bool = False, **settings: Any) -> NavigationTask:
    motion = NavigateMotion(HEIGHT, step=0.25, angle_step_deg=90.0, sliding=sliding, **BOUNDS)
    task = kind(motion, REWARDS, **(FEW | settings))
    task.choose_goals(checker())
    return task


@cache
def paths() -> Plan:
    task = task_of()
    return plan(task.motion, checker(), task.reached)


def env_of(
    task: NavigationTask, batch: tuple[int, ...] = (1,), seed: int = 0, renderer: Renderer | None = None
) -> SplatEnv:
    robot = Robot(Sphere(0.1), HEIGHT, image_width=16, image_height=12)
    sensors = {"gps": Gps(), "pointgoal_with_gps_compass": PointGoal()}
    if isinstance(task, ImageNav):
        sensors = {"imagegoal": ImageGoal()}
    curriculum = Curriculum(paths(), None)
    drawing = SceneDrawing(renderer or tiny_renderer())
    return SplatEnv(drawing, checker(), robot, task, curriculum, batch, seed, sensors=sensors)


def begin(env: SplatEnv, state: list[float], goal: list[float]) -> TensorDict:
    """Begin an episode of one robot from a state to a goal, which is added to the task's goals."""
    task = env.task
    task.geodesics, rows = task.geodesics.with_goals(np.array([goal[:2]]), np.zeros(1, np.int64))
    start = torch.tensor([state])
    memory = task.episode(start, rows, torch.tensor([goal[2:]]))
    return env.reset(TensorDict({"state": start, **memory}, [1]), set_state=True)


def walk(env: EnvBase, td: TensorDict, actions: Sequence[Any]) -> list[TensorDict]:
    """Take a sequence of actions and return the result of each."""
    after = []
    for action in actions:
        step = env.step(td.set("action", torch.tensor([action])))
        after.append(step["next"])
        td = env.step_mdp(step)
    return after


def test_an_episode_that_turns_walks_and_stops_matches_hand_calculation() -> None:
    env = env_of(task_of())
    td = begin(env, [0.75, -1.0, 0.0], [0.75, 0.0, 0.0])  # one metre to the left
    assert td["distance_to_goal"] == td["start_distance"] == pytest.approx(1.0, abs=1e-5)
    torch.testing.assert_close(td["pointgoal_with_gps_compass"], torch.tensor([[1.0, math.pi / 2]]))
    after = walk(env, td, [LEFT, FORWARD, FORWARD, FORWARD, FORWARD, STOP])
    rewards = [float(one["reward"]) for one in after]
    assert rewards == pytest.approx([-0.01, 0.24, 0.24, 0.24, 0.24, 2.49], abs=1e-4)
    assert [int(one["outcome"]) for one in after] == [Outcome.RUNNING] * 5 + [Outcome.GOAL]
    assert [bool(one["terminated"]) for one in after] == [False] * 5 + [True]
    last = after[-1]
    assert bool(last["success"]) and float(last["path_length"]) == pytest.approx(1.0, abs=1e-5)
    torch.testing.assert_close(last["gps"], torch.tensor([[0.0, -1.0]]), atol=1e-5, rtol=0)
    torch.testing.assert_close(after[0]["pointgoal_with_gps_compass"], torch.tensor([[1.0, 0.0]]), atol=1e-6, rtol=0)


@pytest.mark.parametrize(("walked", "reached"), [(3, False), (4, True)])
def test_a_stop_succeeds_only_within_the_success_distance(walked: int, reached: bool) -> None:
    env = env_of(task_of())
    td = begin(env, [0.75, -1.0, math.pi / 2], [0.75, 0.0, 0.0])
    last = walk(env, td, [FORWARD] * walked + [STOP])[-1]
    assert bool(last["terminated"]) and bool(last["success"]) is reached
    assert int(last["outcome"]) == (Outcome.GOAL if reached else Outcome.STOPPED)


def test_the_distance_that_counts_is_that_of_the_path_around_obstacles() -> None:
    env = env_of(task_of(success_distance=0.75))
    td = begin(env, [-0.35, 0.0, 0.0], [0.35, 0.0, 0.0])  # 0.7 m through the block, farther around it
    assert float(td["distance_to_goal"]) > 0.9
    assert int(walk(env, td, [STOP])[-1]["outcome"]) == Outcome.STOPPED


def test_a_blocked_robot_stays_counts_a_collision_and_goes_on() -> None:
    env = env_of(task_of())
    td = begin(env, [0.5, 0.0, math.pi], [0.75, 1.0, 0.0])  # looking at the block
    after = walk(env, td, [FORWARD, FORWARD, RIGHT, FORWARD])
    assert [int(one["collisions"]) for one in after] == [1, 2, 2, 2]
    assert [int(one["outcome"]) for one in after] == [Outcome.COLLISION] * 2 + [Outcome.RUNNING] * 2
    assert not any(bool(one["done"]) for one in after)
    assert torch.equal(after[1]["state"], td["state"]) and float(after[1]["path_length"]) == 0.0
    edge = walk(env, begin(env, [1.0, 1.0, 0.0], [0.75, 0.0, 0.0]), [FORWARD])[-1]  # out of the bounds
    assert int(edge["collisions"]) == 1 and not bool(edge["done"])


def test_a_sliding_robot_moves_along_the_obstacle_it_touches() -> None:
    state, action = torch.tensor([[0.4, 0.0, 0.75 * math.pi], [0.4, 0.0, math.pi]]), torch.tensor([FORWARD, FORWARD])
    stays = task_of().motion.move(state, action, checker())
    slides = task_of(sliding=True).motion.move(state, action, checker())
    assert torch.equal(stays.state, state)
    along = 0.25 / math.sqrt(2)
    torch.testing.assert_close(slides.state[0], torch.tensor([0.4, along, 0.75 * math.pi]))
    torch.testing.assert_close(slides.state[1], state[1], atol=1e-6, rtol=0)  # straight into the wall
    assert torch.equal(slides.free_fraction, stays.free_fraction) and (slides.free_fraction < 1).all()


def test_an_episode_without_a_stop_is_truncated() -> None:
    env = env_of(task_of(max_steps=3))
    last = walk(env, begin(env, [0.75, -1.0, 0.0], [0.75, 0.0, 0.0]), [LEFT, RIGHT, LEFT])[-1]
    assert bool(last["truncated"]) and int(last["outcome"]) == Outcome.TIMEOUT and not bool(last["success"])


def test_a_drive_stops_when_both_velocities_are_small() -> None:
    motion = DriveMotion(HEIGHT, linear=(-0.25, 0.5), angular_deg=90.0)
    small, turn = 0.049, 0.09 * math.pi / 2
    actions = torch.tensor([[small, 0.0], [0.06, 0.0], [0.0, turn], [0.0, 0.2], [-small, -turn], [-0.1, 0.0]])
    assert motion.stops(actions).tolist() == [True, False, True, False, True, False]


def episodes(success: list[bool], far: list[float], start: list[float], path: list[float], hits: list[int]) -> Episodes:
    count = len(success)
    zeros = torch.zeros(count, dtype=torch.int64)
    measures = {"distance_to_goal": far, "start_distance": start, "path_length": path}
    named = {key: torch.tensor(values) for key, values in measures.items()} | {"collisions": torch.tensor(hits)}
    return Episodes(zeros, zeros, zeros, zeros.float(), zeros, torch.tensor(success), None, named)


def test_navigation_measures_match_those_worked_out_by_hand() -> None:
    # The shortest path; a path twice as long; a stop half way; one that went away; one stopped near the goal.
    found = episodes(
        [True, True, False, False, True],
        [0.1, 0.0, 2.0, 5.0, 0.15],
        [4.0, 3.0, 4.0, 4.0, 1.0],
        [3.9, 6.0, 2.0, 1.0, 0.9],
        [0, 3, 1, 0, 1],
    ).navigation()
    soft = [0.975, 0.5, 0.5, 0.0, 0.85]
    assert found == pytest.approx(
        {
            "success": 3 / 5,
            "spl": (1.0 + 0.5 + 0.0 + 0.0 + 1.0) / 5,
            "soft_spl": sum(soft) / 5,
            "distance_to_goal": 7.25 / 5,
            "collisions": 1.0,
        }
    )


def test_an_episode_that_begins_at_its_goal_has_the_shortest_path_if_it_ends_there_at_once() -> None:
    for path, ratio in ((0.0, 1.0), (0.5, 0.0)):
        found = episodes([True], [0.0], [0.0], [path], [0]).navigation()
        assert found["spl"] == found["soft_spl"] == ratio
    assert episodes([False], [0.0], [0.0], [0.0], [0]).navigation()["spl"] == 0.0


def test_other_tasks_have_no_navigation_measures() -> None:
    zeros = torch.zeros(2, dtype=torch.int64)
    assert Episodes(zeros, zeros, zeros, zeros.float(), zeros, zeros.bool()).navigation() == {}


def test_run_episodes_begins_each_episode_with_its_own_goal_and_fresh_sensors() -> None:
    task = task_of(max_steps=40)
    drawn = task.episodes(paths().starts, 5, seed=3)
    state = drawn.pop("state")

    def towards(td: TensorDict) -> TensorDict:
        """Turn to the goal, go there by quarter turns, and stop near it."""
        assert (td["gps"][td["step_count"].squeeze(1) == 0] == 0.0).all()  # the sensors' memory is reset too
        rho, phi = td["pointgoal_with_gps_compass"].unbind(1)
        action = torch.where(phi.abs() <= math.pi / 4 + 1e-4, FORWARD, torch.where(phi > 0, LEFT, RIGHT))
        return td.set("action", torch.where(rho < 0.15, STOP, action))

    found = run_episodes(env_of(task, (3,)), towards, state, memory=drawn)
    alone = []
    for row in torch.arange(5).split(1):
        memory = {key: value[row] for key, value in drawn.items()}
        alone.append(run_episodes(env_of(task, (1,)), towards, state[row], memory=memory))
    for key, values in found.measures.items():
        assert torch.allclose(values, torch.cat([one.measures[key] for one in alone]), atol=1e-5), key
    assert torch.equal(found.measures["start_distance"], drawn["start_distance"].squeeze(1))
    assert torch.equal(found.length, torch.cat([one.length for one in alone]))
    assert found.success.any()


def test_episodes_for_testing_are_seeded_and_have_their_own_goals() -> None:
    task = task_of()
    one, again, other = (task.episodes(paths().starts, 20, seed) for seed in (1, 1, 2))
    assert all(torch.equal(one[key], again[key]) for key in one)
    assert not torch.equal(one["state"], other["state"])
    assert (one["goal_row"] >= 8).all() and (one["start_distance"] >= 0.3).all()
    with pytest.raises(ValueError, match=r"expected 20 pairs of a start and a goal .* found only \d+"):
        task_of(nearest=task.geodesics.longest).episodes(paths().starts[:3], 20, 1)


def test_episodes_are_given_only_from_starts_with_a_path_to_their_goal() -> None:
    fence = Occupancy.from_boxes([[-1.5, -0.95, 0.0]], [[1.5, -0.85, 1.0]], 0.05)
    task = task_of()
    task.choose_goals(NativeChecker(fence, Sphere(0.1)))
    state, goal = torch.tensor([[0.5, 1.0, 0.0], [0.51, -0.74, 0.0], [-0.5, -1.2, 0.0]]), torch.zeros(3, 3)
    _, memory = task.with_goals(state[:2], goal[:2], torch.zeros(2, dtype=torch.int64))
    assert memory["start_distance"].flatten().tolist() == pytest.approx([1.25**0.5, 0.9], abs=0.03)
    message = r"^episode 2: expected a start from which its goal can be reached, got \[-0\.5, -1\.2\]$"
    with pytest.raises(ValueError, match=message):
        task.with_goals(state, goal, torch.zeros(3, dtype=torch.int64))


def test_goals_that_are_given_stay_where_they_are_and_distances_lead_to_the_nearest_node() -> None:
    state, goal = torch.tensor([[-0.8, 1.0, 0.0]]).expand(2, 3), torch.tensor([[0.523, 1.018, 1.2], [0.5, 1.0, 1.2]])
    task, memory = task_of().with_goals(state, goal, torch.zeros(2, dtype=torch.int64))
    assert torch.equal(memory["goal"], goal) and memory["goal_row"].unique().numel() == 1
    assert memory["start_distance"].flatten().tolist() == pytest.approx([1.3, 1.3], abs=1e-5)
    td = env_of(task, (2,)).reset(TensorDict({"state": state, **memory}, [2]), set_state=True)
    told = torch.tensor([[math.hypot(1.323, 0.018), math.atan2(0.018, 1.323)], [1.3, 0.0]])
    torch.testing.assert_close(td["pointgoal_with_gps_compass"], told, atol=1e-5, rtol=0)


def test_a_nearest_distance_beyond_the_longest_path_is_refused() -> None:
    longest = task_of().geodesics.longest
    assert 3 < longest < 9
    task_of(nearest=longest)
    with pytest.raises(ValueError, match=rf"task\.nearest: expected at most {longest:.2f} m, .* got 50"):
        task_of(nearest=50.0, farthest=60.0)


def test_imagenav_shows_what_is_seen_from_the_goal_pose() -> None:
    env = env_of(task_of(ImageNav, success_distance=1.0), (3,))
    check_env_specs(env, seed=0)
    td = env.reset()
    there = torch.cat([td["goal"][:, :2], td["goal"][:, 2:] % math.tau], 1)
    seen = env.reset(TensorDict({"state": there}, [3]), set_state=True)["pixels"]
    assert torch.equal(td["imagegoal"], seen)
    batch = env.rollout(5, break_when_any_done=False)
    goes_on = ~batch["next", "done"][:, :, 0]
    assert torch.equal(batch["imagegoal"][goes_on], batch["next", "imagegoal"][goes_on])


def test_a_recording_keeps_the_image_of_its_goal() -> None:
    env = env_of(task_of(ImageNav, success_distance=1.0))
    begun = env.reset().select("state", *env.task.memory_spec)
    shown = env.reset(begun.clone(), set_state=True)["imagegoal"][0]
    memory = dict(begun.select(*env.task.memory_spec).items())
    stop = torch.full((1,), STOP)
    (one,) = record_episodes(env, lambda td: td.set("action", stop), begun["state"], memory=memory)
    assert one.goal_image is not None and torch.equal(one.goal_image, shown)


@pytest.mark.parametrize("task", ["pointnav", "imagenav"])
@pytest.mark.parametrize("motion", ["navigate", "drive"])
def test_the_configured_tasks_keep_their_specs(task: str, motion: str, tmp_path) -> None:
    given = [*tiny_overrides(tmp_path, task), "task.goals=5", "task.test_goals=3", "task.nearest=0.3"]
    env = splatrl.make_env([*given, f"motion@task.motion={motion}", "robot.body.radius=0.1"], [3])
    check_env_specs(env, seed=0)
    env.set_seed(5)
    first = env.reset()
    env.set_seed(5)
    assert torch.equal(first["goal"], env.reset()["goal"])


def test_episodes_begin_only_where_a_training_goal_is_in_range(tmp_path: Path) -> None:
    given = [*tiny_overrides(tmp_path, "pointnav"), "task.goals=2", "task.test_goals=3", "robot.body.radius=0.1"]
    env = splatrl.make_env([*given, "task.nearest=1.0", "task.farthest=1.2"], [64])
    far = env.reset()["start_distance"]
    assert far.min() >= 1.0 and far.max() <= 1.2
    with pytest.raises(ValueError, match=r"expected free poses, .*; try other values of task\.nearest, task\.far"):
        splatrl.make_env([*given, "task.nearest=1.0001", "task.farthest=1.0002"])


@pytest.mark.parametrize(
    ("change", "warned"),
    [
        (["task.motion.step=0.39"], False),
        (["task.motion.step=0.4"], True),
        (["task.success_distance=0.1"], True),
        (["transforms/skip=four"], True),
        (["task.success_distance=0.02", "motion@task.motion=drive"], False),  # which can take shorter steps
    ],
)
def test_steps_so_long_that_robots_may_step_over_a_goal_are_warned_of(
    change: list[str], warned: bool, tmp_path: Path
) -> None:
    given = [*tiny_overrides(tmp_path, "pointnav"), "task.goals=2", "task.test_goals=3", "robot.body.radius=0.1"]
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        splatrl.make_env([*given, *change])
    assert any("task.motion.step: robots may step over a goal unless" in str(one.message) for one in told) is warned


@pytest.mark.parametrize(("radius", "warned"), [(0.01, True), (0.0249, True), (0.025, False)])
def test_distances_through_thin_walls_are_warned_of(radius: float, warned: bool) -> None:
    """A lane leads round the end of a wall one voxel thick, 1.5 m away; the goal is behind the wall."""
    body = Sphere(radius)
    wall = Occupancy.from_boxes([[0.0, -2.0, 0.0]], [[0.05, 1.0, 1.0]], 0.05)
    motion = NavigateMotion(HEIGHT, lower=(-1.0 + 0.04 - radius, -1.5), upper=(1.0, 1.5))
    task, nothing = PointNav(motion, goals=2, test_goals=1), cast(Any, None)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        task.settle(Site(nothing, wall, NativeChecker(wall, body), body, True), lambda poses: poses[:, 0, 0] < 2.0)
    assert any("task.cell: distances beside a wall" in str(one.message) for one in told) is warned
    place, goal = torch.tensor([[0.051 + radius, -0.5]]), np.array([[-0.31, -0.5]])
    geodesics, row = task.geodesics.with_goals(goal, np.array([0]))
    assert warned or float(geodesics.distance(place, row)) > 3.0


def test_a_motion_that_cannot_stop_is_refused() -> None:
    with pytest.raises(ValueError, match=r"task\.motion: expected a motion that can stop"):
        PointNav(ForwardMotion(HEIGHT))  # type: ignore[arg-type]


def walked(task: NavigationTask, who: Any) -> Episodes:
    """Run test episodes of the task in which ``who`` chooses the actions from state and memory."""
    env = env_of(task, (24,), renderer=NoRenderer(None))  # no view is needed
    begun = task.episodes(paths().starts, 24, 0)
    return run_episodes(env, knowing(env, who), begun.pop("state"), memory=begun)


@pytest.mark.parametrize("motion", ["steps", "drive"])
def test_the_teacher_finds_the_way_around_obstacles_and_the_beeline_does_not(motion: str) -> None:
    task = task_of(max_steps=90)
    if motion == "drive":
        task = PointNav(DriveMotion(HEIGHT, **BOUNDS), REWARDS, **(FEW | {"max_steps": 90}))
        task.choose_goals(checker())
    taught, straight = walked(task, task.teach), walked(task, partial(beeline, task))
    assert taught.success.all()
    assert taught.navigation()["spl"] > (0.7 if motion == "steps" else 0.9)  # with turns of 90°, paths have corners
    assert taught.measures["collisions"].sum() == 0
    assert 0.2 < straight.success.double().mean() < 0.9
    stuck = straight.outcome == Outcome.TIMEOUT
    assert (straight.measures["collisions"][stuck] > 50).all()


def test_memory_counts_the_steps_since_a_robot_last_faced_as_the_goal_image_does() -> None:
    env = env_of(task_of(ImageNav, success_distance=1.0))
    td = begin(env, [-0.75, 1.25, 0.0], [0.75, 1.25, math.pi - 0.7])  # with turns of 90°, 45° is as near as it gets
    assert td["unseen"].item() > LOST
    assert [one["unseen"].item() for one in walk(env, td, [LEFT, LEFT, FORWARD, LEFT])] == [LOST + 2, 0, 0, 1]
    assert begin(env, [-0.75, 1.25, math.pi], [0.75, 1.25, math.pi])["unseen"].item() == 0


@pytest.mark.parametrize("motion", ["steps", "drive"])
def test_the_image_goal_teacher_looks_around_before_it_goes_and_before_it_stops(motion: str) -> None:
    task = task_of(ImageNav, success_distance=0.5, max_steps=200)
    if motion == "drive":
        task = ImageNav(DriveMotion(HEIGHT, **BOUNDS), REWARDS, **(FEW | {"success_distance": 0.5, "max_steps": 200}))
        task.choose_goals(checker())
    seen: list[tuple[torch.Tensor, ...]] = []

    def who(state: torch.Tensor, memory: Any) -> torch.Tensor:
        action = task.teach(state, memory)
        aside = wrapped(memory["goal"][:, 2] - state[:, 2]).abs()
        seen.append((aside, memory["unseen"].squeeze(1), task.motion.stops(action), action))
        return action

    found = walked(task, who)
    assert found.success.all() and found.navigation()["spl"] > 0.7
    aside, unseen, stops, action = (torch.cat(column) for column in zip(*seen, strict=True))
    assert task.lost_after == (40 if motion == "drive" else LOST)
    lost = unseen >= task.lost_after
    assert lost.any() and (unseen[stops] == 0).all()
    assert (aside[stops] <= 0.5 * task.motion.angle_between + 1e-3).all()
    if motion == "steps":
        assert (action[lost] == LEFT).all() and (action[~lost] == FORWARD).any()


def test_a_teacher_of_robots_that_turn_by_any_angle_chooses_directions_that_do_not_depend_on_their_heading() -> None:
    task = PointNav(DriveMotion(HEIGHT, **BOUNDS), REWARDS, **FEW)
    task.choose_goals(checker())
    yaw = torch.tensor([0.93, 0.95, 0.99, 1.03])
    state = torch.cat([torch.tensor([[-0.75, 1.25]]).expand(4, 2), yaw.unsqueeze(1)], 1)
    turn, _ = task.led(state, task.episode(state, torch.zeros(4, dtype=torch.int64), torch.zeros(4, 1)))
    torch.testing.assert_close(turn + yaw, (turn + yaw)[:1].expand(4), atol=1e-5, rtol=0)


def test_the_teacher_of_several_scenes_heads_for_each_scenes_own_goal() -> None:
    task = task_of()
    both = task_of()
    both._modules = {**both._modules, "geodesics": Geodesics.joined([task.geodesics, task.geodesics])}
    begun = task.episodes(paths().starts, 8, 0)
    state = begun.pop("state")
    other = {**begun, "goal_row": begun["goal_row"] + both.geodesics.begins[1]}
    assert torch.equal(task.teach(state, begun), both.teach(state, other))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda memory: memory.pop("goal_row"), "goal, .*: expected goal_row along with it, found none"),
        (
            lambda memory: memory.update(goal_row=torch.tensor([[99]])),
            r"goal_row: expected torch.int64 \[B, 1\] from 0 to",
        ),
        (lambda memory: memory.update(goal_row=torch.tensor([[-1]])), "goal_row: expected .* between -1 and -1"),
        (lambda memory: memory.update(goal=memory["goal"].double()), r"goal: expected torch.float32 \[B, 3\], got"),
        (lambda memory: memory.update(goal=memory["goal"][:, :2]), r"goal: expected .* got torch.float32 \[1, 2\]"),
    ],
)
def test_a_given_goal_that_is_incomplete_or_invalid_is_refused(change: Any, message: str) -> None:
    env = env_of(task_of())
    begun = env.reset()
    memory = {key: begun[key] for key in env.task.memory_spec}
    env.reset(TensorDict({"state": begun["state"], **memory}, [1]), set_state=True)
    change(memory)
    with pytest.raises(ValueError, match=message):
        env.reset(TensorDict({"state": begun["state"], **memory}, [1]), set_state=True)
