"""Experiments: many trainings, run and reported together."""

from splatrl.experiments.budget import budget, statement
from splatrl.experiments.experiment import Experiment, Run, Selection, planned
from splatrl.experiments.report import write_joint_report, write_report
from splatrl.experiments.running import train

__all__ = [
    "Experiment",
    "Run",
    "Selection",
    "budget",
    "planned",
    "statement",
    "train",
    "write_joint_report",
    "write_report",
]
