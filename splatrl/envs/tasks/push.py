"""The push task: a robot with a body pushes a ball to a marked place."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy import ndimage
from torch import Tensor
from torchrl.data import TensorSpec, Unbounded

from splatrl.envs.tasks.base import Anywhere, Mark, Memory, Outcome, Step, TaskModule, Verdict
from splatrl.envs.tasks.push_teacher import pushing
from splatrl.envs.tasks.rewards import FiniteRewards
from splatrl.geometry import rigid
from splatrl.motions.physics import PhysicsMotion
from splatrl.physics.gaussians import Models
from splatrl.physics.kinematics import matrices
from splatrl.physics.marks import beacon
from splatrl.renderers.parts import Parts
from splatrl.scenes.gaussians import Gaussians
from splatrl.values import require_number, require_rgb

CELL = 0.05
"""Distance between the places where a ball or a mark can be, metres."""
TRIES = 128
"""Places drawn for each ball and mark, of which the first that fits is taken."""
NEAR = 0.35
"""Distance to the ball within which coming nearer is not rewarded: there is room to go round it, metres."""
AROUND = 0.25
"""What half a way round the ball is worth, as metres of approach."""
FAR = 9.0
"""Metres: no need to know more precisely."""
WIDTH = 0.25
"""Distance from what is solid at which robots can pass, metres."""
SIGHT = 12
"""Points of a line that are looked up to see whether anything stands in the way."""
CHUNK = 1024
"""Robots whose places are compared at a time."""
LIFT = 0.02
"""How far a mark lies above the ground, metres: ground is grass, too."""


@dataclass(frozen=True)
class PushRewards(FiniteRewards):
    """The reward of a step, which adds up.

    Attributes:
        progress: for each metre by which the ball came nearer to the mark.
        approach: for each metre by which the robot came nearer to where it can push the ball towards the mark.
        touch: of a step in which the robot touches something else.
        slack: of every step.
        success: for the ball at the mark.
        lost: for leaving the place, or for a ball that did.

    Raises:
        ValueError: for a reward that is not a finite number.
    """

    progress: float = 2.0
    approach: float = 1.0
    touch: float = -0.02
    slack: float = -0.01
    success: float = 3.0
    lost: float = -1.0


class Push(TaskModule):
    """Push a ball onto a mark on the ground, as NeRF2Real's humanoid does (Byravan et al. 2023), on wheels.

    Observation: ``pixels`` [B, H, W, 3] uint8, the ego view; ball and mark are in it, hidden by what is nearer.
    Action: the motion's: of ``wheels`` linear and angular velocity, [B, 2] float32, metres and radians per second.
    Reward: [B, 1] float32, see ``PushRewards``. The approach is measured by the distance to the ball, where it is more
        than 0.35 m, and by how far the robot is from the side away from the mark.
    Termination: where the ball's centre is within ``success_distance`` of the mark's, which is a success; or where
        robot or ball leave the bounds by more than ``leeway``. A robot that touches something goes on.
    Truncation: after ``max_steps`` steps.
    State: [B, n] float64, the physics' (``PhysicsMotion``). Memory: ``mark`` [B, 3] float32, world, metres; ``ball``
        [B, 3] float32, where the ball is, for sensors and for those who train a critic on it.

    A mark is a disc, and a ball above it that is seen from far and over the one that is pushed; neither touches
    anything. Ball and mark are drawn for each episode, on the ground, where the robot can go round them.

    Example:
        >>> import splatrl
        >>> env = splatrl.make_env(["task=push"], batch_size=[4])
        >>> env.rollout(3, break_when_any_done=False)["mark"].shape
        torch.Size([4, 3, 3])

    Args:
        motion: how the robot moves; its things have the ball among them.
        ball: name of the thing that is pushed.
        rewards: see ``PushRewards``.
        success_distance: between the centres of ball and mark, metres.
        nearest: distance between ball and mark in the beginning, at least, metres.
        farthest: at most, metres.
        apart: distance between robot and ball in the beginning, at least, metres.
        ahead_deg: the ball begins within this angle of where the robot looks, in either direction; degrees.
        turn_deg: angle at the ball, at most, between the way on from the robot and the way to the mark; 180 puts marks
            anywhere, also behind the robot, which then has to drive round the ball.
        clearance: between a ball or mark and what is solid, at least, metres.
        mark_radius: of what is drawn, metres.
        mark_rgb: its colour.
        mark_height: of the ball that hovers above the mark, metres.
        leeway: see above, metres.
        max_steps: an episode is truncated after this many steps.

    Raises:
        ValueError: for a motion without physics or without the ball, or a number out of range.
    """

    chooses_episodes = True
    motion: PhysicsMotion
    places: Tensor  # [P, 2] float64, where a ball or mark can be
    way: Tensor  # [X, Y] bool, the cells in which robots can be
    clear: Tensor  # [X', Y'] float64, metres to what is solid or to where a robot is lost, over bounds and leeway

    def __init__(
        self,
        motion: PhysicsMotion,
        ball: str = "ball",
        rewards: PushRewards | None = None,
        success_distance: float = 0.15,
        nearest: float = 0.5,
        farthest: float = 1.5,
        apart: float = 0.4,
        ahead_deg: float = 40.0,
        turn_deg: float = 180.0,
        clearance: float = 0.4,
        mark_radius: float = 0.15,
        mark_rgb: Sequence[float] = (0.85, 0.1, 0.75),
        mark_height: float = 0.45,
        leeway: float = 0.5,
        max_steps: int = 150,
    ):
        if not isinstance(motion, PhysicsMotion):
            raise ValueError(f"task.motion: expected one with physics, got {type(motion).__name__}")
        super().__init__(motion, max_steps)
        numbers = {"success_distance": success_distance, "mark_radius": mark_radius, "farthest": farthest}
        for name, value in numbers.items():
            require_number(f"task.{name}", value, 1e-6, 1e6)
        least = {"apart": apart, "clearance": clearance, "leeway": leeway, "nearest": nearest}
        for name, value in {**least, "mark_height": mark_height}.items():
            require_number(f"task.{name}", value, 0.0, 1e6)
        require_number("task.ahead_deg", ahead_deg, 0.0, 180.0)
        require_number("task.turn_deg", turn_deg, 0.0, 180.0)
        if not success_distance < nearest < farthest:
            raise ValueError(
                f"task.nearest: expected success_distance < nearest < farthest, got {success_distance}, {nearest} and "
                f"{farthest}"
            )
        self.ball, self.rewards = motion.thing(ball), rewards or PushRewards()
        self.success_distance, self.nearest, self.farthest = success_distance, nearest, farthest
        self.apart, self.ahead, self.clearance = apart, math.radians(ahead_deg), clearance
        self.turn = math.cos(math.radians(turn_deg)) - 1e-9
        require_rgb("task.mark_rgb", mark_rgb)
        self.leeway, self.drawn = leeway, Models([beacon(mark_radius, mark_rgb, mark_height)])
        self.rest = float(motion.home[self.ball][2])  # of the ball's centre above the ground
        self.register_buffer("places", torch.zeros(0, 2, dtype=torch.float64), persistent=False)
        self.register_buffer("way", torch.zeros(0, 0, dtype=torch.bool), persistent=False)
        self.register_buffer("clear", torch.zeros(0, 0, dtype=torch.float64), persistent=False)
        self.settle()

    def settle(self) -> None:
        """Find where a ball or mark can be, after the motion was put into a scene.

        Raises:
            ValueError: where there are not two places as far from each other as asked.
        """
        lower, upper = self.motion.twin.lower.double(), self.motion.twin.upper.double()
        grid = _grid(lower, upper, 1e-9)
        away = self._away(grid.reshape(-1, 2)).reshape(grid.shape[:2])
        ways, _ = ndimage.label((away >= WIDTH).numpy())
        sizes = np.bincount(ways.ravel())[1:]
        way = ways == 1 + sizes.argmax() if len(sizes) else np.zeros(away.shape, bool)
        self.way = torch.from_numpy(way).to(self.places.device)
        inner = (grid >= lower + self.clearance).all(-1) & (grid <= upper - self.clearance).all(-1)
        places = grid[torch.from_numpy(way) & inner & (away >= self.clearance)]
        spread = (places.amax(0) - places.amin(0)).norm() if len(places) else 0.0
        if not spread >= self.nearest:
            raise ValueError(
                f"places for ball and mark: expected some {self.nearest:g} m apart and {self.clearance:g} m from what "
                f"is solid, found {len(places)}; type wider task.motion.lower and upper"
            )
        self.places = places.to(self.places.device)
        lower, upper = lower - self.leeway, upper + self.leeway
        grid = _grid(lower, upper, CELL)
        inside = torch.minimum(grid - lower, upper - grid).amin(-1)
        clear = torch.minimum(self._away(grid.reshape(-1, 2)).reshape(inside.shape), inside).clamp_max(FAR)
        self.clear = clear.to(self.places.device)

    def connected(self, planar: Tensor) -> Tensor:
        """Whether robots can go round balls from where they stand, and one can lie ahead: [N, 3] -> [N] bool."""
        some, found = self.places[:: 1 + len(self.places) // TRIES], self._free(planar[:, :2])
        for rows in found.nonzero().squeeze(1).split(CHUNK):
            robot, ball = self._ahead(some.unsqueeze(0), planar[rows]).nonzero(as_tuple=True)
            seen = self._open(planar[rows[robot], None, :2], some[ball].unsqueeze(1)).squeeze(1)
            found[rows] = torch.zeros_like(found[rows]).index_fill_(0, robot[seen], True)
        return found

    def _free(self, places: Tensor) -> Tensor:
        """Whether robots can be at places: [..., 2] float64 -> [...] bool."""
        last = torch.tensor(self.way.shape, device=places.device) - 1
        cell = ((places - self.motion.twin.lower.double()) / CELL).round().long().clamp_min(0).minimum(last)
        return self.way[cell[..., 0], cell[..., 1]]

    def _open(self, start: Tensor, end: Tensor) -> Tensor:
        """Whether nothing stands between places: [B, K, 2], [B, K, 2], broadcast -> [B, K] bool."""
        share = torch.linspace(0.0, 1.0, SIGHT, dtype=torch.float64, device=end.device)[:, None]
        return self._free(start.unsqueeze(2) + share * (end - start).unsqueeze(2)).all(2)

    def _onward(self, robot: Tensor, ball: Tensor, mark: Tensor) -> tuple[Tensor, Tensor]:
        """Whether a mark could belong to a ball, and the cosine of the turn there: [B, K, 2] each, broadcast."""
        way, came = mark - ball, ball - robot
        far = way.norm(dim=2)
        cosine = (way * came).sum(2) / (far * came.norm(dim=2)).clamp_min(1e-9)
        return (far >= self.nearest) & (far <= self.farthest) & self._open(ball, mark), cosine

    def _ahead(self, places: Tensor, planar: Tensor) -> Tensor:
        """Whether a ball could begin at places [B, K, 2] of robots [B, 3]: [B, K] bool."""
        away = places - planar[:, None, :2]
        turn = torch.atan2(away[..., 1], away[..., 0]) - planar[:, 2:]
        off = (turn - math.tau * (turn / math.tau).round()).abs()
        return (away.norm(dim=2) >= self.apart) & (off <= self.ahead)

    @property
    def models(self) -> list[Gaussians]:
        """The robot's links, the ball and the mark."""
        return [*self.motion.models, *self.drawn]

    def start(self, state: Tensor, anywhere: Anywhere) -> Tensor:
        """Place the ball; see ``Task.start``."""
        return self._with_ball(self.motion.varied(state, anywhere.generator), anywhere.generator)

    @property
    def memory_spec(self) -> Mapping[str, TensorSpec]:
        """See the class."""
        place = Unbounded(shape=(3,), dtype=torch.float32)
        return {"mark": place, "ball": place.clone()}

    def begin(self, state: Tensor, anywhere: Anywhere) -> Memory:
        """Draw a mark for the ball of each state; see ``Task.begin``."""
        ball, robot = self._ball(state), self.motion.planar(state)
        drawn = self._drawn(len(state), anywhere.generator)
        fits, cosine = self._onward(robot[:, None, :2], ball[:, None, :2], drawn)
        place = _first(drawn, fits & (cosine >= self.turn), fits * (2.0 + cosine))
        return {"mark": self._on_ground(place, LIFT).float(), "ball": ball.float()}

    def episodes(self, starts: Tensor, count: int, seed: int) -> dict[str, Tensor]:
        """Starts, balls and marks for tests; see ``ChoosingTask``."""
        generator = torch.Generator().manual_seed(seed)
        state = starts[torch.randint(len(starts), (count,), generator=generator)]
        anywhere = Anywhere(lambda: state, generator)
        state = self.start(state, anywhere)
        return {"state": state, **self.begin(state, anywhere)}

    def judge(self, step: Step, anywhere: Anywhere) -> Verdict:
        """Judge a step; see ``Task.judge``."""
        rewards, mark = self.rewards, step.memory["mark"].double()
        before, after = step.before, step.move.state
        was, ball = self._ball(before), self._ball(after)
        far_before, far = (_apart(one, mark) for one in (was, ball))
        approach = self._to_go(before, was, mark) - self._to_go(after, ball, mark)
        reached = far < self.success_distance
        lost = ~reached & (self._outside(ball) | self._outside(self.motion.planar(after)))
        lost |= ~reached & ~after.isfinite().all(1)
        reward = rewards.progress * (far_before - far) + rewards.approach * approach + rewards.slack
        reward += rewards.touch * (step.move.free_fraction < 1) + rewards.success * reached + rewards.lost * lost
        outcome = torch.where(reached, Outcome.GOAL, torch.where(lost, Outcome.OUT_OF_BOUNDS, Outcome.RUNNING))
        memory = {"mark": step.memory["mark"], "ball": ball.float()}
        return Verdict(reward.float().unsqueeze(1), (reached | lost).unsqueeze(1), outcome.unsqueeze(1), memory)

    def teach(self, state: Tensor, memory: Memory) -> Tensor | None:
        """What one does who knows where everything is, if the robot takes velocities; see ``push_teacher``."""
        if not self.motion.driven:
            return None
        mark = memory["mark"][:, :2].to(state)
        action = pushing(self.motion.planar(state), self._ball(state)[:, :2], mark, self._room)
        low, high = self.motion.limits
        return action.clamp(low, high)

    def _room(self, places: Tensor) -> Tensor:
        """Distance of places from what is solid and from where a robot is lost: [N, 2] -> [N] metres, interpolated."""
        last = torch.tensor(self.clear.shape, device=places.device) - 1
        at = (places - (self.motion.twin.lower.double() - self.leeway)) / CELL
        at = at.clamp_min(0.0).minimum(last.to(at) - 1e-6)
        low, share = at.long(), at - at.floor()
        x, y = low.unbind(-1)
        rows = [(1.0 - share[..., 1]) * self.clear[i, y] + share[..., 1] * self.clear[i, y + 1] for i in (x, x + 1)]
        return (1.0 - share[..., 0]) * rows[0] + share[..., 0] * rows[1]

    def parts(self, state: Tensor, memory: Memory) -> Parts:
        """The scene, the robot, the ball and the mark; see ``Task.parts``."""
        moving = self.motion.parts(state)
        mark = memory["mark"]
        normal = self.motion.terrain.plane[:3].to(mark.device)
        half = torch.sqrt(0.5 * (1.0 + normal[2]))
        tilt = matrices(torch.stack([half, -normal[1] / (2 * half), normal[0] / (2 * half), torch.zeros_like(half)]))
        pose = rigid(tilt.float().expand(len(mark), 3, 3), mark).unsqueeze(1)
        number = torch.full_like(moving.model[:, :1], len(self.motion.models) + 1)
        return Parts(torch.cat([moving.model, number], 1), torch.cat([moving.model_to_world, pose], 1))

    def marks(self, memory: Memory | None = None) -> list[Mark]:
        """Ball and mark of an episode; see ``Task.marks``."""
        if memory is None:
            return []
        return [Mark(name, _placeless(memory[name])) for name in ("mark", "ball")]

    def _ball(self, state: Tensor) -> Tensor:
        return state[:, self.ball][:, :3]

    def _to_go(self, state: Tensor, ball: Tensor, mark: Tensor) -> Tensor:
        """How far robots are from where they can push: metres, with the way round the ball; [B] float64."""
        robot = self.motion.planar(state)[:, :2]
        away, along = robot - ball[:, :2], mark[:, :2] - ball[:, :2]
        far = away.norm(dim=1)
        cosine = (away * along).sum(1) / (far * along.norm(dim=1)).clamp_min(1e-9)
        return (far - NEAR).clamp_min(0.0) + AROUND * (1.0 + cosine)

    def _outside(self, places: Tensor) -> Tensor:
        lower, upper = self.motion.twin.lower - self.leeway, self.motion.twin.upper + self.leeway
        return ((places[:, :2] < lower) | (places[:, :2] > upper)).any(1)

    def _with_ball(self, state: Tensor, generator: torch.Generator) -> Tensor:
        """States with the ball at a place that is drawn: [B, n] -> [B, n]."""
        robot = self.motion.planar(state)
        drawn, marks = (self._drawn(len(state), generator) for _ in range(2))
        place = robot[:, None, :2]
        apart = (drawn - place).norm(dim=2) >= self.apart
        clear, (onward, cosine) = apart & self._open(place, drawn), self._onward(place, drawn, marks)
        fits = clear & self._ahead(drawn, robot) & onward & (cosine >= self.turn)
        place = _first(drawn, fits, apart + 2.0 * clear + 4.0 * (clear & self._ahead(drawn, robot)))
        state = state.clone()
        state[:, self.ball.start : self.ball.start + 3] = self._on_ground(place, self.rest)
        return state

    def _drawn(self, count: int, generator: torch.Generator) -> Tensor:
        """Places for each of some robots: [B, TRIES, 2] float64."""
        rows = torch.randint(len(self.places), (count, TRIES), generator=generator, device=self.places.device)
        return self.places[rows]

    def _on_ground(self, places: Tensor, lift: float) -> Tensor:
        """Places [B, 2] at a height above the ground: [B, 3] float64."""
        z = self.motion.terrain.height(places) + lift / self.motion.terrain.plane[2].item()
        return torch.cat([places, z.unsqueeze(1)], 1)

    def _away(self, places: Tensor) -> Tensor:
        """Distance of places on the ground from the boxes that a robot can meet: [N, 2] -> [N] metres."""
        nearest = torch.full_like(places[:, 0], torch.inf)
        for row in self.motion.terrain.boxes.to(places):
            outside = ((places - row[:2]).abs() - row[3:5]).clamp_min(0.0)
            torch.minimum(nearest, outside.norm(dim=1), out=nearest)
        return nearest


def _apart(ball: Tensor, mark: Tensor) -> Tensor:
    """Horizontal distance: [B, 3], [B, 3] -> [B] metres."""
    return (ball[:, :2] - mark[:, :2]).norm(dim=1)


def _first(drawn: Tensor, fits: Tensor, worth: Tensor) -> Tensor:
    """For each row the first place that fits, or the worthiest where none does: [B, K, 2], [B, K], [B, K] -> [B, 2]."""
    order = torch.arange(fits.shape[1], 0, -1, device=fits.device)
    best = torch.where(fits, 1e6 + order, worth).argmax(1)
    return drawn[torch.arange(len(drawn), device=drawn.device), best]


def _placeless(place: Tensor) -> Tensor:
    """x and y of a place and no direction: [3] -> [3] float64."""
    return torch.cat([place[:2].double().cpu(), torch.tensor([math.nan], dtype=torch.float64)])


def _grid(lower: Tensor, upper: Tensor, beyond: float) -> Tensor:
    """Places ``CELL`` apart, up to less than so many metres beyond the bounds: [2], [2] -> [X, Y, 2] float64."""
    corners = zip(lower.tolist(), upper.tolist(), strict=True)
    axes = [torch.arange(low, high + beyond, CELL, dtype=torch.float64) for low, high in corners]
    return torch.stack(torch.meshgrid(*axes, indexing="ij"), -1)
