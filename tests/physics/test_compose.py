"""A robot and things in one world with a terrain."""

import math
from pathlib import Path

import mujoco
import pytest
import torch

from splatrl.physics import Terrain, compose, gaussians_from_mjcf, level_ground, read_mjcf
from tests.physics.test_mjcf import BALL, written

NO_BOXES = torch.zeros(0, 6, dtype=torch.float64)


def test_a_robot_must_have_one_top_level_body_and_no_ground(tmp_path: Path) -> None:
    floor = '<geom name="floor" type="plane" size="1 1 1"/>'
    with pytest.raises(
        ValueError,
        match=r"geom 'floor': expected a geom inside a body, got one in <worldbody>; .* the model alone",
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


def test_bodies_without_a_name_get_one_and_are_drawn(tmp_path: Path) -> None:
    link = '<body{} pos="0.3 0 0"><joint/><geom size="0.1"/>{}</body>'
    inner = link.format("", link.format(' name="body2"', link.format("", "")))
    path = written(tmp_path, f'<body><freejoint/><geom size="0.1"/>{inner}</body>')
    composed = compose(read_mjcf(path), level_ground(), {"thing": read_mjcf(path)})
    own, expected = ["body", "body3", "body2", "body4"], ["world", "ground"]
    expected += [f"{prefix}/{name}" for prefix in ("robot", "thing") for name in own]
    assert [composed.model.body(number).name for number in range(composed.model.nbody)] == expected
    assert composed.robot == "robot/body" and composed.things == {"thing": "thing/body"}
    assert len(gaussians_from_mjcf(composed.model, "robot/", 20)) == 4


@pytest.mark.parametrize("joint", ["<freejoint/>", ""])
def test_things_are_placed_on_the_ground_whatever_its_height_and_slope(tmp_path: Path, joint: str) -> None:
    tilt = math.radians(10)
    plane = torch.tensor([math.sin(tilt), 0.0, math.cos(tilt), 0.4], dtype=torch.float64)
    box = f'<body pos="1 2 0.1" euler="0 0 30">{joint}<geom type="box" size="0.2 0.2 0.1"/></body>'
    robot, thing = read_mjcf(written(tmp_path)), read_mjcf(written(tmp_path, box))
    model = compose(robot, Terrain(plane, NO_BOXES), {"box": thing}).model
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    place, turn = data.body("box/body").xpos, data.body("box/body").xmat.reshape(3, 3)
    assert place[:2] == pytest.approx([1.0, 2.0]) and turn[:, 2] == pytest.approx(plane[:3])
    assert place @ plane[:3].numpy() - 0.4 == pytest.approx(0.1), "its lower face lies on the ground"
    level = compose(robot.copy(), level_ground(0.5), {"box": read_mjcf(written(tmp_path, box))}).model
    mujoco.mj_kinematics(level, data := mujoco.MjData(level))
    assert data.body("box/body").xpos == pytest.approx([1.0, 2.0, 0.6])
    assert data.body("box/body").xquat == pytest.approx([math.cos(math.pi / 12), 0.0, 0.0, math.sin(math.pi / 12)])
