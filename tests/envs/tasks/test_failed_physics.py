"""An episode ends where the physics of an action fails, since its robot can no longer move."""

from collections.abc import Callable

import pytest
import torch

from splatrl.envs.tasks import Outcome, PointNav, Push, Task
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
    verdict = task.judge(Step(before, action, move, memory, torch.zeros(0)), anywhere)
    assert verdict.terminated[0].item() and verdict.outcome[0].item() == outcome
    assert verdict.reward[0].abs() < 100 and verdict.outcome[1].item() == Outcome.RUNNING
