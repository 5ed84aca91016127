"""Gaussians look like the geoms that they are made from."""

import math

import mujoco
import numpy as np
import pytest
import torch

from splatrl.cameras import Cameras, intrinsics, look_at
from splatrl.physics import gaussians_from_mjcf
from splatrl.physics.marks import beacon, disc
from splatrl.renderers import NativeRenderer
from splatrl.scenes.gaussians import Gaussians
from splatrl.spherical_harmonics import C0

SIDE, AWAY = 96, 1.0
EYE = (0.6, -0.5, 0.62)


def body(geoms: str, head: str = "") -> mujoco.MjModel:
    """Make a model of one body with the given geoms."""
    text = f'<mujoco>{head}<worldbody><body name="b"><freejoint/>{geoms}</body></worldbody></mujoco>'
    return mujoco.MjModel.from_xml_string(text)


def seen(gaussians: Gaussians) -> tuple[torch.Tensor, torch.Tensor]:
    """Render alpha [SIDE, SIDE] and colour of a body at the origin, seen obliquely from above."""
    camera = look_at(list(EYE), [0.0, 0.0, 0.0])
    cameras = Cameras(camera[None], intrinsics(math.radians(40), SIDE, SIDE), SIDE, SIDE)
    rgb, _, alpha = NativeRenderer(gaussians, tolerance=0.0).render(cameras)
    return alpha[0], rgb[0]


def silhouette(model: mujoco.MjModel) -> torch.Tensor:
    """Return which rays from the eye hit a geom, by MuJoCo's own ray casting: [SIDE, SIDE] bool."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    camera, K = look_at(list(EYE), [0.0, 0.0, 0.0]).double(), intrinsics(math.radians(40), SIDE, SIDE).double()
    row, column = torch.meshgrid(torch.arange(SIDE), torch.arange(SIDE), indexing="ij")
    ray = torch.stack([(column + 0.5 - K[0, 2]) / K[0, 0], (row + 0.5 - K[1, 2]) / K[1, 1], torch.ones(SIDE, SIDE)], 2)
    ways = (ray.double() @ camera[:3, :3].T).reshape(-1, 3).numpy()
    number, far = np.zeros(len(ways), np.int32), np.zeros(len(ways))
    eye = camera[:3, 3].numpy()
    mujoco.mj_multiRay(model, data, eye, ways.ravel(), None, 1, -1, number, far, None, len(ways), mujoco.mjMAXVAL)
    return torch.from_numpy(far.reshape(SIDE, SIDE) >= 0)


@pytest.mark.parametrize(
    "geom",
    [
        '<geom type="sphere" size="0.15"/>',
        '<geom type="box" size="0.1 0.15 0.07" euler="20 30 0"/>',
        '<geom type="capsule" size="0.06 0.12" euler="50 0 0"/>',
        '<geom type="cylinder" size="0.12 0.08" euler="50 20 0"/>',
        '<geom type="ellipsoid" size="0.2 0.1 0.08"/>',
        '<geom type="sphere" size="0.08" pos="0.1 0.05 0"/><geom type="box" size="0.05 0.05 0.1" pos="-0.1 0 0"/>',
    ],
)
def test_the_silhouette_of_a_geom_matches_mujocos_ray_casting(geom: str) -> None:
    model = body(geom)
    ((name, gaussians),) = gaussians_from_mjcf(model)
    assert name == "b"
    alpha, truth = seen(gaussians)[0] > 0.5, silhouette(model)
    shared = (alpha & truth).sum() / (alpha | truth).sum()
    assert shared > 0.9
    inner = -torch.nn.functional.max_pool2d(-truth[None].float(), 7, 1, 3)[0]
    assert seen(gaussians)[0][inner > 0].min() > 0.8, "there are no holes"


def test_a_mesh_is_sampled_on_its_surface() -> None:
    points = "0 0 0  0.2 0 0  0 0.2 0  0 0 0.2"
    head = f'<asset><mesh name="m" vertex="{points}"/></asset>'
    model = body('<geom type="mesh" mesh="m" rgba="0 0 1 1"/>', head)
    ((_, gaussians),) = gaussians_from_mjcf(model, count=300)
    means = gaussians.means
    faces = torch.stack([means[:, 0].abs(), means[:, 1].abs(), means[:, 2].abs(), (means.sum(1) - 0.2).abs()])
    assert faces.amin(0).max() < 1e-6
    assert (seen(gaussians)[0] > 0.5).eq(silhouette(model)).float().mean() > 0.98


def test_colours_come_from_geom_material_and_texture() -> None:
    assets = (
        '<asset><material name="red" rgba="1 0 0 1"/>'
        '<texture name="t" type="cube" builtin="flat" rgb1="0 1 0" rgb2="0 0 1" width="8" height="48"/>'
        '<material name="green" texture="t"/></asset>'
    )
    geoms = (
        '<geom size="0.1" rgba="0.2 0.4 0.6 1"/><geom size="0.1" pos="1 0 0" material="red"/>'
        '<geom size="0.1" pos="2 0 0" material="green"/><geom size="0.3" group="3"/><geom size="0.3" rgba="1 1 1 0"/>'
    )
    ((_, gaussians),) = gaussians_from_mjcf(body(geoms, assets), count=600)
    rgb, x = gaussians.sh[:, 0] * C0 + 0.5, gaussians.means[:, 0]
    torch.testing.assert_close(rgb[x < 0.5], torch.tensor([0.2, 0.4, 0.6]).expand(int((x < 0.5).sum()), 3))
    assert (rgb[(x > 0.5) & (x < 1.5)] - torch.tensor([1.0, 0.0, 0.0])).abs().max() < 1e-6
    assert rgb[x > 1.5].mean(0)[1] > 0.7
    assert (gaussians.means.abs() <= torch.tensor([2.11, 0.11, 0.11])).all(), "what is hidden is left out"


def test_links_without_joints_join_their_parent_and_prefixes_select_bodies() -> None:
    text = (
        '<mujoco><worldbody><body name="a/top"><freejoint/><geom size="0.1"/>'
        '<body name="a/head" pos="0 0 0.5"><geom size="0.1"/></body>'
        '<body name="a/arm" pos="0 0.5 0"><joint/><geom size="0.1"/></body></body>'
        '<body name="c/thing" pos="3 0 0"><geom size="0.1"/></body></worldbody></mujoco>'
    )
    model = mujoco.MjModel.from_xml_string(text)
    found = dict(gaussians_from_mjcf(model, "a/", 100))
    assert list(found) == ["a/top", "a/arm"]
    assert found["a/top"].means[:, 2].max() > 0.55 and found["a/arm"].means.abs().max() < 0.11
    ((name, thing),) = gaussians_from_mjcf(model, "c/", 100)
    assert name == "c/thing" and thing.means.abs().max() < 0.11


def test_the_same_model_gives_the_same_bytes() -> None:
    first, second = (gaussians_from_mjcf(body('<geom size="0.1"/>'))[0].gaussians for _ in range(2))
    assert all(torch.equal(getattr(first, name), getattr(second, name)) for name in ("means", "quats", "scales", "sh"))


def test_a_disc_is_flat_round_and_whole() -> None:
    mark = disc(0.2, (1.0, 0.0, 0.0))
    assert (mark.means[:, 2] == 0).all() and mark.means.norm(dim=1).max() < 0.2
    alpha, rgb = seen(mark)
    middle = SIDE // 2, SIDE // 2
    assert alpha[middle] > 0.95 and rgb[middle].tolist() == pytest.approx([1, 0, 0], abs=0.05)
    with pytest.raises(ValueError, match="expected red, green and blue"):
        disc(0.2, (2.0, 0.0, 0.0))


def test_a_beacon_is_a_disc_and_a_ball_above_it() -> None:
    mark = beacon(0.2, (1.0, 0.0, 0.0), 0.5)
    flat = disc(0.2, (1.0, 0.0, 0.0))
    assert torch.equal(mark.means[: len(flat)], flat.means)
    above = mark.means[len(flat) :]
    torch.testing.assert_close(above.mean(0), torch.tensor([0.0, 0.0, 0.5]), atol=1e-3, rtol=0.0)
    torch.testing.assert_close((above - above.new_tensor([0.0, 0.0, 0.5])).norm(dim=1), torch.full((len(above),), 0.16))
