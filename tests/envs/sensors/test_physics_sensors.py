"""Sensors of robots with physics."""

import math
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import torch
from tensordict import TensorDict
from torch import Tensor

from splatrl.bodies import Box
from splatrl.building import build_model, build_one_world, worlds
from splatrl.collision import NativeChecker, Occupancy
from splatrl.configuration import load_config
from splatrl.envs.sensors import Joints, Lidar, Measured, Moment, Velocity
from splatrl.motions import PhysicsMotion, StridesMotion
from splatrl.motions.legs import JOINTS
from tests.tiny import tiny_overrides


@cache
def legs() -> StridesMotion:
    return StridesMotion(path="quadruped", camera="eye", threads=1)


def moment(motion: Any, state: Tensor, sensed: Tensor | None = None, **memory: Tensor) -> Moment:
    poses, nothing = motion.body_to_world(state), None
    free = torch.ones(len(state))
    given: Any = (motion.planar(state), poses, free, memory, None, nothing, nothing)
    return Moment(*given, state, motion, sensed)


def test_an_imu_begins_without_rotation_and_keeps_its_reading_while_nothing_is_sensed() -> None:
    imu = Measured("imu", "quadruped", ["accelerometer", "gyro"], scale=0.1)
    state = legs().placed(torch.zeros(2, 3))
    for _ in range(25):  # it settles onto its feet, trotting on the spot without stepping far
        state = legs().stride(state, torch.zeros(2, JOINTS)).state
    state[:, legs().layout.velocities] = 0.0
    begun = imu.begin(moment(legs(), legs().placed(torch.zeros(2, 3))))["imu"]
    assert begun.shape == (2, 6) and begun.dtype == torch.float32
    assert begun[:, 3:].abs().max() < 0.05
    assert torch.equal(imu.read(moment(legs(), state, None, imu=begun)), begun)


def test_an_imu_reports_the_mean_over_the_substeps_of_a_move() -> None:
    imu = Measured("imu", "quadruped", ["gyro", "accelerometer"], scale=2.0)
    motion = legs()
    state = motion.placed(torch.zeros(3, 3))
    state[:, motion.layout.angular_velocity][:, 2] = 1.0  # they spin to the left
    after, sensed, _ = motion.stride(state, torch.zeros(3, JOINTS))
    said = imu.read(moment(motion, after, sensed))
    columns = motion.physics.sensor("robot/gyro"), motion.physics.sensor("robot/accelerometer")
    assert columns[0] is not None and columns[1] is not None
    expected = torch.cat([sensed[:, :, each].mean(1) for each in columns], 1)
    assert torch.allclose(said, 2.0 * expected.float(), atol=1e-5)
    assert said[:, 2].min() > 0.5
    alone = imu.read(moment(motion, after[:1], sensed[:1]))
    assert torch.equal(alone, said[:1])


def test_foot_sensors_measure_the_load_on_the_feet() -> None:
    feet = Measured("feet", "quadruped", [f"{name}_foot" for name in ("front_left", "rear_right")], scale=1.0)
    motion = legs()
    state, carried = motion.placed(torch.zeros(1, 3)), []
    for _ in range(60):
        state, sensed, _ = motion.stride(state, torch.zeros(1, JOINTS))
        carried.append(feet.read(moment(motion, state, sensed)))
    force = torch.cat(carried)[20:]
    assert force.min() == 0.0 and force.max() > 20.0  # each foot is lifted and loaded in turn
    flying = state.clone()
    flying[:, motion.layout.position][:, 2] += 1.0
    assert feet.begin(moment(motion, flying))["feet"].abs().max() == 0.0


def test_joints_reports_angles_relative_to_the_standing_pose_and_rates() -> None:
    joints, motion = Joints("quadruped", rate=0.1), legs()
    state = motion.placed(torch.tensor([[1.0, 2.0, 0.5]]))
    assert joints.read(moment(motion, state)).abs().max() < 1e-6
    state[0, motion.layout.joints][4] += 0.2
    state[0, motion.layout.joint_rates][4] = -3.0
    read = joints.read(moment(motion, state))
    assert read.shape == (1, 24)
    assert read[0, 4].item() == pytest.approx(0.2) and read[0, 12 + 4].item() == pytest.approx(-0.3)
    assert (read != 0).sum() == 2
    wheels = PhysicsMotion("wheels", "eye", threads=1)
    assert Joints("wheels").read(moment(wheels, wheels.placed(torch.zeros(2, 3)))).shape == (2, 4)


def test_velocity_is_in_the_body_frame() -> None:
    motion = legs()
    state = motion.placed(torch.tensor([[1.0, 2.0, math.pi / 2]]))
    state[0, motion.layout.velocity][1] = 0.7  # along the world's y, where it looks
    state[0, motion.layout.angular_velocity][2] = 0.3
    assert Velocity().read(moment(motion, state))[0].tolist() == pytest.approx([0.7, 0, 0, 0, 0, 0.3], abs=1e-6)


@pytest.mark.parametrize(
    "task, sensor, expected",
    [
        ("drive", "velocity", "sensors.velocity: expected a robot with physics, .*, got DriveMotion"),
        ("drive", "ego_motion", "sensors.ego_motion: expected a robot with physics, .*, got DriveMotion"),
        ("push", "felt", "sensors.felt: expected a legged robot, .*, got PhysicsMotion"),
        (
            "grid",
            "pointgoal",
            "sensors.pointgoal_with_gps_compass: expected a task with a goal per episode, .* without",
        ),
    ],
)
def test_a_sensor_with_nothing_to_read_is_refused_before_scenes_are_built(
    task: str, sensor: str, expected: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(worlds, "build_places", lambda *_: pytest.fail("built"))
    with pytest.raises(ValueError, match=rf"^{expected}"):
        build_one_world(load_config([*tiny_overrides(tmp_path, task), f"sensors=[rgb,{sensor}]"]))


def test_a_sensor_that_the_robot_lacks_is_refused() -> None:
    lacks = (
        r"^sensors\.imu: expected a robot with the sensor compass in its MJCF, got quadruped, which has accelerometer,"
    )
    with pytest.raises(ValueError, match=lacks):
        Measured("imu", "quadruped", ["compass"])


def test_a_sensor_that_the_robot_lacks_is_refused_before_scenes_are_built(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(worlds, "build_places", lambda *_: pytest.fail("built"))
    lacks = r"^sensors\.imu: expected .* sensor accelerometer in its MJCF, got wheels, which has no sensors$"
    with pytest.raises(ValueError, match=lacks):
        build_one_world(load_config([*tiny_overrides(tmp_path, "push"), "sensors=[rgb,imu]"]))


@cache
def wheels() -> PhysicsMotion:
    return PhysicsMotion("wheels", "eye", {"ball": "ball"}, ["ball"], threads=1)


def beside(planar: list[float], ball: list[float]) -> Moment:
    """Return wheels at a position and heading, a ball, and a wall that is nearer than x = 1.5 nowhere."""
    motion = wheels()
    state = motion.placed(torch.tensor([planar]))
    state[:, motion.thing("ball")][:, :3] = torch.tensor([ball], dtype=torch.float64)
    wall = Occupancy.from_boxes([[1.5, -3.0, -1.0]], [[1.6, 3.0, 3.0]], 0.05)
    return moment(motion, state)._replace(checker=NativeChecker(wall, Box((0.1, 0.1, 0.1)), 1))


def test_lidar_beams_end_at_the_nearer_of_things_and_walls() -> None:
    height = float(wheels().body_to_world(wheels().home[None])[0, 2, 3])
    ahead = Lidar(beams=4, reach=2.5)  # behind, to the right, ahead, to the left
    seen = ahead.read(beside([0.0, 0.0, 0.0], [1.0, 0.0, height]))
    torch.testing.assert_close(seen, torch.tensor([[2.5, 2.5, 1.0 - 0.09, 2.5]]))
    behind_wall = ahead.read(beside([0.0, 0.0, 0.0], [2.0, 0.0, height]))
    torch.testing.assert_close(behind_wall, torch.tensor([[2.5, 2.5, 1.5, 2.5]]))
    turned = ahead.read(beside([0.0, 0.0, 0.5 * math.pi], [1.0, 0.0, height]))
    torch.testing.assert_close(turned, torch.tensor([[2.5, 1.0 - 0.09, 2.5, 2.5]]))
    beyond = Lidar(beams=4, reach=0.9).read(beside([0.0, 0.0, 0.0], [1.0, 0.0, height]))
    torch.testing.assert_close(beyond, torch.full((1, 4), 0.9))
    within = ahead.read(beside([0.0, 0.0, 0.0], [0.02, 0.0, height]))
    assert (within == 0.0).all()


def test_lidar_beams_pass_over_a_ball_unless_they_point_at_it() -> None:
    motion = wheels()
    here = beside([0.0, 0.0, 0.0], [0.8, 0.6, 0.09])  # where it rests
    x, y, z = (motion.thing("ball").start + axis for axis in range(3))
    way = here.state[0, [x, y, z]] - here.body_to_world[0, :3, 3].double()
    down, left = math.degrees(math.atan2(float(-way[2]), float(way[:2].norm()))), torch.atan2(way[1], way[0])
    scan = Lidar(beams=1, field_deg=0.0, elevation_deg=-down)
    assert Lidar(beams=1, field_deg=0.0).read(here).item() > 1.4, "level beams are higher than the ball"
    assert scan.read(here).item() > 1.4, "the ball is to the left"
    facing = beside([0.0, 0.0, float(left)], here.state[0, [x, y, z]].tolist())
    apart = facing.state[0, [x, y, z]] - facing.body_to_world[0, :3, 3].double()
    assert scan.read(facing).item() == pytest.approx(float(apart.norm()) - 0.09, abs=2e-3)


def test_depth_shows_the_ball_that_a_lidar_sees_and_pushing_it_is_no_contact(tmp_path: Path) -> None:
    chosen = ["sensors=[rgb,depth,lidar,contact]", "sensors.lidar.beams=36", "sensors.lidar.elevation_deg=-20"]
    world = build_one_world(load_config([*tiny_overrides(tmp_path, "push"), *chosen, "robot.image_height=24"]))
    env, motion = world.env(1), world.task.motion
    assert isinstance(motion, PhysicsMotion)
    state = motion.placed(torch.tensor([[-0.8, -1.2, 0.5 * math.pi]]))
    ball = motion.thing("ball")
    state[:, ball.start : ball.start + 2] = torch.tensor([-0.8, -0.7], dtype=torch.float64)
    gone = state.clone()
    gone[:, ball.start + 2] = -9.0
    with_ball, without = (
        env.reset(TensorDict({"state": each}, batch_size=[1]), set_state=True) for each in (state, gone)
    )
    nearer = {key: without[key] - with_ball[key] for key in ("lidar", "depth")}
    assert nearer["lidar"][0].argmax() == 18, "ahead"
    assert nearer["lidar"].max() > 0.1 and (nearer["lidar"] >= 0.0).all()
    assert nearer["depth"].max() > 0.005, "of 10 m"
    after = with_ball
    for _ in range(5):
        after = env.step(after.set("action", torch.tensor([[0.5, 0.0]])))["next"]
        assert not after["contact"].any() and (after["free_fraction"] == 1.0).all()
    assert after["state"][0, ball.start + 1] > -0.65, "the ball was pushed"
    alone = Lidar(36, elevation_deg=-20.0).read(moment(motion, after["state"])._replace(checker=world.checker))
    assert torch.equal(alone, after["lidar"])


def test_yaml_chooses_physics_sensors_for_actor_and_critic(tmp_path: Path) -> None:
    chosen = ["sensors=[rgb,imu,joints,feet,velocity,contact]", "+critic_inputs.next_place=plain"]
    cfg = load_config([*tiny_overrides(tmp_path, "walk"), *chosen])
    world = build_one_world(cfg)
    env = world.env(2)
    td = env.reset()
    assert {key: td[key].shape[1] for key in ("imu", "joints", "feet", "velocity")} == {
        **{"imu": 6, "joints": 24},
        **{"feet": 4, "velocity": 6},
    }
    model = build_model(cfg, env)
    rolled = env.rollout(2, model, break_when_any_done=False)
    again = env.reset(rolled[:, 1].select("state", "imu", "feet", "passed", "next_place"), set_state=True)
    for key in ("imu", "joints", "feet", "velocity"):
        assert torch.equal(again[key], rolled[key][:, 1]), key
