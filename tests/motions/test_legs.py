"""Legged motions: their commands, what they sense, and that a step is a function of the state."""

import math
import re
from collections.abc import Callable
from copy import deepcopy
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import torch

from splatrl.collision.nothing import NoChecker
from splatrl.motions import StridesMotion, WalkMotion
from splatrl.motions.legs import DEPARTURE, FELT, JOINTS
from splatrl.physics import Terrain
from splatrl.physics.robots import mjcf_path
from splatrl.physics.trot import trot

SIDES = ("left", "right")
NOTHING: Any = NoChecker.__new__(NoChecker)


def walking(threads: int = 1, **settings: Any) -> WalkMotion:
    return WalkMotion(path="quadruped", camera="eye", threads=threads, **settings)


@cache
def usual() -> WalkMotion:
    """A walking motion that no test changes."""
    return walking()


@cache
def strides() -> StridesMotion:
    """A motion by strides that no test changes."""
    return StridesMotion(path="quadruped", camera="eye", threads=1)


def walked(motion: WalkMotion, command: tuple[float, float], steps: int) -> torch.Tensor:
    """Return the poses of a robot that follows a command from the origin, which must not fall: [steps + 1, 3]."""
    state, poses = motion.placed(torch.zeros(1, 3)), [torch.zeros(3).double()]
    for _ in range(steps):
        state = motion.move(state, torch.tensor([command]), NOTHING).state
        assert not motion.fallen(state).any()
        poses.append(motion.planar(state)[0])
    return torch.stack(poses)


def test_the_gait_follows_commands_better_than_the_trot_alone() -> None:
    poses = walked(usual(), (0.6, 0.0), 20)
    gone = float((poses[-1] - poses[5])[0]) / 3.0
    trotted = walked(walking(gait=None), (0.6, 0.0), 20)
    assert gone == pytest.approx(0.6, abs=0.1)
    assert abs(float((trotted[-1] - trotted[5])[0]) / 3.0 - 0.6) > 0.15
    turned = walked(usual(), (0.3, 0.6), 15)[:, 2]
    assert float((turned[15] - turned[5]) % math.tau) == pytest.approx(1.2, abs=0.25)


def test_a_step_has_the_same_bytes_in_any_batch_and_order_and_with_any_number_of_threads() -> None:
    motion, draw = usual(), torch.Generator().manual_seed(0)
    state = motion.placed(torch.randn(19, 3, generator=draw).double())  # more than PyTorch vectorises at a time
    command = torch.rand(19, 2, generator=draw)
    for _ in range(2):
        state = motion.move(state, command, NOTHING).state
    whole = motion.move(state, command, NOTHING)
    order = torch.randperm(19, generator=draw)
    assert torch.equal(walking(2).move(state[order], command[order], NOTHING).state, whole.state[order])
    for row in (0, 18):
        alone = motion.move(state[row : row + 1], command[row : row + 1], NOTHING)
        assert torch.equal(alone.state, whole.state[row : row + 1])
        assert torch.equal(alone.body_to_world, whole.body_to_world[row : row + 1])


def test_a_walk_equals_strides_with_the_departures_of_the_gait() -> None:
    walk, other = usual(), strides()
    state = walk.placed(torch.tensor([[0.1, 0.2, 0.3]]))
    command = torch.tensor([[0.5, -0.2]])
    after = walk.move(state, command, NOTHING).state
    assert walk.gait is not None and walk.strides == 10
    state = walk.commanded(state, command)
    for _ in range(10):
        state = other.move(state, walk.gait(walk.felt(state)), NOTHING).state
    assert torch.equal(state, after)


def test_the_weights_of_the_gait_stay_on_the_device_of_the_motion() -> None:
    gait = deepcopy(usual()).to("meta").gait  # a device that every machine has
    assert gait is not None and {each.device.type for layer in gait.layers for each in layer} == {"meta"}
    assert gait(torch.zeros(3, FELT, device="meta")).shape == (3, JOINTS)


def test_joint_commands_are_the_trot_plus_clamped_departures(monkeypatch: pytest.MonkeyPatch) -> None:
    motion = strides()
    state = motion.commanded(motion.placed(torch.zeros(1, 3)), torch.tensor([[0.4, 0.1]]))
    state[:, motion.lead] = 0.1
    departure = torch.linspace(-2.0, 1.0, JOINTS).unsqueeze(0)
    told: list[torch.Tensor] = []
    step = motion.physics.step
    monkeypatch.setattr(motion.physics, "step", lambda states, ctrl: (told.append(ctrl), step(states, ctrl))[1])
    after = motion.stride(state, departure).state
    trotting = trot(state[:, motion.layout.clock] + 0.1, torch.tensor([[0.4, 0.1]]).double())
    expected = trotting + DEPARTURE * departure.clamp(-1, 1)
    assert torch.allclose(told[0], expected, atol=1e-6)
    assert torch.allclose(motion.departure(after), departure.clamp(-1, 1).double())
    assert torch.equal(motion.command(after), motion.command(state))
    phase = math.tau * 3.0 * torch.tensor(0.12)
    assert motion.felt(after)[0, 44:].tolist() == pytest.approx([phase.sin().item(), phase.cos().item()], abs=1e-5)


def test_sensed_values_are_in_the_body_frame() -> None:
    motion = strides()
    standing = motion.placed(torch.tensor([[0.0, 0.0, 2.0]]))
    felt = motion.felt(standing)
    assert felt.shape == (1, FELT) and torch.allclose(felt[0, :3], torch.tensor([0.0, 0.0, -1.0]), atol=1e-6)
    assert felt[0, 3:44].abs().max() < 1e-6 and felt[0, 44:].tolist() == pytest.approx([0.0, 1.0])
    state = standing.clone()
    half = torch.tensor(0.25).double()
    state[0, motion.layout.orientation] = torch.tensor([half.cos(), half.sin(), 0.0, 0.0])  # rolled by 0.5 to the right
    state[0, motion.layout.joints][2] += 0.1
    state[0, motion.layout.angular_velocity][0] = 2.0
    state[0, motion.layout.joint_rates][2] = -3.0
    felt = motion.felt(state)[0]
    assert felt[:3].tolist() == pytest.approx([0.0, -math.sin(0.5), -math.cos(0.5)], abs=1e-6)
    assert felt[3].item() == pytest.approx(0.5) and felt[6 + 2].item() == pytest.approx(0.1)
    assert felt[18 + 2].item() == pytest.approx(-0.15)
    moved = motion.placed(torch.tensor([[5.0, -3.0, 0.7]]))
    assert torch.allclose(motion.felt(moved), motion.felt(standing), atol=1e-6)  # at any position


def test_a_lying_robot_has_fallen_and_one_that_stands_on_high_ground_has_not() -> None:
    motion = walking()
    motion.stand_on(Terrain(torch.tensor([0.0, 0.0, 1.0, 2.0]).double(), torch.zeros(0, 6).double()))
    state = motion.placed(torch.zeros(1, 3))
    assert not motion.fallen(state).any()
    assert motion.clear(state).all()
    state[0, motion.layout.position][2] -= 0.2
    assert motion.fallen(state).all()
    assert motion.fallen(torch.full_like(state, torch.nan)).all()


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"time_step": 0.05}, r"task\.motion\.time_step: expected a multiple of 0\.02 s, got 0\.05"),
        ({"forward": (0.1, 0.8)}, r"task\.motion\.forward: expected -2 ≤ lowest ≤ 0 < highest ≤ 2 m/s"),
        ({"ground": "moon"}, r"task\.motion\.ground: expected scene or level, got 'moon'"),
    ],
)
def test_invalid_settings_are_refused(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        walking(**settings)


LEG = '      <body name="front_{}_hip".*?\n      </body>\n'


def right_first(text: str) -> str:
    """Swap the front legs, as robots of Unitree have them."""
    left, right = (re.search(LEG.format(side), text, re.DOTALL) for side in ("left", "right"))
    assert left and right
    return text.replace(left[0] + right[0], right[0] + left[0])


MOTOR = r'<motor name="\1" joint="\1" ctrlrange="-30 30"/>'
JOINT = '<joint name="{}" class="calf"/>'
SERVO = '<position name="{0}" joint="{1}" class="calf"/>'


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (right_first, "in its order, with 'front_left_hip' as number 1, got 'front_right_hip'"),
        (
            lambda text: text.replace(JOINT.format("rear_right_calf"), JOINT.format("knee")).replace(
                SERVO.format("rear_right_calf", "rear_right_calf"), SERVO.format("knee", "knee")
            ),
            "with 'rear_right_calf' as number 12, got 'knee'",
        ),
        (
            lambda text: text.replace(*(SERVO.format("rear_left_calf", f"rear_{side}_calf") for side in SIDES)),
            "actuator 9 to be a <position> servo of the joint 'rear_left_calf', got one of 'rear_right_calf'",
        ),
        (
            lambda text: re.sub(r'<position name="(\w+)" joint="\w+" class="\w+"/>', MOTOR, text),
            "actuator 1 to be a <position> servo of the joint 'front_left_hip', got another kind of actuator",
        ),
        (
            lambda text: text.replace('joint="front_left_thigh"', 'joint="front_left_thigh" gear="-1"'),
            "actuator 2 to be a <position> servo of the joint 'front_left_thigh', got another kind of actuator",
        ),
    ],
)
def test_legs_and_actuators_in_another_order_or_of_another_kind_are_refused_by_the_first(
    tmp_path: Path, change: Callable[[str], str], message: str
) -> None:
    path, text = tmp_path / "dog.xml", mjcf_path("quadruped").read_text()
    path.write_text(change(text))
    assert path.read_text() != text
    with pytest.raises(ValueError, match=rf"dog\.xml: expected .*{re.escape(message)}$"):
        WalkMotion(path=path, camera="eye", threads=1)


def test_other_robots_and_gaits_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"wheels\.xml: expected the 12 joints of quadruped, got 2"):
        WalkMotion(path="wheels", camera="eye", threads=1)
    with pytest.raises(
        FileNotFoundError, match=r"nothing: expected a weights file, or one of quadruped; found neither"
    ):
        walking(gait="nothing")
