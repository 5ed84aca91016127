"""An episode ends where the physics of an action fails or the robot falls over, since it can no longer move."""

import math
from collections.abc import Callable

import pytest
import torch

from splatrl.envs.tasks import Drive, Outcome, PointNav, Push, Task
from splatrl.envs.tasks.base import Anywhere, Step
from splatrl.motions import PhysicsMotion
from tests.envs.tasks.courses import NOTHING
from tests.envs.tasks.test_gates import gates
from tests.envs.tasks.test_push import push
from tests.envs.tasks.test_route import route
from tests.envs.tasks.test_strides import task as strides
from tests.tiny import BlockChecker

FAST = 1e8
"""A velocity, in metres and radians per second, with which MuJoCo gives up."""


def pointnav() -> PointNav:
    task = PointNav(PhysicsMotion("wheels", "eye", threads=1), goals=2, test_goals=1, cell=0.1)
    task.choose_goals(BlockChecker())
    return task


@pytest.mark.parametrize(
    ("make", "outcome"),
    [
        (push, Outcome.OUT_OF_BOUNDS),
        (route, Outcome.OUT_OF_BOUNDS),
        (gates, Outcome.OUT_OF_BOUNDS),
        (pointnav, Outcome.OUT_OF_BOUNDS),
        (strides, Outcome.COLLISION),
    ],
)
def test_a_robot_whose_physics_fails_ends_its_episode(make: Callable[[], Task], outcome: Outcome) -> None:
    task = make()
    motion = task.motion
    assert isinstance(motion, PhysicsMotion)
    home = motion.placed(torch.tensor([[0.3, 0.2, 0.0]]).double()).expand(2, -1)
    anywhere = Anywhere(lambda: home, torch.Generator().manual_seed(0))
    before = home.clone() if isinstance(task, Push) else task.start(home.clone(), anywhere)
    memory = task.begin(before, anywhere)
    for columns in (motion.layout.velocity, motion.layout.angular_velocity):
        before[0, columns] = FAST
    action = torch.zeros(2, *motion.action_spec.shape)
    if isinstance(task, PointNav):
        action[:] = motion.limits[1]  # zero velocities would be a stop
    move = motion.move(before, action, NOTHING)
    assert torch.equal(move.state[0], before[0]) and move.failed.tolist() == [True, False]
    verdict = task.judge(Step(before, action, move, memory), anywhere)
    assert verdict.terminated[0].item() and verdict.outcome[0].item() == outcome
    assert verdict.reward[0].abs() < 100 and verdict.outcome[1].item() == Outcome.RUNNING


def drive() -> Drive:
    return Drive(PhysicsMotion("wheels", "eye", threads=1), (0.9, 0.9, 0.0))


def fly_to_a_pose() -> Drive:
    return Drive(PhysicsMotion("quadrotor", "eye", linear=(0.0, 1.0), angular_deg=90.0, threads=1), (0.9, 0.9, 0.0))


@pytest.mark.parametrize(
    ("make", "outcome"),
    [
        (push, Outcome.OUT_OF_BOUNDS),
        (pointnav, Outcome.COLLISION),
        (drive, Outcome.COLLISION),
        (route, Outcome.COLLISION),
        (gates, Outcome.COLLISION),
        (fly_to_a_pose, Outcome.COLLISION),
    ],
)
def test_a_robot_that_lies_on_its_side_ends_its_episode(make: Callable[[], Task], outcome: Outcome) -> None:
    task = make()
    motion = task.motion
    assert isinstance(motion, PhysicsMotion)
    home = motion.placed(torch.tensor([[0.6, 0.2, 0.0]]).double()).repeat(2, 1)
    home[:, motion.layout.position][:, 2] = motion.terrain.height(home[:, motion.layout.position][:, :2]) + 0.1
    anywhere = Anywhere(lambda: home, torch.Generator().manual_seed(0))
    before = home.clone()
    memory = task.begin(before, anywhere)
    tilt = math.radians(30.0)
    before[:, motion.layout.orientation] = torch.tensor(
        [
            [math.cos(tilt + 0.03), math.sin(tilt + 0.03), 0.0, 0.0],
            [math.cos(tilt - 0.03), math.sin(tilt - 0.03), 0.0, 0.0],
        ]
    ).double()
    move = motion.moved(before, torch.zeros(2, 1, motion.physics.model.nsensordata), torch.ones(2, dtype=torch.bool))
    verdict = task.judge(Step(home, motion.limits[1].expand(2, -1), move, memory), anywhere)
    assert verdict.terminated.flatten().tolist() == [True, False]
    assert verdict.outcome.flatten().tolist() == [outcome, Outcome.RUNNING]
    if isinstance(task, PointNav):
        assert verdict.memory["collisions"].flatten().tolist() == [1, 0]
        stopped = task.judge(Step(home, torch.zeros(2, 2), move, memory), anywhere)
        assert stopped.outcome.flatten().tolist() == [Outcome.COLLISION, Outcome.STOPPED]
        task.success_distance = 1e6  # now both stop at their goal
        stopped = task.judge(Step(home, torch.zeros(2, 2), move, memory, torch.zeros(0)), anywhere)
        assert stopped.outcome.flatten().tolist() == [Outcome.COLLISION, Outcome.GOAL]
        assert (stopped.reward - verdict.reward).flatten().tolist() == pytest.approx([0.0, task.rewards.success])


def test_a_quadrotor_may_take_any_attitude_in_the_air() -> None:
    motion = gates().motion
    state = motion.placed(torch.zeros(3, 3).double())
    state[1:, motion.layout.orientation] = torch.tensor([0.0, 1.0, 0.0, 0.0]).double()  # upside down
    state[:, motion.layout.position][:, 2] = motion.terrain.height(torch.zeros(3, 2).double())
    state[:, motion.layout.position][:, 2] += torch.tensor([0.11, 0.11, 0.13]).double()  # its hull has a radius of 0.12
    assert motion.fallen(state).tolist() == [False, True, False]
