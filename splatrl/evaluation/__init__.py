"""Evaluation: episodes from every start, figures and video."""

from splatrl.evaluation.report import summarise
from splatrl.evaluation.rollouts import Episodes, run_episodes

__all__ = ["Episodes", "run_episodes", "summarise"]
