"""The automatic curriculum: shortest paths, levels and start poses."""

from splatrl.curriculum.field import Moves, NoPath
from splatrl.curriculum.geodesics import Geodesics
from splatrl.curriculum.planner import UNREACHABLE, Plan, plan
from splatrl.curriculum.schedule import Schedule
from splatrl.curriculum.starts import Curriculum, Starts

__all__ = ["UNREACHABLE", "Curriculum", "Geodesics", "Moves", "NoPath", "Plan", "Schedule", "Starts", "plan"]
