"""How standing models reach around themselves."""

import mujoco
import pytest

from splatrl.physics.robots import mjcf_path
from splatrl.physics.standing import radius_of, reach_of

ROBOT = """
<mujoco>
  <worldbody>
    <body pos="2 1 0.2" euler="0 0 90"><freejoint/><geom type="box" size="0.3 0.4 0.05"/>
      <geom size="0.1" pos="5 0 0" contype="0" conaffinity="0"/>
      <body><joint name="boom" axis="0 1 0"/><geom type="capsule" size="0.03" fromto="0 0 0 0.8 0 0"/></body>
    </body>
  </worldbody>
  {keyframe}
</mujoco>
"""


def test_a_robot_reaches_as_far_as_its_contacts_where_it_stands() -> None:
    model = mujoco.MjModel.from_xml_string(ROBOT.format(keyframe=""))
    assert reach_of(model) == pytest.approx(0.83, abs=2e-3)  # the capsule's box is as wide as the capsule
    assert radius_of(model) == pytest.approx(0.83)
    key = '<keyframe><key qpos="2 1 0.9 1 0 0 0 1.5708"/></keyframe>'  # the boom hangs down
    assert reach_of(mujoco.MjModel.from_xml_string(ROBOT.format(keyframe=key))) == pytest.approx(0.5)


def test_the_built_in_robots_reach_as_far_as_they_look() -> None:
    reach = {name: reach_of(mujoco.MjModel.from_xml_path(str(mjcf_path(name)))) for name in ("wheels", "quadruped")}
    assert 0.16 < reach["wheels"] < 0.25 and 0.3 < reach["quadruped"] < 0.45
