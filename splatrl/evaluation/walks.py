"""Simulated walks with a hand-held camera, labelled by the planner: clips that need no phone."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from torch import Tensor

from splatrl.cameras import Cameras
from splatrl.curriculum import Plan
from splatrl.envs.drawing import Shot
from splatrl.envs.robot import Robot
from splatrl.envs.tasks.base import Anywhere
from splatrl.envs.world import World
from splatrl.evaluation.clip_files import write_clip
from splatrl.evaluation.walk_looks import Lens, photographed
from splatrl.geometry import axis_rotations, azimuths, rigid
from splatrl.renderers.base import Renderer

WAVES = 4
"""Number of sinusoids in a hand's sway; bounds it by √(2 · WAVES) = 2.8 standard deviations."""
RANKS = (0.98, 0.35)
"""Quantiles of the longest and the shortest path to walk, among the path lengths from all starts."""
PATIENCE = 3
"""Walks are cut off after this many times the number of steps of the longest shortest path."""
CANDIDATES = 16
MARGIN = 0.15
"""Distance that a person keeps from solid things, metres."""
GLANCES, GLANCE = 6, 12
"""Number of views along a path that are checked for emptiness, and their side, pixels."""
BATCH = 32


@dataclass(frozen=True)
class Hand:
    """Sway of a hand: standard deviations and periods of a smooth stationary process.

    Attributes:
        place: standard deviation along x and along y, metres.
        height: standard deviation of the height, metres.
        pitch_deg: standard deviation about the camera's right axis, degrees.
        roll_deg: standard deviation about its forward axis, degrees.
        yaw_deg: standard deviation about its down axis, degrees.
        slowest: longest period, frames.
        fastest: shortest period, frames.
        frames: frames per step of the walk.
    """

    place: float = 0.01
    height: float = 0.011
    pitch_deg: float = 2.5
    roll_deg: float = 2.5
    yaw_deg: float = 2.5
    slowest: float = 60.0
    fastest: float = 8.0
    frames: int = 3

    def sizes(self) -> Tensor:
        """Return the standard deviations, in the order and units of ``camera_offset``: [6] float64."""
        angles = [math.radians(value) for value in (self.pitch_deg, self.roll_deg, self.yaw_deg)]
        return torch.tensor([self.place, self.place, self.height, *angles], dtype=torch.float64)


@dataclass(frozen=True)
class Walk:
    """The T frames of a walk.

    Attributes:
        cameras: T cameras.
        planar: [T, 3] float64, position and heading of each camera: x and y in metres, yaw in radians.
        states: [T, D], the state of the motion nearest to each of these.
        allowed: [T, A] bool, the actions that begin a shortest path from that state.
    """

    cameras: Cameras
    planar: Tensor
    states: Tensor
    allowed: Tensor


def sway(hand: Hand, frames: int, generator: torch.Generator) -> Tensor:
    """Draw the camera's offset in each frame, as taken by ``Robot.cameras``: [frames, 6] float32."""
    draw = torch.rand(2, 6, WAVES, generator=generator, dtype=torch.float64)
    periods = hand.fastest * (hand.slowest / hand.fastest) ** draw[0]
    time = torch.arange(frames, dtype=torch.float64).view(-1, 1, 1)
    waves = torch.sin(math.tau * (time / periods + draw[1])).sum(-1)
    return (waves * math.sqrt(2 / WAVES) * hand.sizes()).float()


def paths(plan: Plan, starts: Tensor, generator: torch.Generator) -> list[Tensor]:
    """Draw a random shortest path to the goal from each start, repeating the last action wherever that is optimal.

    Args:
        plan: plan of a motion with discrete actions.
        starts: [B, D] states.
        generator: chooses among optimal actions.

    Returns:
        B paths of [N, D] states, one for each step from the start to the goal; a path ends early where it would go back
        and forth.
    """
    states, walked = [starts], [torch.ones(len(starts), dtype=torch.bool)]
    before, last = starts, torch.full((len(starts), 1), -1)
    walks, repeats = walked[0], plan.moves.repeats
    for number in range(math.ceil(PATIENCE * max(1.0, float(plan.cost_to_go(starts).amax()) / repeats))):
        now = states[-1]
        allowed = plan.optimal(now).cpu()
        walks = allowed.any(1) & walks
        if not walks.any():
            break
        drawn = torch.multinomial(allowed.float() + 1e-9, 1, generator=generator)
        goes_on = allowed.gather(1, last.clamp_min(0)) & (last >= 0)
        last = torch.where(goes_on, last, drawn)
        way = list(plan.moves.each(now, plan.actions[last.squeeze(1).to(plan.actions.device)]))
        if number:
            walks &= ((way[-1].state - before).abs() > 1e-4).any(1).cpu()
        states += [reach.state for reach in way]
        walked += [walks & (reach.steps > taken).cpu() for taken, reach in enumerate(way)]
        before = now
    every, kept = torch.stack(states, 1), torch.stack(walked, 1).to(starts.device)
    return [row[steps] for row, steps in zip(every, kept, strict=True)]


def awkwardness(plan: Plan, states: Tensor) -> float:
    """Penalise a path for being unlike one that a person would walk with a camera in hand, 0 at best.

    Args:
        plan: plan from which the path comes.
        states: [N, D] states of the path.

    Returns:
        The fraction of steps that go backwards, plus the fraction of states nearer to something solid than ``MARGIN``,
        plus 1 if the path ends before the goal.
    """
    poses = plan.motion.body_to_world(states)
    way, ahead = poses[:, :3, 3].diff(dim=0), poses[:-1, :3, 0]
    backwards = (way * ahead).sum(1) < -1e-6
    tight = plan.checker.clearance(poses[:, :3, 3]) < MARGIN
    stuck = not bool(plan.at_goal(states[-1:])[0])
    return float(backwards.double().mean()) + float(tight.double().mean()) + stuck


def emptiness(plan: Plan, states: Tensor, robot: Robot, renderer: Renderer) -> float:
    """Return the fraction of pixels, in views along a path, that show nothing, such as beyond the edge of a capture.

    Args:
        plan: knows the motion.
        states: [T, ...] states of the motion along the path; ``GLANCES`` of them are looked at.
        robot: carries the camera.
        renderer: renders the scene.
    """
    some = states[torch.linspace(0, len(states) - 1, GLANCES).round().long()]
    small = replace(robot, image_height=GLANCE, image_width=GLANCE)
    alpha = renderer.render(small.cameras(plan.motion.body_to_world(some).cpu())).alpha
    return float((alpha < 0.5).double().mean())


def eased(planar: Tensor, frames: int) -> Tensor:
    """Interpolate poses, easing in and out at each: [N, 3] x, y and yaw -> [(N − 1) · frames + 1, 3]."""
    steps = planar.diff(dim=0)
    steps[:, 2] = (steps[:, 2] + math.pi) % math.tau - math.pi
    part = torch.arange(frames, dtype=planar.dtype) / frames
    part = (part * part * (3 - 2 * part)).view(1, -1, 1)
    between = planar[:-1].unsqueeze(1) + part * steps.unsqueeze(1)
    return torch.cat([between.flatten(0, 1), planar[-1:]])


def walk(plan: Plan, robot: Robot, states: Tensor, hand: Hand, generator: torch.Generator) -> Walk:
    """Walk a path with a swaying camera, until the camera is at the goal.

    Args:
        plan: plan of a motion at a fixed height, with discrete actions.
        robot: the robot whose camera is carried.
        states: [N, D] states of the path.
        hand: how the camera sways.
        generator: draws the sway.
    """
    motion = plan.motion
    assert motion.height is not None
    x, y, yaw = eased(motion.planar(states).cpu(), hand.frames).unbind(1)
    bodies = rigid(axis_rotations(2, yaw), torch.stack([x, y, torch.full_like(x, motion.height)], 1)).float()
    cameras = robot.cameras(bodies, sway(hand, len(bodies), generator))
    poses = cameras.camera_to_world.double()
    yaw = azimuths(poses[:, :3, 2]) % math.tau
    planar = torch.cat([poses[:, :2, 3], yaw.unsqueeze(1)], 1)
    states = motion.nearest(planar)
    there = plan.at_goal(states).nonzero().flatten()
    length = int(there[0]) + 1 if len(there) else len(states)
    return Walk(cameras[:length], planar[:length], states[:length], plan.optimal(states[:length]))


def far_paths(plan: Plan, count: int, generator: torch.Generator, against: Callable[[Tensor], float]) -> list[Tensor]:
    """Choose paths whose lengths are spread evenly over the quantiles in ``RANKS``, the longest first.

    For each length, the path with the lowest penalty is taken among those from ``CANDIDATES`` random starts.

    Args:
        plan: plan of a motion with discrete actions.
        count: number of paths.
        generator: draws starts and chooses among paths.
        against: maps a path, [N, D] states, to its penalty, 0 at best.

    Returns:
        ``count`` paths of [N, D] states.
    """
    rows = plan.start_rows
    steps = plan.distance[rows].double().cpu()
    order = steps.sort().values
    wanted = order[((len(order) - 1) * torch.linspace(*RANKS, count, dtype=torch.float64)).long()]
    candidates = []
    for length in wanted:
        gap = (steps - length).abs()
        near = (gap <= max(float(gap.min()), 0.03 * float(steps.max()))).nonzero().flatten()
        candidates.append(rows[near[torch.randint(len(near), (CANDIDATES,), generator=generator)]])
    tried = paths(plan, plan.states[torch.cat(candidates)], generator)
    groups = [tried[CANDIDATES * number : CANDIDATES * (number + 1)] for number in range(count)]
    return [min(group, key=against) for group in groups]


def record_walks(
    folder: Path,
    world: World,
    count: int = 12,
    seed: int = 0,
    height: int = 96,
    hand: Hand | None = None,
    lens: Lens | None = None,
    progress: Callable[[int], object] = lambda clips: None,
) -> list[Path]:
    """Record walks and write them as clips (see ``clip_files``); the same arguments give the same bytes.

    Args:
        folder: folder of the clips, created if necessary.
        world: world in which walks are recorded.
        count: number of clips.
        seed: seed of starts, paths, sway and camera looks.
        height: height of the images, pixels; their aspect ratio is that of the robot's images.
        hand: how the camera sways; None takes the default.
        lens: how much the cameras vary; None takes the default.
        progress: called with the number of clips just written.

    Returns:
        The clips' folders.

    Raises:
        ValueError: for a motion without a fixed height or action names, or if a clip of that name exists.
    """
    plan, robot = world.plan, world.robot
    if plan.motion.height is None or not plan.motion.action_names:
        name = type(plan.motion).__name__
        raise ValueError(
            "task: expected a motion on the ground with named actions, such as ForwardMotion or LatticeMotion, "
            f"got {name}"
        )
    if count < 1 or height < 1:
        raise ValueError(f"count, height: expected at least 1 clip and 1 pixel, got {count} and {height}")
    camera = replace(robot, image_height=height, image_width=round(height * robot.image_width / robot.image_height))

    def against(states: Tensor) -> float:
        return awkwardness(plan, states) + emptiness(plan, states, robot, world.drawing.renderer)

    walked_paths = far_paths(plan, count, torch.Generator().manual_seed(seed), against)
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for number, states in enumerate(walked_paths):
        generator = torch.Generator().manual_seed(1_000_003 * (seed + 1) + number)
        walked = walk(plan, camera, states, hand or Hand(), generator)
        images = photographed(seen(walked, world), lens or Lens(), generator)
        written.append(folder / f"walk-{number:02}")
        write_clip(written[-1], images, walked.allowed, plan.motion.action_names)
        progress(1)
    return written


def seen(walked: Walk, world: World) -> Tensor:
    """Render what the camera of a walk sees, including what the task places in the picture: [T, H, W, 3] uint8."""
    start = world.plan.starts[:1]
    # Objects stand where they would in an episode from the first start.
    begun = world.task.begin(start, Anywhere(lambda: start, torch.Generator()))
    images = []
    for rows in torch.arange(len(walked.cameras)).split(BATCH):
        memory = {key: value.cpu().expand(len(rows), *value.shape[1:]) for key, value in begun.items()}
        parts = world.task.parts(walked.states[rows], memory)
        images.append(world.drawing.draw(Shot(walked.cameras[rows], memory, parts)).pixels)
    return torch.cat(images)
