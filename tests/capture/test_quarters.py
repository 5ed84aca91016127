"""A camera may be turned by a quarter while it films: up, the floor and the scale are found as if it had not been."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from splatrl.capture.base import Photos, Reconstruction
from splatrl.capture.quarters import how_turned, turned_while_filming
from splatrl.capture.upright_check import why_not_upright
from splatrl.capture.world import place
from splatrl.evaluation.phone_walk import camera_poses
from tests.capture.walks import ABOVE, CAMERAS, strewn, walk

ROWS = np.arange(CAMERAS)
ROLLS = {
    "the last half": -90.0 * (ROWS >= 20),
    "all but the first": 90.0 * (ROWS >= 4),
    "in between": 90.0 * ((ROWS >= 10) & (ROWS < 32)),
    "at first": -90.0 * (ROWS < 24),
    "slowly": 90.0 * np.clip((ROWS - 14) / 5, 0, 1),
    "by half a turn": 180.0 * (ROWS >= 12),
}
"""Degrees by which the images of the walk are rolled."""


def rolled(camera_to_world: torch.Tensor, degrees: np.ndarray) -> torch.Tensor:
    """Return poses [N, 4, 4] of cameras that are turned about their viewing directions."""
    cos, sin = (torch.from_numpy(part(np.radians(degrees)))[:, None] for part in (np.cos, np.sin))
    poses = camera_to_world.clone()
    right, down = (camera_to_world[:, :3, axis] for axis in (0, 1))
    poses[:, :3, 0], poses[:, :3, 1] = cos * right + sin * down, cos * down - sin * right
    return poses


def film(camera_to_world: torch.Tensor, walked: Reconstruction | None = None) -> Reconstruction:
    seconds = torch.arange(len(camera_to_world)).double()
    return replace(walked or walk(), camera_to_world=camera_to_world, seconds=seconds)


def looking(yaws_deg: np.ndarray, pitch_deg: float, sway_deg: float = 2.0) -> torch.Tensor:
    """Return poses [N, 4, 4] of a camera in these directions, which sways."""
    rng = np.random.default_rng(0)
    turned = np.radians(rng.normal(0.0, sway_deg, (len(yaws_deg), 3)))
    turned += np.stack([np.radians(yaws_deg), np.full(len(yaws_deg), math.radians(pitch_deg)), 0.0 * yaws_deg], 1)
    return camera_poses(torch.from_numpy(np.concatenate([rng.normal(size=(len(yaws_deg), 3)), turned], 1)))


@pytest.mark.parametrize("case", ROLLS)
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_film_whose_camera_was_turned_is_placed_like_one_whose_camera_was_not(case: str, side: float) -> None:
    lying, transform = strewn(4)
    turned = film(rolled(lying.camera_to_world, side * ROLLS[case]), lying)
    assert why_not_upright(turned, Photos([], 320, 180, torch.zeros(0))) is None
    placed = place(turned, marker=None, camera_height=ABOVE)
    assert (placed.up_from, placed.up_error_deg, placed.scale_error) == ("floor", 1.5, 0.05)
    whole = placed.world_from_capture.numpy() @ transform
    scale = float(np.cbrt(np.linalg.det(whole[:3, :3])))
    assert whole[2, 2] / scale > math.cos(math.radians(0.5)) and abs(scale - 1.0) < 0.02


@pytest.mark.parametrize(("case", "when"), [("the last half", 20), ("in between", 10), ("at first", 24)])
def test_the_report_says_when_the_camera_was_turned(case: str, when: int) -> None:
    said = how_turned(film(rolled(walk().camera_to_world, ROLLS[case])))
    assert said is not None and f"while it filmed, first at {when} s" in said
    assert how_turned(film(walk().camera_to_world)) is None


@pytest.mark.parametrize(
    "degrees",
    [
        0.0 * ROWS,
        25.0 * np.sin(ROWS),
        90.0 * (ROWS == 7),
        90.0 + 0.0 * ROWS,
        180.0 + 0.0 * ROWS,
    ],
    ids=["upright", "swaying", "one image", "on its side throughout", "upside down throughout"],
)
def test_a_camera_that_was_held_one_way_was_not_turned(degrees: np.ndarray) -> None:
    turns = turned_while_filming(rolled(walk().camera_to_world, degrees).numpy())
    assert turns.sure and not turns.each.any()


@pytest.mark.parametrize("pitch_deg", [20.0, 0.0, -30.0, -60.0, -75.0])
@pytest.mark.parametrize("yaws", [[0], [0, 90], [0, 180], [0, 90, 180, 270], range(0, 360, 9)], ids=str)
def test_a_camera_that_looks_up_or_far_down_to_several_sides_was_not_turned(pitch_deg: float, yaws: list[int]) -> None:
    turns = turned_while_filming(looking(np.repeat(yaws, 120 // len(yaws)).astype(float), pitch_deg).numpy())
    assert turns.sure and not turns.each.any()


def test_where_a_camera_looks_one_way_and_is_turned_the_errors_of_up_and_scale_are_unknown() -> None:
    poses = rolled(looking(np.zeros(CAMERAS), -10.0), ROLLS["the last half"])
    turned = film(poses, walk())
    turns = turned_while_filming(poses.numpy())
    assert not turns.sure and (turns.each == np.where(ROWS >= 20, turns.each[-1], 0)).all() and turns.each[-1] % 2 == 1
    assert "seems to have been turned on its side at 20 s" in str(how_turned(turned))
    turned.camera_to_world[:, 2, 3] = ABOVE
    placed = place(turned, marker=None, camera_height=ABOVE)
    assert placed.up_error_deg is None and placed.scale_error is None
    recorded = place(turned, up=torch.tensor([0.0, 0.0, 1.0]), marker=None, camera_height=ABOVE)
    assert recorded.up_error_deg == 1.0 and recorded.scale_error is not None
