"""Experiments: sets of trainings that are run and reported together."""

from splatrl.experiments.budget import budget, statement
from splatrl.experiments.comparison import compared, run_folders
from splatrl.experiments.conduct import check_settings, report_all, score, train_all
from splatrl.experiments.experiment import Experiment, Run, Selection, checked, planned

__all__ = [
    "Experiment",
    "Run",
    "Selection",
    "budget",
    "check_settings",
    "checked",
    "compared",
    "planned",
    "report_all",
    "run_folders",
    "score",
    "statement",
    "train_all",
]
