"""Demonstrations: recording episodes to learn from, storing them in a folder, and replaying them."""

from splatrl.datasets.demonstrations import Demonstrations
from splatrl.datasets.folder import read_demonstrations, write_demonstrations
from splatrl.datasets.imitation import Imitation, check_imitation, check_taught
from splatrl.datasets.lerobot import check_lerobot, write_lerobot
from splatrl.datasets.recorder import check_single_steps, planner_episodes, teacher_episodes
from splatrl.datasets.replay import replay

__all__ = [
    "Demonstrations",
    "Imitation",
    "check_imitation",
    "check_lerobot",
    "check_single_steps",
    "check_taught",
    "planner_episodes",
    "read_demonstrations",
    "replay",
    "teacher_episodes",
    "write_demonstrations",
    "write_lerobot",
]
