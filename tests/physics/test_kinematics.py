"""Poses of bodies from states, against MuJoCo's own."""

import mujoco
import numpy as np
import pytest
import torch

from splatrl.physics import Kinematics, Physics

ARM = """
<mujoco><worldbody>
  <body name="base" pos="1 2 3" quat="1 2 3 4"><freejoint/><geom size="0.1"/>
    <body name="upper" pos="0.1 0.2 0.3" euler="10 20 30">
      <joint type="slide" axis="1 2 0" ref="0.1"/><joint type="hinge" axis="0 1 1" pos="0.1 0 0.2" ref="0.3"/>
      <geom size="0.1"/>
      <body name="fixed" pos="0 0 0.3" euler="5 0 0"><geom size="0.1"/>
        <body name="hand" pos="0.2 0 0.1"><joint type="ball" pos="0 0.1 0"/><geom size="0.1"/></body>
      </body>
    </body>
    <body name="lower" pos="0 0 -0.3"><joint type="hinge" axis="1 0 0" pos="0 0.1 0"/><geom size="0.1"/></body>
  </body>
  <body name="rail" pos="0 1 0"><joint type="slide" axis="0 0 1"/><geom size="0.1"/></body>
  <body name="still" pos="0 5 0" euler="0 0 45"><geom size="0.1"/></body>
</worldbody></mujoco>
"""
NAMES = ["hand", "lower", "rail", "base", "fixed", "still", "upper"]


def states(count: int) -> tuple[Physics, torch.Tensor]:
    """Return the physics, and states with every joint at a random position."""
    physics = Physics(mujoco.MjModel.from_xml_string(ARM), 1, 1)
    state = physics.state_of().repeat(count, 1)
    drawn = torch.randn(count, physics.model.nq, generator=torch.Generator().manual_seed(0))
    state[:, physics.layout.positions] += drawn.double()
    return physics, state


def test_poses_match_mujocos_for_every_kind_of_joint() -> None:
    physics, state = states(20)
    place, turn = Kinematics(physics.model, NAMES)(state)
    poses = Kinematics(physics.model, NAMES).poses(state)
    data = mujoco.MjData(physics.model)
    for row in range(len(state)):
        data.qpos[:] = state[row, physics.layout.positions]
        mujoco.mj_kinematics(physics.model, data)
        for number, name in enumerate(NAMES):
            body = data.body(name)
            np.testing.assert_allclose(place[row, number], body.xpos, atol=1e-12)
            same = np.abs(turn[row, number].numpy() @ body.xquat)
            assert same == pytest.approx(1.0, abs=1e-12)
            np.testing.assert_allclose(poses[row, number, :3, :3], body.xmat.reshape(3, 3), atol=1e-6)


def test_the_bits_of_a_pose_do_not_depend_on_the_batch() -> None:
    physics, state = states(37)
    kinematics = Kinematics(physics.model, NAMES)
    together = kinematics.poses(state)
    order = torch.randperm(37, generator=torch.Generator().manual_seed(1))
    assert torch.equal(kinematics.poses(state[order]), together[order])
    for count in (1, 2, 3, 5, 8, 13):
        assert torch.equal(kinematics.poses(state[:count]), together[:count])


def test_bodies_without_joints_are_where_the_model_of_a_state_has_them() -> None:
    physics, state = states(4)
    models = [physics.model, *(mujoco.MjModel.from_xml_string(ARM) for _ in range(2))]
    models[1].body("still").pos[:] = 1.0, 2.0, 3.0
    models[2].body("still").quat[:] = 0.0, 0.0, 1.0, 0.0
    state[:, physics.layout.model] = torch.tensor([0.0, 1.0, 2.0, 1.0])
    poses = Kinematics(models, NAMES).poses(state)
    for row, model in enumerate((0, 1, 2, 1)):
        assert torch.equal(poses[row], Kinematics(models[model], NAMES).poses(state)[row])
    assert len({tuple(pose.flatten().tolist()) for pose in poses[:, NAMES.index("still")]}) == 3


def test_a_missing_body_is_named() -> None:
    with pytest.raises(ValueError, match=r"body: expected one of base, upper, .* got 'leg'"):
        Kinematics(states(1)[0].model, ["leg"])
