"""The settings of the sim2real task, which otherwise behaves like the apple task."""

import pytest
import torch
from hydra.utils import instantiate

from splatrl.configuration import load_config
from splatrl.envs.tasks import Apple, Sim2Real


def test_the_config_is_the_published_experiment() -> None:
    cfg = load_config(["task=sim2real"])
    task = instantiate(cfg.task)
    assert isinstance(task, Sim2Real) and isinstance(task, Apple)
    motion = task.motion
    assert (motion.step, motion.headings, task.max_steps) == (0.05, 36, 100)
    assert motion.lower.tolist() == [-2.0, -2.0] and motion.upper.tolist() == [2.0, 2.0]
    assert task.reach == pytest.approx(2 * 0.05)
    assert cfg.collision.cpu._target_.endswith("NativeChecker")
    assert cfg.starts.farthest < task.max_steps


def test_the_camera_shakes_unless_asked_not_to() -> None:
    noise = load_config(["task=sim2real"]).transforms.pose_noise
    shaking = instantiate(noise)
    sizes = shaking.sizes.tolist()
    assert sizes[:2] == [0.0, 0.0] and sizes[5] == 0.0  # only height, pitch and roll
    assert sizes[2:5] == pytest.approx([0.02, *torch.tensor([5.0, 5.0]).deg2rad().tolist()])
    still = load_config(["task=sim2real", "transforms/pose_noise=none"])
    assert not still.transforms.pose_noise and still.drawing._target_.endswith("SpriteDrawing")
    hand = load_config(["task=sim2real", "transforms/pose_noise=unsteady"])
    assert hand.transforms.pose_noise.smooth > 0
