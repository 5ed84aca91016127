"""The trot: the positions of the feet, and the joint angles that reach them."""

import pytest
import torch

from splatrl.physics import Kinematics, compose, level_ground, read_mjcf
from splatrl.physics.robots import mjcf_path
from splatrl.physics.stepping import Physics
from splatrl.physics.trot import DEPTH, FREQUENCY, LIFT, OFFSET, SIDES, feet, leg_angles, trot


def test_joint_angles_put_the_feet_at_their_targets_by_mujocos_kinematics() -> None:
    world = compose(read_mjcf(mjcf_path("quadruped")), level_ground())
    physics = Physics(world.model, 1, 1)
    time, command = torch.tensor([0.0, 0.1, 0.2, 0.31]).double(), torch.tensor([[0.8, 0.5]] * 4).double()
    angles = trot(time, command)
    state = physics.state_of().repeat(4, 1)
    state[:, physics.layout.positions][:, 7:19] = angles
    names = ["front_left", "front_right", "rear_left", "rear_right"]
    kinematics = Kinematics(world.model, [f"robot/{name}_{part}" for part in ("hip", "calf") for name in names])
    place, turn = kinematics(state)
    poses = kinematics.as_poses(place, turn).double()
    calf_to_foot = torch.tensor([0.0, 0.0, -0.213, 1.0]).double()
    for leg, foot in enumerate(feet(time, command).unbind(1)):
        found = (poses[:, 4 + leg] @ calf_to_foot)[:, :3] - poses[:, leg, :3, 3]
        assert torch.allclose(found, foot, atol=1e-5)


def test_one_diagonal_pair_stands_while_the_other_swings() -> None:
    time = torch.arange(0.0, 1.0 / FREQUENCY, 0.01, dtype=torch.float64)
    height = feet(time, torch.zeros(len(time), 2).double())[..., 2]
    lifted = height + DEPTH > 1e-9
    assert torch.equal(lifted[:, 0], lifted[:, 3]) and torch.equal(lifted[:, 1], lifted[:, 2])
    assert (lifted.sum(1) <= 2).all() and lifted[:, 0].any() and lifted[:, 1].any()
    assert float(height.max()) == pytest.approx(LIFT - DEPTH, abs=1e-3)


def test_standing_feet_move_back_with_the_commanded_speed_and_turn() -> None:
    time, command = torch.tensor([0.02, 0.12]).double(), torch.tensor([[0.6, 0.7]] * 2).double()
    foot = feet(time, command)[:, 0]  # front left, which stands then
    velocity = (foot[1] - foot[0]) / 0.1
    assert velocity.tolist() == pytest.approx([-(0.6 - 0.7 * (0.05 + OFFSET)), -0.7 * 0.19, 0.0], abs=1e-6)


def test_a_leg_stretches_towards_a_foot_position_out_of_reach() -> None:
    side = torch.tensor(SIDES[:2]).double()
    foot = torch.tensor([[[0.0, OFFSET, -3.0], [0.0, -OFFSET, -3.0]]]).double()
    angles = leg_angles(foot, side)
    assert angles.isfinite().all() and (angles[..., 2] < 0.0).all() and (angles[..., 2] > -0.1).all()
