"""Motions of a four-legged robot that trots: actions either offset its joints from the trot or say where to walk."""

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from splatrl.collision.base import Checker
from splatrl.geometry import along_heading
from splatrl.motions.base import Move
from splatrl.motions.physics import PhysicsMotion
from splatrl.motions.simulated import TILTED
from splatrl.physics import Terrain
from splatrl.physics.dense import Dense
from splatrl.physics.kinematics import rotated, turned_back
from splatrl.physics.robots import gait_path
from splatrl.physics.stepping import Stepped
from splatrl.physics.trot import FREQUENCY, NAMES, trot
from splatrl.values import require_number

STRIDE = 0.02
"""Duration for which joint targets are held, seconds."""
JOINTS = len(NAMES)
COMMAND = 2
"""Size of a command: metres per second ahead and radians per second to the left."""
DEPARTURE = 0.25
"""Largest offset of a joint from the trot, radians."""
FELT = 46
"""Size of the proprioceptive observation."""
SPIN, RATE = 0.25, 0.05
"""Factors that scale the angular velocities of torso and joints to about the magnitude of the other observations."""
LOW = 0.14
"""Height of the torso above the ground at or below which a robot has fallen, metres."""


class LegsMotion(PhysicsMotion):
    """Base of the legged motions: a trot, to which joint offsets are added fifty times a second.

    A state is [n + 13 + 2 K] float64: the state of ``PhysicsMotion``; the last offsets of the joints from the trot, as
    fractions of 0.25 radians; how far the trot is ahead of the physics' time, seconds; and K commands that are followed
    one after the other, in metres per second ahead and radians per second to the left. The active command follows from
    the physics' time.

    Args:
        commands: number of commands, K.
        span: duration for which each of several commands is followed, seconds.
        forward: lowest and highest commanded speed ahead, metres per second.
        turn: highest commanded angular velocity in either direction, radians per second.
        options: arguments of ``PhysicsMotion``.

    Raises:
        ValueError: for a robot without the twelve joints of ``quadruped`` in its order, each held by a position servo,
            or anything that ``PhysicsMotion`` refuses.
    """

    def __init__(
        self,
        forward: Sequence[float] = (0.0, 0.8),
        turn: float = 0.8,
        commands: int = 1,
        span: float = 2.5,
        **options: Any,
    ):
        if len(forward) != 2 or not -2.0 <= forward[0] <= 0.0 < forward[1] <= 2.0:
            raise ValueError(f"task.motion.forward: expected -2 ≤ lowest ≤ 0 < highest ≤ 2 m/s, got {list(forward)}")
        require_number("task.motion.turn", turn, 0.01, 4.0)
        require_number("task.motion.commands", commands, 1, 1000, whole=True)
        require_number("task.motion.span", span, STRIDE, 1e3)
        self.commands, self.span = commands, float(span)
        self.forward_limits, self.turn_limit = tuple(float(value) for value in forward), float(turn)
        given: dict[str, Any] = {"linear": forward, "angular_deg": math.degrees(turn)} | {
            key: value for key, value in options.items() if value is not None
        }
        super().__init__(**given)

    @property
    def held(self) -> float:
        """Duration for which joint targets are held, seconds."""
        return STRIDE

    @property
    def lead(self) -> int:
        """Column of how far the trot is ahead of the physics' time, seconds."""
        return self.physics.size + JOINTS

    def stand_on(self, terrain: Terrain) -> None:
        """Put the robot on a terrain; see ``PhysicsMotion``."""
        super().stand_on(terrain)
        self.layout = replace(self.layout, hinges=JOINTS)
        self._check_joints()
        self.angles = self.limits
        self.home = torch.cat([self.home, self.home.new_zeros(JOINTS + 1 + COMMAND * self.commands)])
        self.stand = self.home[self.layout.joints]
        self.limits = self.action_limits()

    def action_limits(self) -> Tensor:
        """Return the lowest and highest actions, [2, A] float32; by default those are offsets from the trot."""
        one = torch.ones(1, JOINTS, device=self.home.device)
        return torch.cat([-one, one])

    def _check_joints(self) -> None:
        """Refuse a robot without the joints of ``quadruped``, in the same order, each held by a position servo."""
        joints, servos = self.world.robot_joints(), self.world.position_servos()
        for what, found in (("joints", joints), ("actuators", servos)):
            if len(found) != JOINTS:
                raise ValueError(f"{self.path}: expected the {JOINTS} {what} of quadruped, got {len(found)}")
        for number, name in enumerate(NAMES):
            if joints[number] != name:
                raise ValueError(
                    f"{self.path}: expected the joints of quadruped in its order, with {name!r} as number "
                    f"{number + 1}, got {joints[number]!r}"
                )
            if servos[number] != name:
                raise ValueError(
                    f"{self.path}: expected actuator {number + 1} to be a <position> servo of the joint {name!r}, got "
                    + (f"one of {servos[number]!r}" if servos[number] else "another kind of actuator")
                )

    def departure(self, state: Tensor) -> Tensor:
        """Return the last joint offsets from the trot: [B, n] -> [B, 12] float64."""
        return state[:, self.physics.size : self.lead]

    def trot_time(self, state: Tensor) -> Tensor:
        """Return the time since the start of some cycle of the trot: [B, n] -> [B] float64, seconds."""
        return state[:, self.layout.clock] + state[:, self.lead]

    def command(self, state: Tensor) -> Tensor:
        """Return the active command: [B, n] -> [B, 2] float64."""
        each = state[:, self.lead + 1 :].unflatten(1, (self.commands, COMMAND))
        middle = state[:, self.layout.clock] + 0.5 * STRIDE  # of the stride, where rounding of the time does not matter
        turn = (middle / self.span).nan_to_num().long().clamp(0, self.commands - 1)
        return each[torch.arange(len(state), device=state.device), turn]

    def commanded(self, state: Tensor, commands: Tensor) -> Tensor:
        """Replace the commands in states: [B, n], [B, 2 K] -> [B, n]."""
        return torch.cat([state[:, : self.lead + 1], commands.to(state)], 1)

    def stride(self, state: Tensor, departure: Tensor) -> Stepped:
        """Follow the command for 20 ms, with the joints offset from the trot: [B, n], [B, 12]."""
        departure = departure.to(state).clamp(-1.0, 1.0)
        angles = trot(self.trot_time(state), self.command(state)) + DEPARTURE * departure
        low, high = self.angles.to(state)
        after, sensed, sound = self.physics.step(
            self.of_physics(state), torch.minimum(torch.maximum(angles, low), high)
        )
        return Stepped(torch.cat([after, departure, state[:, self.lead :]], 1), sensed, sound)

    def level_velocity(self, state: Tensor) -> Tensor:
        """Return velocity ahead and to the left, and yaw rate: [B, n] -> [B, 3] float64, metres and radians per second.

        The first two are horizontal, relative to the heading.
        """
        level = along_heading(state[:, self.layout.velocity][:, :2], self.planar(state)[:, 2])
        turn = rotated(state[:, self.layout.orientation], state[:, self.layout.angular_velocity])[:, 2:]
        return torch.cat([level, turn], 1)

    def felt(self, state: Tensor) -> Tensor:
        """Return the proprioceptive observation: [B, n] -> [B, 46] float32.

        It consists of the direction of gravity and the angular velocity in the torso's frame, the joint angles relative
        to the standing pose, the joint velocities, the last joint offsets, the command, and sine and cosine of the
        trot's phase.
        """
        layout, down = self.layout, state.new_tensor([0.0, 0.0, -1.0]).expand(len(state), 3)
        phase = math.tau * FREQUENCY * self.trot_time(state)
        parts = [
            rotated(turned_back(state[:, layout.orientation]), down),
            SPIN * state[:, layout.angular_velocity],
            state[:, layout.joints] - self.stand.to(state),
            RATE * state[:, layout.joint_rates],
            self.departure(state),
            self.command(state),
            torch.stack([phase.sin(), phase.cos()], 1),
        ]
        return torch.cat(parts, 1).float()

    def fallen(self, state: Tensor) -> Tensor:
        """Return whether robots have fallen: [B, n] -> [B] bool."""
        return ~((self.upright(state) > TILTED) & (self.above_ground(state) > LOW))


class StridesMotion(LegsMotion):
    """Legs whose actions are the joints' offsets from a trot, every 20 ms.

    An action is [12] float32 in [-1, 1], fractions of 0.25 radians: hip, thigh and calf of the front left, front right,
    rear left and rear right leg. The command is part of the state; see ``LegsMotion``.
    """

    def __init__(self, **options: Any):
        if not math.isclose(float(options.setdefault("time_step", STRIDE)), STRIDE):
            raise ValueError(f"task.motion.time_step: expected {STRIDE:g} s, got {options['time_step']}")
        super().__init__(**options)

    def move(self, state: Tensor, action: Tensor, checker: Checker) -> Move:
        """Advance by one 20 ms stride; see ``Motion``."""
        after, sensed, sound = self.stride(state, action)
        return self.moved(after, sensed, sound)


class WalkMotion(LegsMotion):
    """Legs whose actions are velocity commands, which a blind walking policy follows.

    An action is [2] float32: metres per second ahead and radians per second to the left, held for a time step, in which
    the policy chooses the joints' offsets from the trot every 20 ms.

    Args:
        gait: file of the policy's weights (``Dense``), or the name of one of splatrl's own; None trots without a
            policy.
        time_step: duration of an action, seconds, a multiple of 0.02.
        options: arguments of ``LegsMotion``.

    Raises:
        ValueError: for weights of another size, or anything that ``LegsMotion`` refuses.
    """

    def __init__(self, gait: str | Path | None = "quadruped", time_step: float = 0.2, **options: Any):
        require_number("task.motion.time_step", time_step, STRIDE, 10.0)
        self.strides = round(time_step / STRIDE)
        if not math.isclose(self.strides * STRIDE, time_step):
            raise ValueError(f"task.motion.time_step: expected a multiple of {STRIDE:g} s, got {time_step:g}")
        super().__init__(time_step=time_step, **options)
        self.driven, self.gait = True, None if gait is None else Dense.load(gait_path(str(gait)), FELT, JOINTS)

    def action_limits(self) -> Tensor:
        """Return the lowest and highest commands: [2, 2] float32."""
        low, high = self.forward_limits
        return torch.tensor([[low, -self.turn_limit], [high, self.turn_limit]], device=self.home.device)

    def move(self, state: Tensor, action: Tensor, checker: Checker) -> Move:
        """Walk for a time step; see ``Motion``."""
        state, each = self.commanded(state, action.clamp(self.limits[0], self.limits[1])), []
        whole = torch.ones(len(state), dtype=torch.bool, device=state.device)
        for _ in range(self.strides):
            none = state.new_zeros(len(state), JOINTS)
            departure = none if self.gait is None else self.gait(self.felt(state))
            state, sensed, sound = self.stride(state, departure)
            each.append(sensed)
            whole &= sound
        return self.moved(state, torch.cat(each, 1), whole)
