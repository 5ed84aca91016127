"""A robot among things: how it stands at first, and what is found in its model."""

import math
from pathlib import Path

import pytest
import torch

from splatrl.physics import level_ground
from splatrl.physics.robot_world import RobotWorld
from splatrl.physics.robots import mjcf_path

ROBOT = """
<mujoco>
  <worldbody>
    <body name="torso" pos="0 0 0.2"><freejoint/><geom size="0.1"/><camera name="eye"/>
      <body><joint name="knee" axis="0 1 0"/><geom size="0.05" pos="0.3 0 0"/><camera name="foot"/></body>
    </body>
  </worldbody>
  <actuator><general name="knee" joint="knee" dyntype="integrator" ctrlrange="-2 3"/></actuator>
  <keyframe><key qpos="0 0 0.4 1 0 0 0 0.7" act="0.5" ctrl="1.5"/></keyframe>
</mujoco>
"""


@pytest.fixture
def world(tmp_path: Path) -> RobotWorld:
    path = tmp_path / "robot.xml"
    path.write_text(ROBOT)
    return RobotWorld(path, {"ball": mjcf_path("ball")}, level_ground(), 0.004)


def test_the_robot_starts_in_its_keyframe_and_things_where_their_files_place_them(world: RobotWorld) -> None:
    assert world.qpos[:8].tolist() == [0.0, 0.0, 0.4, 1.0, 0.0, 0.0, 0.0, 0.7]
    assert world.qpos[8:].tolist() == world.model.qpos0[8:].tolist() and len(world.qpos) == 15
    assert world.act.tolist() == [0.5] and world.ctrl.tolist() == [1.5] and world.model.opt.timestep == 0.004
    assert world.top == pytest.approx(0.5)  # the torso's sphere, above the bent knee
    assert world.reach == pytest.approx(0.3 * math.cos(0.7) + 0.05, abs=0.03)  # the shin's, with a box around its end


def test_cameras_actuators_and_free_joints_are_found_by_their_own_names(world: RobotWorld) -> None:
    assert world.body_of_camera("eye") == "robot/torso" and world.body_of_camera("foot") == "robot/body"
    assert world.velocity_servos() == []
    assert torch.equal(world.control_limits(), torch.tensor([[-2.0], [3.0]]))
    assert world.free_joint("ball") == 8 and world.free_joint("egg") is None
    with pytest.raises(ValueError, match=r"robot\.xml: expected a camera called 'tail', got eye, foot"):
        world.body_of_camera("tail")
