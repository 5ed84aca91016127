"""The pathfinder leads robots through lanes that are hardly wider than they are."""

import math
from typing import Any

import pytest
import torch
from torch import Tensor

from splatrl.bodies import Body, Box, Sphere
from splatrl.collision import NativeChecker, Occupancy
from splatrl.envs.tasks import ImageNav, NavigationTask, PointNav
from splatrl.envs.tasks.base import Anywhere, Step
from splatrl.envs.tasks.imagenav import LOST
from splatrl.motions import DriveMotion, NavigateMotion
from splatrl.motions.base import Move
from splatrl.motions.planar import StoppingMotion

BOUNDS: dict[str, Any] = {"lower": (-1.0, -1.2), "upper": (1.0, 1.2), "spacing": 0.1, "headings": 5}
BOX = Box((0.36, 0.36, 0.2))
HALF_WIDTH = 0.3
"""Half the width of a lane, metres, in which the body fits at every heading at a single row of nodes."""


def beside_a_lane(body: Body, motion: StoppingMotion, kind: type[NavigationTask] = PointNav) -> NavigationTask:
    """Make a task in two areas that a lane along y connects, 0.5 m long."""
    walls = Occupancy.from_boxes(
        [[-1.5, -0.25, 0.0], [HALF_WIDTH, -0.25, 0.0]], [[-HALF_WIDTH, 0.25, 1.0], [1.5, 0.25, 1.0]], 0.05
    )
    task = kind(motion, goals=4, test_goals=16, nearest=0.5)
    task.choose_goals(NativeChecker(walls, body))
    return task


def through_the_lane(task: NavigationTask, count: int) -> tuple[Tensor, dict[str, Tensor]]:
    """Return free starts and the memory of episodes whose goals are on the other side."""
    ground, motion = task.geodesics.grounds[0], task.motion
    starts = motion.states()
    free = ~ground.checker.collides(motion.body_to_world(starts)) & ground.connected(starts[:, :2])
    begun = task.episodes(starts[free], 20 * count, 0)
    other = (begun["state"][:, 1] * begun["goal"][:, 1] < 0).nonzero().squeeze(1)[:count]
    assert len(other) == count
    memory = {key: value[other] for key, value in begun.items()}
    return memory.pop("state"), memory


@pytest.mark.parametrize(("body", "motion"), [(BOX, NavigateMotion), (BOX, DriveMotion), (Sphere(0.252), DriveMotion)])
def test_robots_get_through_a_narrow_lane_and_touch_nothing(
    body: Body, motion: type[NavigateMotion | DriveMotion]
) -> None:
    task = beside_a_lane(body, motion(0.5, **BOUNDS))
    state, memory = through_the_lane(task, 12)
    row, walking = memory["goal_row"].squeeze(1), torch.ones(12, dtype=torch.bool)
    for _ in range(100):
        if not walking.any():
            break
        action = task.teach(state, memory)
        move = task.motion.move(state, action, task.geodesics.grounds[0].checker)
        assert ((move.free_fraction == 1) & move.inside)[walking].all()
        walking &= ~task.motion.stops(action)
        state = torch.where(walking.unsqueeze(1), move.state, state)
    assert not walking.any()
    assert (task.geodesics.distance(state[:, :2], row) < task.success_distance).all()


def test_the_direction_depends_on_the_robot_alone() -> None:
    task = beside_a_lane(BOX, NavigateMotion(0.5, **BOUNDS))
    state, memory = through_the_lane(task, 12)
    state[:, 0], state[:, 1] = 0.01 * torch.linspace(-1.0, 1.0, 12), torch.linspace(-0.4, 0.4, 12)
    turn, _ = task.led(state, memory)
    alone = [task.led(state[[i]], {key: value[[i]] for key, value in memory.items()})[0] for i in range(12)]
    assert torch.equal(turn, torch.cat(alone))
    assert turn.unique().numel() > 4 and (turn.abs() <= math.pi).all()


def test_the_image_goal_teacher_does_not_look_around_where_the_body_may_not_fit_at_every_heading() -> None:
    task = beside_a_lane(BOX, NavigateMotion(0.5, **BOUNDS), ImageNav)
    _, memory = through_the_lane(task, 12)
    memory["unseen"] = torch.full_like(memory["unseen"], LOST)
    ahead = memory["goal"][:, 1].sign()  # the lane leads along y
    in_the_lane = torch.stack([torch.full((12,), 0.02), torch.zeros(12), 0.5 * math.pi * ahead], 1)
    in_the_open = in_the_lane + torch.stack([torch.zeros(12), -0.8 * ahead, torch.zeros(12)], 1)
    stop, forward, left = range(3)
    assert set(task.teach(in_the_lane, memory).tolist()) <= {stop, forward}  # some goals are in the lane
    assert task.teach(in_the_open, memory).tolist() == [left] * 12


def test_the_image_goal_teacher_goes_on_if_looking_around_takes_it_to_and_fro_where_it_may_not_fit() -> None:
    task = beside_a_lane(BOX, NavigateMotion(0.5, **BOUNDS), ImageNav)
    assert isinstance(task, ImageNav) and (task.lost_after, task.around) == (LOST, 24)
    _, memory = through_the_lane(task, 2)
    ahead = memory["goal"][:, 1].sign()
    memory["goal"][:, 2] = -0.5 * math.pi * ahead  # behind the robots, which never get to see it
    narrow = torch.stack([torch.full((2,), 0.02), torch.zeros(2), 0.5 * math.pi * ahead], 1)
    wide = narrow + torch.stack([torch.zeros(2), -0.8 * ahead, torch.zeros(2)], 1)
    memory["unseen"] = torch.full_like(memory["unseen"], LOST)
    anywhere, looked, waited = Anywhere(lambda: wide, torch.Generator()), [], []
    for _ in range(2 * (LOST + task.around)):
        for state, after in ((wide, narrow), (narrow, wide)):
            action = task.teach(state, memory)
            move = Move(after, task.motion.body_to_world(after), torch.ones(2), torch.ones(2, dtype=torch.bool))
            before = memory["unseen"]
            memory = dict(task.judge(Step(state, action, move, memory), anywhere).memory or {})
            (looked if state is wide else waited).append(
                (action == 2).all().item() if state is wide else torch.equal(memory["unseen"], before)
            )
    goes_on = looked.index(False)
    assert goes_on == task.around and waited[:goes_on].count(True) >= goes_on - 1
    assert looked[goes_on : goes_on + LOST // 2] == [False] * (LOST // 2) and looked[goes_on + LOST // 2]
    near = torch.cat([memory["goal"][:, :2], 0.5 * math.pi * ahead[:, None]], 1)
    assert task.teach(near, {**memory, "unseen": torch.full_like(memory["unseen"], LOST + task.around)}).tolist() == [
        0,
        0,
    ]
