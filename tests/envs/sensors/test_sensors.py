"""Sensors, against readings worked out by hand and under the env contract."""

import math
from dataclasses import replace
from functools import cache

import pytest
import torch
from tensordict import TensorDict
from torch import Tensor
from torchrl.envs.utils import check_env_specs

import splatrl
from splatrl.collision import NativeChecker, Occupancy
from splatrl.curriculum import Curriculum
from splatrl.envs import SplatEnv
from splatrl.envs.drawing import SceneDrawing
from splatrl.envs.sensors import (
    Compass,
    Contact,
    Depth,
    EgoMotion,
    Gps,
    Heading,
    ImageGoal,
    Lidar,
    Moment,
    PointGoal,
    Sensor,
    Velocity,
)
from splatrl.geometry import axis_rotations, rigid
from splatrl.motions import PhysicsMotion
from splatrl.renderers import NativeRenderer
from splatrl.scenes import Gaussians
from tests.envs.contract import EnvContract
from tests.tiny import BLOCK, BODY, tiny_gaussians, tiny_overrides, tiny_plan, tiny_robot, tiny_task

QUARTER = math.pi / 2


@cache
def block() -> NativeChecker:
    """Make a checker for the block in the middle of the tiny room and walls at 1.5 m and 2 m."""
    lower = [[-BLOCK, -BLOCK, 0.0], [1.5, -2.0, 0.0], [-1.6, -2.0, 0.0], [-1.5, 2.0, 0.0], [-1.5, -2.1, 0.0]]
    upper = [[BLOCK, BLOCK, 1.0], [1.6, 2.0, 1.0], [-1.5, 2.0, 1.0], [1.5, 2.1, 1.0], [1.5, -2.0, 1.0]]
    return NativeChecker(Occupancy.from_boxes(lower, upper, 0.05), BODY)


def all_sensors() -> dict[str, Sensor]:
    return {
        "depth": Depth(farthest=4.0),
        "gps": Gps(),
        "compass": Compass(),
        "heading": Heading(),
        "contact": Contact(),
        "lidar": Lidar(beams=8),
    }


def sensing_env(batch: tuple[int, ...], seed: int = 0, **sensors: Sensor) -> SplatEnv:
    drawing = SceneDrawing(_renderer())
    curriculum = Curriculum(tiny_plan(), None)
    chosen = sensors or all_sensors()
    return SplatEnv(drawing, block(), tiny_robot(), tiny_task(), curriculum, batch, seed, sensors=chosen)


@cache
def _renderer() -> NativeRenderer:
    return NativeRenderer(tiny_gaussians(), threads=1)


def moment(planar: list[list[float]], **memory: Tensor) -> Moment:
    rows = torch.tensor(planar, dtype=torch.float64)
    unused = torch.zeros(len(rows), 4, 4)
    given = rows, unused, torch.ones(len(rows)), memory, None, block(), lambda states: states
    return Moment(*given, rows, tiny_task().motion)


class TestContract(EnvContract):
    def make(self, batch_size: tuple[int], seed: int = 0) -> SplatEnv:
        return sensing_env(batch_size, seed)


def test_gps_is_metres_ahead_and_to_the_right_of_the_start() -> None:
    # Habitat: [-z, x] in the frame of the start, in which forward is -z and right is x.
    start = torch.tensor([[1.0, 2.0, 0.0], [1.0, 2.0, QUARTER], [1.0, 2.0, math.pi]])
    gone = Gps().read(moment([[4.0, 2.5, 1.0]] * 3, episode_start=start))
    torch.testing.assert_close(gone, torch.tensor([[3.0, -0.5], [0.5, 3.0], [-3.0, 0.5]]))


def test_compass_is_the_left_turn_since_the_start_and_heading_the_left_turn_from_x() -> None:
    start = torch.tensor([[0.0, 0.0, 0.0], [0.0, 0.0, 0.3], [0.0, 0.0, 6.0]])
    now = moment([[0.0, 0.0, QUARTER], [0.0, 0.0, 0.1], [0.0, 0.0, 0.2]], episode_start=start)
    expected = torch.tensor([[QUARTER], [-0.2], [0.2 - 6.0 + math.tau]])
    torch.testing.assert_close(Compass().read(now), expected)
    heading = Heading().read(moment([[0.0, 0.0, 1.5 * math.pi], [0.0, 0.0, 0.1]]))
    torch.testing.assert_close(heading, torch.tensor([[-QUARTER], [0.1]]))


def test_pointgoal_is_the_straight_distance_and_the_azimuth_to_the_left() -> None:
    goal = torch.tensor([[3.0, 4.0, 0.0], [0.0, -2.0, 0.0], [0.0, -2.0, 0.0]])
    told = PointGoal().read(moment([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, math.pi]], goal=goal))
    torch.testing.assert_close(told, torch.tensor([[5.0, math.atan2(4, 3)], [2.0, -QUARTER], [2.0, QUARTER]]))


def test_ego_motion_is_velocity_turn_rate_and_up_direction_in_the_body_frame() -> None:
    motion = PhysicsMotion("quadrotor", "eye", linear=(-1.0, 1.0), angular_deg=90.0, threads=1)
    state = motion.home.repeat(3, 1)
    half, layout = math.sqrt(0.5), motion.layout
    state[1, layout.orientation] = state.new_tensor([half, 0.0, 0.0, half])  # looks to the left, along +y
    state[2, layout.orientation] = state.new_tensor([half, half, 0.0, 0.0])  # lies on its right side
    state[:, layout.velocity] = state.new_tensor([1.0, 2.0, 3.0])  # in the world
    state[:, layout.angular_velocity] = state.new_tensor([0.1, 0.2, 0.3])  # in its own frame
    told = EgoMotion().read(moment([[0.0, 0.0, 0.0]] * 3)._replace(state=state, motion=motion))
    torch.testing.assert_close(told[:, :3], torch.tensor([[1.0, 2.0, 3.0], [2.0, -1.0, 3.0], [1.0, 3.0, -2.0]]))
    torch.testing.assert_close(told[:, 3:6], torch.tensor([[0.1, 0.2, 0.3]]).expand(3, 3))
    up = torch.tensor([[0.0, 0.0, 1.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]])
    torch.testing.assert_close(told[:, 6:], up, atol=1e-6, rtol=0.0)


def test_depth_is_clipped_and_scaled_and_maximal_where_nothing_is_hit() -> None:
    metres = torch.tensor([[[0.5, 2.0, 7.0, torch.inf]]])
    seen = moment([[0.0, 0.0, 0.0]])._replace(depth=metres)
    assert Depth(1.0, 5.0).read(seen)[0, 0, :, 0].tolist() == [0.0, 0.25, 1.0, 1.0]
    assert Depth(1.0, 5.0, normalize=False).read(seen)[0, 0, :, 0].tolist() == [1.0, 2.0, 5.0, 5.0]
    assert Depth().spec(tiny_robot()).shape == (12, 16, 1)


def test_the_depth_of_a_wall_is_its_distance() -> None:
    env = sensing_env((1,), depth=Depth(normalize=False))
    state = torch.tensor([[4, 5, 0]])  # x = 1, y = 1, looking east
    td = env.reset(TensorDict({"state": state}, [1]), set_state=True)
    assert float(td["depth"][0, 6, 8, 0]) == pytest.approx(0.4, abs=0.06)  # the red object at x = 1.4
    pixels = sensing_env((1,), heading=Heading()).reset(TensorDict({"state": state}, [1]), set_state=True)["pixels"]
    assert torch.equal(td["pixels"], pixels)


@pytest.mark.parametrize(("yaw", "least", "most"), [(0.0, 0.0, 0.001), (0.4, 0.02, 0.05), (-0.5, 0.02, 0.05)])
def test_walls_seen_at_an_angle_appear_nearer_than_they_are(yaw: float, least: float, most: float) -> None:
    side = torch.arange(-3.0, 3.0, 0.075)
    means = torch.cartesian_prod(torch.tensor([2.0]), side, side)  # a wall at x = 2
    wall = Gaussians(
        means=means,
        quats=torch.tensor([1.0, 0.0, 0.0, 0.0]).repeat(len(means), 1),
        scales=torch.tensor([0.002, 0.06, 0.06]).repeat(len(means), 1),
        opacities=torch.full((len(means),), 0.999),
        sh=torch.zeros(len(means), 1, 3),
        batch_size=[len(means)],
    )
    robot = replace(tiny_robot(), image_width=64, image_height=48)
    cameras = robot.cameras(rigid(axis_rotations(2, torch.tensor([yaw])), torch.zeros(1, 3)))
    found = NativeRenderer(wall).render(cameras).depth[0, 24, 32 - 8 : 32 + 8]  # near the optical axis
    K = cameras.K[0]
    right = (torch.arange(24, 40) + 0.5 - K[0, 2]) / K[0, 0]
    true = 2.0 / (math.cos(yaw) + right * math.sin(yaw))
    assert least <= float((true - found).mean()) <= most


def test_lidar_beams_go_counter_clockwise_from_behind() -> None:
    env = sensing_env((1,), lidar=Lidar(beams=4))
    td = env.reset(TensorDict({"state": torch.tensor([[4, 3, 0]])}, [1]), set_state=True)  # (1, 0), looking east
    torch.testing.assert_close(td["lidar"], torch.tensor([[0.8, 2.0, 0.5, 2.0]]), atol=1e-5, rtol=0)
    turned = env.reset(TensorDict({"state": torch.tensor([[4, 3, 2]])}, [1]), set_state=True)  # looking north
    torch.testing.assert_close(turned["lidar"], torch.tensor([[2.0, 0.5, 2.0, 0.8]]), atol=1e-5, rtol=0)
    half = Lidar(beams=3, field_deg=180.0)
    right, ahead, left = half._beams[torch.device("cpu")]
    for beam, way in ((right, [0.0, -1.0, 0.0]), (ahead, [1.0, 0.0, 0.0]), (left, [0.0, 1.0, 0.0])):
        torch.testing.assert_close(beam, torch.tensor(way), atol=1e-6, rtol=0)
    (raised,) = Lidar(beams=1, field_deg=0.0, elevation_deg=30.0)._beams[torch.device("cpu")]
    torch.testing.assert_close(raised, torch.tensor([math.sqrt(3) / 2, 0.0, 0.5]), atol=1e-6, rtol=0)


@pytest.mark.parametrize("field", [0.0, 90.0, 360.0])
def test_a_single_lidar_beam_points_ahead(field: float) -> None:
    assert Lidar(beams=1, field_deg=field)._beams[torch.device("cpu")].tolist() == [[1.0, 0.0, 0.0]]


def test_contact_is_felt_in_the_step_that_touches_and_not_after_a_reset() -> None:
    env = sensing_env((1,), contact=Contact())
    td = env.reset(TensorDict({"state": torch.tensor([[3, 3, 0]])}, [1]), set_state=True)  # x = 0.5, beside the block
    assert not td["contact"].any()
    after = env.step(td.set("action", torch.tensor([1])))["next"]  # towards -x
    assert after["contact"].all() and after["contact"].dtype == torch.bool
    assert not env.reset(env.step_mdp(env.step(td)), set_state=False)["contact"].any()
    moves = moment([[0.0, 0.0, 0.0]] * 3)._replace(free_fraction=torch.tensor([1.0, 0.999, 0.0]))
    assert Contact().read(moves).tolist() == [[False], [True], [True]]


def test_a_branched_episode_remembers_where_it_began() -> None:
    env = sensing_env((3,))
    torch.manual_seed(0)
    batch = env.rollout(3, break_when_any_done=False)
    now = batch[:, -1].select("state", "episode_start")
    again = env.reset(now.clone(), set_state=True)
    for key in ("gps", "compass", "depth", "lidar"):
        assert torch.equal(again[key], batch[key][:, -1])
    assert (batch["gps"][:, -1] != 0).any()


def test_sensors_are_chosen_in_the_config(tmp_path) -> None:
    env = splatrl.make_env([*tiny_overrides(tmp_path), "sensors=[lidar,compass]", "sensors.lidar.beams=5"], [2])
    check_env_specs(env, seed=0)
    assert env.reset()["lidar"].shape == (2, 5)
    plain = splatrl.make_env(tiny_overrides(tmp_path), [2])
    assert not {"lidar", "compass", "depth", "episode_start"} & set(plain.observation_spec.keys())


@pytest.mark.parametrize(
    ("make", "key"),
    [
        (lambda: Depth(2.0, 1.0), "sensors.depth"),
        (lambda: Lidar(beams=0), "sensors.lidar.beams"),
        (lambda: Lidar(reach=0.0), "sensors.lidar.reach"),
        (lambda: sensing_env((1,), near=PointGoal()), r"sensors\.near: expected a task with a goal per episode"),
        (lambda: sensing_env((1,), velocity=Velocity()), r"sensors\.velocity: expected a robot with physics"),
        (lambda: sensing_env((1,), pixels=Depth()), "sensors: expected keys that env and task do not use, got pixels"),
    ],
)
def test_invalid_sensor_settings_are_refused_by_key(make, key) -> None:
    with pytest.raises(ValueError, match=key):
        make()


def test_imagegoal_is_what_the_camera_sees_at_the_goal() -> None:
    goal = torch.tensor([[0.5, 1.0, 0.0]])
    asked = moment([[0.0, 0.0, 0.0]], goal=goal)
    state = ImageGoal().begin(asked)["imagegoal"]  # ``look`` returns the state itself here
    torch.testing.assert_close(asked.motion.planar(state), goal.double())
