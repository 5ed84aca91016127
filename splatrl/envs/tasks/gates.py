"""The gates task: a quadrotor flies through a track of gates."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace

import torch
from torch import Tensor
from torchrl.data import TensorSpec, Unbounded

from splatrl.envs.tasks.base import Anywhere, Mark, Memory, Outcome, Step, TaskModule, Verdict
from splatrl.envs.tasks.rewards import FiniteRewards
from splatrl.geometry import axis_rotations, rigid
from splatrl.motions.physics import FIRST, PhysicsMotion
from splatrl.physics.bank import bank
from splatrl.physics.pilot import Flying, fly_through
from splatrl.physics.room import drawn_once
from splatrl.physics.stepping import Physics
from splatrl.physics.tracks import TrackSettings, draw_tracks
from splatrl.renderers.parts import Parts
from splatrl.scenes.gaussians import Gaussians
from splatrl.spherical_harmonics import C0
from splatrl.values import require_number

LOW = 0.08
"""Height above the ground below which a quadrotor has crashed, metres."""
JITTER = 0.1
"""Largest distance of a start from that of its track along each axis, metres."""
TURNED = 0.2
"""Largest angle between a start's heading and the way to the first gate, radians."""


@dataclass(frozen=True)
class GatesRewards(FiniteRewards):
    """The reward of a step, which adds up.

    Attributes:
        progress: for each metre by which the quadrotor came nearer to the next gate.
        gate: for a gate that was passed.
        crash: for touching anything, or leaving the bounds.
        slack: of every step.

    Raises:
        ValueError: for a reward that is not a finite number.
    """

    progress: float = 1.0
    gate: float = 1.0
    crash: float = -3.0
    slack: float = -0.01


class Gates(TaskModule):
    """Fly through all gates of a track in order, as FalconGym's quadrotor does, seen by its camera.

    The gates stand in the scene, in the picture and as boxes to bump into. The next one is lit. A gate is passed when
    the straight line of the quadrotor's centre over a step crosses its opening along its yaw; others count nothing.

    Observation: ``pixels`` [B, H, W, 3] uint8, the ego view.
    Action: the motion's: of ``quadrotor`` [B, 4] float32, thrust in weights of its own and three body rates, rad/s.
    Reward: [B, 1] float32, see ``GatesRewards``.
    Termination: at the last gate, which is a success; where anything is touched; where the quadrotor leaves the bounds
        or the ceiling.
    Truncation: after ``max_steps`` steps.
    State: [B, n] float64, the physics' (``PhysicsMotion``), whose first number is that of the track. Memory: ``gate``
        [B, 1] int64, how many were passed; ``gate_place`` [B, 4] float32, centre and yaw of the next, world, metres and
        radians, for sensors and for those who train a critic on it.

    Tracks are drawn in the scene by ``seed``. Training flies the first ``tracks``, tests those after them.

    Example:
        >>> import splatrl
        >>> env = splatrl.make_env(["task=gates", "task.tracks=1", "task.test_tracks=1"], batch_size=[2])
        >>> env.rollout(3, break_when_any_done=False)["gate"].flatten().tolist()
        [0, 0, 0, 0, 0, 0]

    Args:
        motion: how the robot moves; its things are the gates of one track, and nothing else.
        rewards: see ``GatesRewards``.
        track: what tracks are like.
        tracks: number of tracks of training.
        test_tracks: number of tracks of tests.
        seed: of the tracks.
        lit: colour of the next gate, red, green and blue in [0, 1].
        max_steps: an episode is truncated after this many steps.

    Raises:
        ValueError: for a motion without physics, without a ceiling, or with other things than the track's gates, or a
            number out of range.
    """

    chooses_episodes = True
    motion: PhysicsMotion
    places: Tensor  # [N, 1 + G, 4] float64, start and gates of each track: x, y, z and yaw

    def __init__(
        self,
        motion: PhysicsMotion,
        rewards: GatesRewards | None = None,
        track: TrackSettings | None = None,
        tracks: int = 48,
        test_tracks: int = 32,
        seed: int = 0,
        lit: tuple[float, float, float] = (1.0, 0.45, 0.05),
        max_steps: int = 400,
    ):
        if not isinstance(motion, PhysicsMotion):
            raise ValueError(f"task.motion: expected one with physics, got {type(motion).__name__}")
        super().__init__(motion, max_steps)
        self.rewards, self.track = rewards or GatesRewards(), track or TrackSettings()
        for name, value in (("tracks", tracks), ("test_tracks", test_tracks)):
            require_number(f"task.{name}", value, 1, 2048, whole=True)
        require_number("task.seed", seed, 0, 2**63 - 1, whole=True)
        if motion.ceiling is None:
            raise ValueError("task.motion.ceiling: expected metres, got None")
        if len(motion.thing_paths) != self.track.gates:
            raise ValueError(
                f"task.motion.things: expected the {self.track.gates} gates of a track, got {len(motion.thing_paths)}"
            )
        self.tracks, self.test_tracks, self.seed, self.lit = tracks, test_tracks, seed, tuple(map(float, lit))
        self.goals_for_success = self.track.gates
        self.register_buffer("places", torch.zeros(0, 0, 4, dtype=torch.float64), persistent=False)

    def settle(self) -> None:
        """Draw the tracks, after the motion was put into a scene, and give each a model of its own.

        Raises:
            ValueError: where there is no room for a track.
        """
        motion, many, ceiling = self.motion, self.tracks + self.test_tracks, self.motion.ceiling
        assert ceiling is not None
        where = motion.twin.lower.tolist(), motion.twin.upper.tolist(), ceiling
        places = drawn_once(
            "tracks",
            motion.terrain,
            [*where, asdict(self.track), many, self.seed],
            lambda: draw_tracks(motion.terrain, *where, self.track, many, self.seed),
        )
        self.places = torch.from_numpy(places).to(self.places.device)
        models = bank(motion.physics.models[0], replace(motion.variation, models=many))
        for model, gates in zip(models, places[:, 1:], strict=True):
            for name, (x, y, z, yaw) in zip(motion.thing_paths, gates, strict=True):
                body = model.body(motion.world.things[name]).id
                model.body_pos[body] = x, y, z
                model.body_quat[body] = math.cos(0.5 * yaw), 0.0, 0.0, math.sin(0.5 * yaw)
        motion.physics = Physics(models, motion.physics.substeps, motion.threads)

    @property
    def models(self) -> list[Gaussians]:
        """The robot's links, a gate, and a gate that is lit."""
        own, gate = self.motion.models[: -self.track.gates], self.motion.models[-1]
        lit = gate.clone()
        shade = (gate.sh[:, :1] * C0 + 0.5).mean(2, keepdim=True)
        lit.sh = ((torch.tensor(self.lit) * shade / shade.amax() - 0.5) / C0).float()
        return [*own, gate, lit]

    @property
    def memory_spec(self) -> Mapping[str, TensorSpec]:
        """See the class."""
        return {
            "gate": Unbounded(shape=(1,), dtype=torch.int64),
            "gate_place": Unbounded(shape=(4,), dtype=torch.float32),
        }

    def start(self, state: Tensor, anywhere: Anywhere) -> Tensor:
        """Begin the tracks of training; see ``Task.start``."""
        rows = torch.randint(self.tracks, (len(state),), generator=anywhere.generator, device=state.device)
        return self._begun(rows, anywhere.generator)

    def begin(self, state: Tensor, anywhere: Anywhere) -> Memory:
        """No gate was passed; see ``Task.begin``."""
        passed = torch.zeros(len(state), dtype=torch.int64, device=state.device)
        return self._memory(state, passed)

    def episodes(self, starts: Tensor, count: int, seed: int) -> dict[str, Tensor]:
        """Starts of the tracks of tests, in turn; see ``ChoosingTask``."""
        generator = torch.Generator().manual_seed(seed)
        state = self._begun(self.tracks + torch.arange(count) % self.test_tracks, generator)
        return {"state": state, **self.begin(state, Anywhere(lambda: state, generator))}

    def judge(self, step: Step, anywhere: Anywhere) -> Verdict:
        """Judge a step; see ``Task.judge``."""
        rewards, after, passed = self.rewards, step.move.state, step.memory["gate"].squeeze(1)
        gate = self._gate(after, passed)
        was, now = step.before[:, FIRST : FIRST + 3], after[:, FIRST : FIRST + 3]
        through = self._through(was, now, gate)
        height = now[:, 2] - self.motion.terrain.height(now[:, :2])
        crashed = (step.move.free_fraction < 1) | (height < LOW)
        outside = ~crashed & (~step.move.inside | (height > (self.motion.ceiling or math.inf)))
        through = through & ~crashed & ~outside
        far = [(place - gate[:, :3]).norm(dim=1) for place in (was, now)]
        nearer = far[0] - torch.where(through, 0.0, far[1])
        passed = passed + through
        finished = passed >= self.track.gates
        reward = rewards.progress * nearer + rewards.gate * through + rewards.crash * (crashed | outside)
        outcome = torch.where(through, Outcome.GOAL, Outcome.RUNNING)
        outcome = torch.where(outside, Outcome.OUT_OF_BOUNDS, torch.where(crashed, Outcome.COLLISION, outcome))
        terminated = finished | crashed | outside
        reward = (reward + rewards.slack).float().unsqueeze(1)
        return Verdict(reward, terminated.unsqueeze(1), outcome.unsqueeze(1), self._memory(after, passed))

    def teach(self, state: Tensor, memory: Memory) -> Tensor:
        """What a pilot that knows the state would do: [B, n] -> [B, 4]; see ``fly_through``."""
        velocity = FIRST + int(self.motion.physics.model.nq)
        flying = Flying(state[:, FIRST : FIRST + 3], state[:, FIRST + 3 : FIRST + 7], state[:, velocity : velocity + 3])
        return fly_through(flying, self._gate(state, memory["gate"].squeeze(1)), self.motion.limits)

    def parts(self, state: Tensor, memory: Memory) -> Parts:
        """The scene, the robot and the gates of its track, the next one lit; see ``Task.parts``."""
        moving, gates, own = self.motion.parts(state), self.track.gates, len(self.motion.models) - self.track.gates
        x, y, z, yaw = self.places.to(state.device)[self.motion.model_of(state), 1:].unbind(2)
        poses = rigid(axis_rotations(2, yaw), torch.stack([x, y, z], 2)).float()
        next_one = torch.arange(gates, device=state.device) == memory["gate"]
        model = torch.where(next_one, own + 2, own + 1)
        kept = 1 + own
        return Parts(
            torch.cat([moving.model[:, :kept], model], 1), torch.cat([moving.model_to_world[:, :kept], poses], 1)
        )

    def marks(self, memory: Memory | None = None) -> list[Mark]:
        """The next gate; see ``Task.marks``."""
        if memory is None:
            return []
        return [Mark("gate", memory["gate_place"][[0, 1, 3]].double().cpu())]

    def _begun(self, rows: Tensor, generator: torch.Generator) -> Tensor:
        """States that hover near the starts of some tracks: [B] -> [B, n]."""
        start = self.places[rows, 0]
        off = 2.0 * torch.rand(len(rows), 4, generator=generator, device=start.device, dtype=torch.float64) - 1.0
        planar = start[:, [0, 1, 3]] + off[:, [0, 1, 3]] * off.new_tensor([JITTER, JITTER, TURNED])
        state = self.motion.placed(planar)
        state[:, FIRST + 2] = start[:, 2] + JITTER * off[:, 2]
        return self.motion.with_model(state, rows)

    def _gate(self, state: Tensor, passed: Tensor) -> Tensor:
        """Centre and yaw of the next gate of each state, the last one after it was passed: [B, 4] float64."""
        number = 1 + passed.clamp(0, self.track.gates - 1)
        return self.places[self.motion.model_of(state), number]

    def _memory(self, state: Tensor, passed: Tensor) -> Memory:
        return {"gate": passed.unsqueeze(1), "gate_place": self._gate(state, passed).float()}

    def _through(self, was: Tensor, now: Tensor, gate: Tensor) -> Tensor:
        """Whether straight ways cross the openings of gates along their yaw: [B, 3], [B, 3], [B, 4] -> [B] bool."""
        cos, sin = gate[:, 3].cos(), gate[:, 3].sin()
        a, b = was - gate[:, :3], now - gate[:, :3]
        before, after = (cos * p[:, 0] + sin * p[:, 1] for p in (a, b))
        crosses = (before < 0.0) & (after >= 0.0)
        share = before / torch.where(crosses, before - after, 1.0)
        at = a + share.unsqueeze(1) * (b - a)
        half = 0.5 * self.track.opening
        return crosses & ((cos * at[:, 1] - sin * at[:, 0]).abs() < half) & (at[:, 2].abs() < half)
