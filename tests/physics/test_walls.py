"""Contact between a robot and the boxes of a scene."""

import mujoco
import pytest
import torch

from splatrl.physics import Physics, Terrain, compose, read_mjcf
from splatrl.physics.compose import SCENE
from splatrl.physics.robots import mjcf_path

WALL = torch.tensor([[1.05, 0.0, 0.3, 0.05, 1.0, 0.3], [0.5, 2.0, 0.3, 0.1, 0.1, 0.3]], dtype=torch.float64)
AHEAD = torch.tensor([[0.5, 0.0]])


def facing(wall: torch.Tensor) -> Physics:
    terrain = Terrain(torch.tensor([0.0, 0.0, 1.0, 0.0], dtype=torch.float64), wall)
    return Physics(compose(read_mjcf(mjcf_path("wheels")), terrain).model, 20, 1)


@pytest.mark.parametrize("angle", [0.0, 0.6])
def test_a_robot_that_keeps_driving_into_a_wall_stays_outside_it(angle: float) -> None:
    physics = facing(WALL)
    model, state = physics.model, physics.state_of()[None]
    qpos = physics.layout.positions
    half = torch.tensor(angle / 2)
    state[0, qpos][3], state[0, qpos][6] = half.cos(), half.sin()
    touched = physics.sensor(f"touch/{SCENE}")
    data, depths, met = mujoco.MjData(model), [], False
    for _ in range(70):
        state, sensed, _ = physics.step(state, AHEAD)
        met |= bool((sensed[..., touched] > 0).any())
        data.qpos[:] = state[0, qpos]
        mujoco.mj_forward(model, data)
        into = [-contact.dist for contact in data.contact if 0 in model.geom_bodyid[contact.geom]]
        depths.append(max(into, default=0.0))
    assert met, "the robot reaches the wall"
    assert max(depths) < 0.005, "as it hits the wall"
    assert depths[-1] < 0.002, "as it leans against it"


def test_contact_with_boxes_is_distinguished_from_contact_with_the_ground() -> None:
    physics = facing(WALL)
    state, sensed, _ = physics.step(physics.state_of()[None], AHEAD)
    assert not (sensed[..., physics.sensor(f"touch/{SCENE}")] > 0).any()
    assert state[0, physics.layout.position][0] > 0, "the wheels stand on the ground"
