"""Learning: networks, PPO, checkpoints and the training loop."""

from splatrl.training.actor import Actor
from splatrl.training.checkpoint import load_checkpoint, save_checkpoint
from splatrl.training.cloning import Cloner, CloningSettings
from splatrl.training.dagger import DaggerSettings, targets, visited
from splatrl.training.inputs import Input, inputs_of
from splatrl.training.matching import Matcher, MatchingSettings, check_reads, views
from splatrl.training.memory import memory_transforms
from splatrl.training.networks import actor_critic
from splatrl.training.ppo import PPO, check_frames
from splatrl.training.settings import LossSettings, OptimSettings
from splatrl.training.stage import Stage
from splatrl.training.trackers import check_tracker, make_tracker
from splatrl.training.trainer import KEPT, Trainer

__all__ = [
    "KEPT",
    "PPO",
    "Actor",
    "Cloner",
    "CloningSettings",
    "DaggerSettings",
    "Input",
    "LossSettings",
    "Matcher",
    "MatchingSettings",
    "OptimSettings",
    "Stage",
    "Trainer",
    "actor_critic",
    "check_frames",
    "check_reads",
    "check_tracker",
    "inputs_of",
    "load_checkpoint",
    "make_tracker",
    "memory_transforms",
    "save_checkpoint",
    "targets",
    "views",
    "visited",
]
