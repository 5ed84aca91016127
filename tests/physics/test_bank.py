"""What differs between the models of a bank."""

import mujoco
import numpy as np
import pytest

from splatrl.physics import Variation
from splatrl.physics.bank import bank

MUSCLE = """
<mujoco>
  <worldbody>
    <body pos="0 0 0.2"><freejoint/><geom size="0.05" mass="1"/><site name="top" pos="0 0 0.1"/>
      <body><joint name="arm" axis="0 1 0" actuatorfrcrange="-2 2"/><geom size="0.05" pos="0.1 0 0" mass="0.1"/>
        <site name="hand" pos="0.15 0 0.02"/></body>
      <body><joint name="free" axis="0 1 0" actuatorfrcrange="-3 3"/><geom size="0.05" mass="0.1"/></body>
    </body>
  </worldbody>
  <tendon><spatial name="t" actuatorfrclimited="true" actuatorfrcrange="-900 900"><site site="top"/><site site="hand"/>
  </spatial></tendon>
  <actuator>
    <muscle tendon="t" ctrlrange="0 1" force="{force}"/><motor joint="arm" gear="10" ctrlrange="-1 1"/>
    <position joint="arm" kp="3" forcerange="-4 4"/>
  </actuator>
</mujoco>
"""


def forces(model: mujoco.MjModel) -> tuple[float, np.ndarray]:
    """Return the force of the active muscle, and the torques on the joints with the motor at its limit."""
    data = mujoco.MjData(model)
    data.ctrl[:2], data.act[:] = 1.0, 1.0
    mujoco.mj_forward(model, data)
    return float(data.actuator_force[0]), data.qfrc_actuator[6:]


@pytest.mark.parametrize("force", [-1.0, 30.0])
def test_twice_the_strength_doubles_every_force_and_its_limit(force: float) -> None:
    model = mujoco.MjModel.from_xml_string(MUSCLE.format(force=force))
    first, strong = bank(model, Variation(2, motor=(2.0, 2.0)))
    assert first is model
    (muscle, torque), (strong_muscle, strong_torque) = forces(model), forces(strong)
    assert strong_muscle == pytest.approx(2.0 * muscle) and muscle < -0.1
    assert torque == pytest.approx([2.0, 0.0]) and strong_torque == pytest.approx([4.0, 0.0])
    assert strong.actuator_gainprm[1:] == pytest.approx(2.0 * model.actuator_gainprm[1:])
    assert strong.actuator_biasprm[1:] == pytest.approx(2.0 * model.actuator_biasprm[1:])
    assert strong.actuator_forcerange == pytest.approx(2.0 * model.actuator_forcerange)
    assert strong.tendon_actfrcrange == pytest.approx(2.0 * model.tendon_actfrcrange)
    assert strong.jnt_actfrcrange[2].tolist() == [-3.0, 3.0], "nothing drives this joint"


def test_a_joint_with_several_actuators_takes_their_mean_factor() -> None:
    model = mujoco.MjModel.from_xml_string(MUSCLE.format(force=30.0))
    varied = bank(model, Variation(2, motor=(0.5, 2.0), seed=3))[1]
    factors = (varied.actuator_gainprm[:, 0] / model.actuator_gainprm[:, 0])[1:]
    assert factors[0] != factors[1]
    assert varied.jnt_actfrcrange[1] / model.jnt_actfrcrange[1] == pytest.approx(factors.mean())
