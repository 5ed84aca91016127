"""The named columns of a state are MuJoCo's own."""

import mujoco
import torch

from splatrl.physics import Physics, StateLayout

SPRUNG = """
<mujoco>
  <worldbody>
    <body name="robot"><freejoint/><geom size="0.1" mass="1"/>
      <body><joint name="knee" type="hinge" axis="0 1 0"/><geom size="0.1" pos="0.3 0 0" mass="1"/></body>
    </body>
    <body name="ball" pos="1 0 0"><freejoint name="rolls"/><geom size="0.1" mass="1"/></body>
  </worldbody>
  <actuator><general joint="knee" dyntype="integrator"/></actuator>
</mujoco>
"""


def test_every_name_reads_what_mujoco_stores_under_it() -> None:
    physics = Physics(mujoco.MjModel.from_xml_string(SPRUNG), 1, 1)
    data = mujoco.MjData(physics.model)
    data.time, data.qpos[:], data.qvel[:], data.act[:] = 0.5, range(100, 115), range(200, 213), 7.0
    state = torch.zeros(physics.size, dtype=torch.float64)
    layout = StateLayout(15, 13, hinges=1)
    mujoco.mj_getState(physics.model, data, state.numpy()[layout.mujoco], mujoco.mjtState.mjSTATE_FULLPHYSICS)
    assert physics.layout == StateLayout(15, 13) and state[layout.clock] == 0.5 and state[layout.model] == 0.0
    expected = {
        "positions": range(100, 115), "velocities": range(200, 213), "position": range(100, 103),
        "orientation": range(103, 107), "pose": range(100, 107), "joints": [107], "velocity": range(200, 203),
        "angular_velocity": range(203, 206), "joint_rates": [206], "robot_velocities": range(200, 207),
    }  # fmt: skip
    for name, values in expected.items():
        assert state[getattr(layout, name)].tolist() == list(values), name
    ball = int(physics.model.joint("rolls").qposadr[0])
    assert state[layout.free_joint(ball)].tolist() == data.qpos[ball:].tolist()
