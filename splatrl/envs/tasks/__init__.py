"""Tasks: what robots are rewarded for, and when episodes end."""

from splatrl.envs.tasks.apple import Apple
from splatrl.envs.tasks.base import Mark, Memory, Outcome, Step, Task, Verdict
from splatrl.envs.tasks.course import Course, CourseRewards
from splatrl.envs.tasks.drive import Drive
from splatrl.envs.tasks.fps import Fps
from splatrl.envs.tasks.gates import Gates
from splatrl.envs.tasks.grid import Grid
from splatrl.envs.tasks.imagenav import ImageNav
from splatrl.envs.tasks.module import TaskModule
from splatrl.envs.tasks.navigation import NavigationRewards, NavigationTask
from splatrl.envs.tasks.orbit import Orbit
from splatrl.envs.tasks.pointnav import PointNav
from splatrl.envs.tasks.poster import Poster
from splatrl.envs.tasks.push import Push, PushRewards
from splatrl.envs.tasks.rewards import OutcomeTask, Rewards
from splatrl.envs.tasks.route import Route
from splatrl.envs.tasks.sim2real import Sim2Real
from splatrl.envs.tasks.snake import Snake
from splatrl.envs.tasks.strides import Strides, StridesRewards
from splatrl.envs.tasks.walk import Walk

__all__ = [
    "Apple",
    "Course",
    "CourseRewards",
    "Drive",
    "Fps",
    "Gates",
    "Grid",
    "ImageNav",
    "Mark",
    "Memory",
    "NavigationRewards",
    "NavigationTask",
    "Orbit",
    "Outcome",
    "OutcomeTask",
    "PointNav",
    "Poster",
    "Push",
    "PushRewards",
    "Rewards",
    "Route",
    "Sim2Real",
    "Snake",
    "Step",
    "Strides",
    "StridesRewards",
    "Task",
    "TaskModule",
    "Verdict",
    "Walk",
]
