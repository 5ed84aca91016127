"""Run folders in the tiny room, as if trained: policies with random weights, each of which prefers one action."""

from pathlib import Path

import torch
from omegaconf import DictConfig

from splatrl.building import build_model, build_world
from splatrl.configuration import load_config, save_config
from splatrl.experiments.clip_scores import altered, record_clips
from splatrl.scenes import write_gaussians
from splatrl.training import save_checkpoint
from tests.tiny import HEIGHT, tiny_gaussians

NAMES = ("forward", "back", "left", "right")
BEST = 3
"""The action that the best checkpoints prefer."""


def config(folder: Path, *more: str) -> DictConfig:
    """Return the config of the sim2real task in the room, with its object in the north-east."""
    path = folder / "tiny.ply"
    if not path.exists():
        write_gaussians(path, tiny_gaussians())
    return load_config(
        [
            "device=cpu",
            "scene=file",
            f"scene.path={path}",
            "task=sim2real",
            "collision=none",
            f"robot.height={HEIGHT}",
            "robot.image_width=16",
            "robot.image_height=12",
            "task.motion.step=0.25",
            "task.motion.angle_step_deg=30.0",
            "task.motion.lower=[-1.0,-1.5]",
            "task.motion.upper=[1.0,1.5]",
            "task.motion.spacing=0.25",
            "landmarks.object=[0.7,1.0,0.5]",
            "network.pool=1",
            *more,
        ]
    )


def save_run(folder: Path, cfg: DictConfig, action: int) -> Path:
    """Write a run folder whose last checkpoint prefers a given action, and whose best one prefers ``BEST``."""
    (folder / "checkpoints").mkdir(parents=True)
    save_config(cfg, folder)
    torch.manual_seed(action)
    model = build_model(cfg, build_world(cfg).env(1))
    for name, preferred in (("last", action), ("best", BEST)):
        logits = model.get_policy_head().module[0].module
        logits.bias.data = torch.zeros(len(NAMES)).index_fill(0, torch.tensor([preferred]), 4.0)
        save_checkpoint(folder / "checkpoints" / f"{name}.pt", {"ppo": {"model": model.state_dict()}})
    return folder


def three_runs(folder: Path) -> Path:
    """Write three run folders: two see one frame and go forward or back, one sees four frames and turns left."""
    for action, name in enumerate(("forward", "back")):
        save_run(folder / name, config(folder), action)
    save_run(folder / "stacked", config(folder, "memory=stack"), 2)
    return folder


def two_clips(folder: Path) -> Path:
    """Record two labelled clips beside the runs of a folder."""
    record_clips(build_world(altered(config(folder), 0)), folder / "clips", count=2, height=18)
    return folder / "clips"
