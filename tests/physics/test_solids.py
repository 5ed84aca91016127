"""Rays against the solid geoms of bodies, against distances worked out by hand and MuJoCo's own rays."""

import math

import mujoco
import numpy as np
import pytest
import torch
from torch import Tensor

from splatrl.geometry import axis_rotations, quats_to_rotations, rigid
from splatrl.physics import Physics, Solids

KINDS = {
    "sphere": 'type="sphere" size="0.4"',
    "ellipsoid": 'type="ellipsoid" size="0.2 0.5 0.3"',
    "box": 'type="box" size="0.2 0.5 0.3"',
    "capsule": 'type="capsule" size="0.2 0.4"',
    "cylinder": 'type="cylinder" size="0.3 0.4"',
    "mesh": 'type="mesh" mesh="wedge"',
}
WORLD = """<mujoco><asset><mesh name="wedge" vertex="0 0 0  0.9 0 0  0 0.7 0  0 0 0.8  0.5 0.5 0.1"/></asset><worldbody>
  <body name="robot"><freejoint/><geom size="0.3"/></body>{things}
</worldbody></mujoco>"""
MANY = "".join(
    f'<body name="{kind}" pos="0 0 {number}"><freejoint/><geom pos="0.1 0.2 0.3" euler="10 20 30" {shape}/></body>'
    for number, (kind, shape) in enumerate(KINDS.items())
)


def of(things: str, *tops: str) -> tuple[Physics, Solids]:
    physics = Physics(mujoco.MjModel.from_xml_string(WORLD.format(things=things)), 1, 1)
    return physics, Solids(physics.model, tops)


def scattered(count: int) -> tuple[Physics, Solids, Tensor, Tensor, Tensor]:
    """Return one thing of each kind at random poses, states, poses of a lidar, and beams in all directions."""
    physics, solids = of(MANY, *KINDS)
    generator = torch.Generator().manual_seed(0)
    state = physics.state_of().repeat(count, 1)
    layout = physics.layout
    for number in range(len(KINDS) + 1):
        joint = state[:, layout.free_joint(7 * number)]
        joint[:, :3] = 1.5 * torch.randn(count, 3, generator=generator).double()
        joint[:, 3:] = torch.nn.functional.normalize(torch.randn(count, 4, generator=generator).double())
    turn = quats_to_rotations(torch.randn(count, 4, generator=generator))
    beams = torch.nn.functional.normalize(torch.randn(96, 3, generator=generator))
    return physics, solids, state, rigid(turn, 2.0 * torch.randn(count, 3, generator=generator)), beams


def test_beams_end_where_mujocos_rays_meet_geoms_of_every_kind() -> None:
    physics, solids, state, poses, beams = scattered(60)
    ranges = solids.ranges(state, poses, beams, 4.0)
    model, data = physics.model, mujoco.MjData(physics.model)
    met: set[int] = set()
    for row in range(len(state)):
        data.qpos[:] = state[row, physics.layout.positions]
        mujoco.mj_kinematics(model, data)
        start = poses[row, :3, 3].double().numpy().copy()
        if not ranges[row].any():
            continue  # it starts inside a geom, see below
        for beam in range(len(beams)):
            way = (poses[row, :3, :3].double() @ beams[beam].double()).numpy().copy()
            geom = np.zeros(1, np.int32)
            far = mujoco.mj_ray(model, data, start, way / np.linalg.norm(way), None, True, model.body("robot").id, geom)
            assert float(ranges[row, beam]) == pytest.approx(far if 0.0 <= far < 4.0 else 4.0, abs=1e-5)
            met |= {int(geom[0])} if far >= 0.0 else set()
    assert met == set(range(1, model.ngeom)), "some kind of geom was never met"


@pytest.mark.parametrize("kind", KINDS)
def test_a_beam_that_begins_inside_a_geom_has_range_0(kind: str) -> None:
    physics, solids = of(f'<body name="thing" pos="1 0 0"><geom {KINDS[kind]}/></body>', "thing")
    state = physics.state_of().repeat(2, 1)
    centre = physics.model.geom_pos[1] + [1.0, 0.0, 0.0]  # of a mesh, that of its volume
    poses = rigid(torch.eye(3).expand(2, 3, 3), torch.tensor(np.stack([centre, [-1.0, 0.0, 0.0]]))).float()
    beams = torch.nn.functional.normalize(torch.randn(32, 3, generator=torch.Generator().manual_seed(0)))
    inside, outside = solids.ranges(state, poses, torch.cat([beams, torch.eye(3)]), 5.0)
    assert (inside == 0.0).all() and (outside > 0.0).all() and outside[-1] == 5.0


def test_the_bits_of_a_range_do_not_depend_on_the_batch(monkeypatch: pytest.MonkeyPatch) -> None:
    _, solids, state, poses, beams = scattered(37)
    together = solids.ranges(state, poses, beams, 6.0)
    order = torch.randperm(37, generator=torch.Generator().manual_seed(1))
    assert torch.equal(solids.ranges(state[order], poses[order], beams, 6.0), together[order])
    for count in (1, 2, 3, 5, 8, 13):
        assert torch.equal(solids.ranges(state[:count], poses[:count], beams, 6.0), together[:count])
        assert torch.equal(solids.ranges(state, poses, beams[:count], 6.0), together[:, :count])
    monkeypatch.setattr("splatrl.physics.solids.PAIRS", 1)
    assert torch.equal(solids.ranges(state, poses, beams, 6.0), together)


def test_only_solid_geoms_of_the_named_bodies_stop_beams() -> None:
    things = """
    <body name="drawn" pos="1 0 0"><geom size="0.1" contype="0" conaffinity="0"/></body>
    <body name="other" pos="2 0 0"><geom size="0.1"/></body>
    <body name="unseen" pos="3 0 0"><geom size="0.1" group="4" rgba="0 0 0 0" contype="0"/></body>
    <body name="holder" pos="0 3 0"><body name="held" pos="0 1 0"><geom size="0.1"/></body></body>"""
    physics, solids = of(things, "drawn", "unseen", "holder")
    state, pose = physics.state_of()[None], torch.eye(4)[None]
    found = solids.ranges(state, pose, torch.eye(3)[:2], 10.0)
    torch.testing.assert_close(found, torch.tensor([[2.9, 3.9]]))
    assert torch.equal(of(things, "drawn")[1].ranges(state, pose, torch.eye(3), 10.0), torch.full((1, 3), 10.0))


def test_geoms_that_only_a_contact_pair_lets_touch_are_solid() -> None:
    thing = '<body name="thing" pos="1 0 0"><geom name="thing" size="0.1" contype="0" conaffinity="0"/></body>'
    text = WORLD.format(things=thing).replace('<geom size="0.3"/>', '<geom name="robot" size="0.3"/>')
    text = text.replace("</worldbody>", '</worldbody><contact><pair geom1="robot" geom2="thing"/></contact>')
    physics = Physics(mujoco.MjModel.from_xml_string(text), 1, 1)
    found = Solids(physics.model, ["thing"]).ranges(physics.state_of()[None], torch.eye(4)[None], torch.eye(3)[:1], 9.0)
    assert found.item() == pytest.approx(0.9)


def test_beams_along_the_axes_and_faces_of_geoms_are_exact() -> None:
    """Divisors are 0 there."""
    things = "".join(
        f'<body name="{kind}" pos="{2 * number} 0 1"><geom {shape}/></body>'
        for number, (kind, shape) in enumerate(KINDS.items())
    )
    physics, solids = of(things, *KINDS)
    state = physics.state_of().repeat(5, 1)
    places = torch.tensor([[2.0 * number, 0.0, 4.0] for number in range(5)])
    down = torch.tensor([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    found = solids.ranges(state, rigid(torch.eye(3).expand(5, 3, 3), places), down, 8.0)
    torch.testing.assert_close(found[:, 0], 3.0 - torch.tensor([0.4, 0.3, 0.3, 0.6, 0.4]))
    assert (found[:, 1:] == 8.0).all()
    quarter = axis_rotations(2, torch.full((5,), math.pi / 2))
    assert torch.equal(solids.ranges(state, rigid(quarter, places), down, 8.0)[:, :2], found[:, :2])


def test_what_is_out_of_reach_or_nowhere_reads_as_reach() -> None:
    physics, solids = of('<body name="thing" pos="3 0 0"><geom size="0.1"/></body>', "thing")
    state, pose = physics.state_of()[None], torch.eye(4)[None]
    assert solids.ranges(state, pose, torch.eye(3)[:1], 2.8).tolist() == [[pytest.approx(2.8)]]
    assert torch.equal(solids.ranges(state * math.nan, pose, torch.eye(3), 2.0), torch.full((1, 3), 2.0))
    assert solids.ranges(state[:0], pose[:0], torch.eye(3), 2.0).shape == (0, 3)
