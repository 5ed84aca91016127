"""A renderer that draws nothing."""

from pathlib import Path

import torch

from splatrl.building import make_env
from splatrl.cameras import Cameras, intrinsics
from splatrl.renderers import NoRenderer
from tests.tiny import tiny_gaussians, tiny_overrides


def test_every_image_is_black_whatever_the_scene() -> None:
    cameras = Cameras(torch.eye(4).repeat(3, 1, 1), intrinsics(1.0, 7, 5), 7, 5)
    renderer = NoRenderer([tiny_gaussians()], antialiased=True)
    rgb, depth, alpha = renderer.render(cameras)
    assert rgb.shape == (3, 5, 7, 3) and depth.shape == alpha.shape == (3, 5, 7)
    assert not rgb.any() and not depth.any() and not alpha.any()
    pixels = renderer.pixels(cameras)
    assert pixels.shape == (3, 5, 7, 3) and pixels.dtype == torch.uint8 and not pixels.any()


def test_robots_move_the_same_with_and_without_images(tmp_path: Path) -> None:
    blind, seeing = (make_env([*tiny_overrides(tmp_path), *more], [3]) for more in (["renderer=none"], []))
    moved = []
    for env in (blind, seeing):
        torch.manual_seed(0)
        moved.append(env.rollout(4, break_when_any_done=False))
    assert torch.equal(moved[0]["state"], moved[1]["state"])
    assert not moved[0]["pixels"].any() and moved[1]["pixels"].any()
