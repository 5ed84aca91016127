"""Builds objects from configs; no other package knows which config node builds what."""

from splatrl.building.envs import env_makers, make_env, worker_seed
from splatrl.building.places import check_place, scene_digest
from splatrl.building.trainers import build_model, build_trainer, check_training
from splatrl.building.worlds import build_one_world, build_world, repeats_of

__all__ = [
    "build_model",
    "build_one_world",
    "build_trainer",
    "build_world",
    "check_place",
    "check_training",
    "env_makers",
    "make_env",
    "repeats_of",
    "scene_digest",
    "worker_seed",
]
