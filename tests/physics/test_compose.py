"""A robot and things in one world with a terrain."""

from pathlib import Path

import mujoco
import pytest
import torch

from splatrl.physics import Terrain, compose, level_ground, read_mjcf
from tests.physics.test_mjcf import BALL, written

NO_BOXES = torch.zeros(0, 6, dtype=torch.float64)


def test_a_robot_must_have_one_top_level_body_and_no_ground(tmp_path: Path) -> None:
    floor = '<geom name="floor" type="plane" size="1 1 1"/>'
    with pytest.raises(
        ValueError,
        match="geom 'floor': expected a geom inside a body, got one in <worldbody>; the ground comes from the scene",
    ):
        compose(read_mjcf(written(tmp_path, BALL + floor)), level_ground())
    with pytest.raises(ValueError, match=r"expected one body in <worldbody>, got 2"):
        compose(read_mjcf(written(tmp_path, BALL + BALL.replace("ball", "other"))), level_ground())


def test_options_come_from_the_robot_and_the_ground_from_the_terrain(tmp_path: Path) -> None:
    plane = torch.tensor([0.6, 0.0, 0.8, 0.5], dtype=torch.float64)
    path = written(tmp_path, BALL, '<option timestep="0.004" gravity="0 0 -3"/>')
    model = compose(read_mjcf(path), Terrain(plane, NO_BOXES)).model
    assert model.opt.timestep == 0.004 and model.opt.gravity[2] == -3
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    normal = data.geom_xmat[0].reshape(3, 3)[:, 2]
    assert normal == pytest.approx([0.6, 0.0, 0.8]) and data.geom_xpos[0] @ normal == pytest.approx(0.5)
