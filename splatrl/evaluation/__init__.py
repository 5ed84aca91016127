"""Evaluation of policies: episodes over the start set, figures and videos."""

from splatrl.evaluation.report import summarise
from splatrl.evaluation.rollouts import Episodes, run_episodes

__all__ = ["Episodes", "run_episodes", "summarise"]
