"""The tiny world that tests share: a coloured room of a few hundred Gaussians, and envs in it.

The room is 3 × 4 m, with a differently coloured wall on each side, a white block in the middle and a red object on the
east wall. The lattice has 5 × 7 positions (not square) and 8 headings; the goal pose sees the red object from nearby.
"""

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from splatrl.bodies import Body, Box
from splatrl.cameras import Cameras
from splatrl.curriculum import Curriculum, Plan, plan
from splatrl.envs import Robot, SplatEnv
from splatrl.envs.drawing import SceneDrawing
from splatrl.envs.tasks import Grid
from splatrl.motions import LatticeMotion, Site
from splatrl.renderers import Parts, ReferenceRenderer, Renderer, RenderOutput
from splatrl.renderers.base import draw_only
from splatrl.scenes import write_gaussians
from splatrl.scenes.gaussians import Gaussians
from splatrl.spherical_harmonics import C0

HEIGHT = 0.5
BLOCK = 0.2
"""Half the side of the block in the middle of the room, metres."""
BODY = Box((0.3, 0.3, 0.2))
LONG_STEPS = ("task.motion.step=0.25", "task.motion.angle_step_deg=45.0", "task.motion.spacing=0.25")
"""Overrides of tasks that walk along their heading, with which paths are found in a tenth of the time."""
WALKING = ("fps", "apple", "sim2real", "snake", "poster")
"""Tasks to which they apply."""


def tiny_gaussians() -> Gaussians:
    """Return the room: about 280 Gaussians of degree 0, thin along the normals of the surfaces that they cover."""
    span = BLOCK - 0.08  # leaves room for what a Gaussian covers beyond its mean
    patches = [
        _patch((0, 0, 0), (1.5, 0, 0), (0, 2, 0), (7, 9), (0.4, 0.3, 0.2)),
        _patch((1.5, 0, 0.6), (0, 2, 0), (0, 0, 0.6), (9, 4), (0.2, 0.7, 0.3)),
        _patch((-1.5, 0, 0.6), (0, 2, 0), (0, 0, 0.6), (9, 4), (0.8, 0.8, 0.2)),
        _patch((0, 2, 0.6), (1.5, 0, 0), (0, 0, 0.6), (7, 4), (0.2, 0.3, 0.8)),
        _patch((0, -2, 0.6), (1.5, 0, 0), (0, 0, 0.6), (7, 4), (0.6, 0.2, 0.7)),
        _patch((1.4, 1, 0.5), (0, 0.2, 0), (0, 0, 0.2), (3, 3), (1.0, 0.0, 0.0), 0.1),
        _patch((0, 0, 0.5), (0, span, 0), (0, 0, 0.5), (3, 5), (0.9, 0.9, 0.9), 0.06),
    ]
    for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        side = (BLOCK * x, BLOCK * y, 0.5)
        patches.append(_patch(side, (span * y, span * x, 0), (0, 0, 0.5), (3, 5), (0.9, 0.9, 0.9), 0.06))
    means, scales, colors = (torch.cat(parts) for parts in zip(*patches, strict=True))
    count = len(means)
    jitter = 0.003 * torch.randn(count, 3, generator=torch.Generator().manual_seed(0))
    return Gaussians(
        means=means + jitter,  # no two have equal depth, which renderers may sort either way
        quats=torch.tensor([1.0, 0.0, 0.0, 0.0]).repeat(count, 1),
        scales=scales,
        opacities=torch.full((count,), 0.9),
        sh=((colors - 0.5) / C0).unsqueeze(1),
        batch_size=[count],
    )


def _patch(
    center: Sequence[float],
    u: Sequence[float],
    v: Sequence[float],
    counts: tuple[int, int],
    color: Sequence[float],
    scale: float = 0.2,
) -> tuple[Tensor, Tensor, Tensor]:
    """Return a rectangle of Gaussians, center ± u ± v, with varying colour: means, scales, colours, each [N, 3]."""
    steps = torch.cartesian_prod(*(torch.linspace(-1, 1, n) for n in counts))
    sides = torch.tensor([u, v], dtype=torch.float32)
    means = torch.tensor(center) + steps @ sides
    scales = torch.where(sides.any(0), scale, 0.02).expand_as(means)
    wave = 0.15 * torch.sin(3 * means[:, :1] + 5 * means[:, 1:2])
    return means, scales, (torch.tensor(color) + wave).clamp(0, 1)


class BlockChecker:
    """Checks collision analytically: body and block together form one square, ``reach`` from its centre to a side."""

    def __init__(self, body: Body = BODY, reach: float = BLOCK + 0.15):
        self.body, self.reach = body, reach

    def collides(self, body_to_world: Tensor) -> Tensor:
        return (body_to_world[:, :2, 3].abs() < self.reach).all(1)

    def free_fraction(self, start: Tensor, end: Tensor) -> Tensor:
        """Return the fraction at which the line enters the square: the later of its entries into the two slabs."""
        begin, way = start[:, :2, 3], (end - start)[:, :2, 3]
        sides = torch.stack([-self.reach - begin, self.reach - begin]) / way
        inside = begin.abs() < self.reach
        still = way == 0
        enter = torch.where(still, torch.where(inside, -torch.inf, torch.inf), sides.amin(0)).amax(1)
        leave = torch.where(still, torch.where(inside, torch.inf, -torch.inf), sides.amax(0)).amin(1)
        hits = (enter < leave) & (enter < 1) & (leave > 0)
        return torch.where(hits, enter.clamp_min(0), 1.0)

    def sweeps(self, start: Tensor, end: Tensor) -> Tensor:
        return self.free_fraction(start, end) < 1

    def clearance(self, points: Tensor) -> Tensor:
        return (points[:, :2].abs().amax(1) - BLOCK).clamp_min(0)


class CountingRenderer:
    """Passes cameras on to another renderer and counts them."""

    def __init__(self, renderer: Renderer):
        self.renderer, self.rendered = renderer, 0

    def render(self, cameras: Cameras, parts: Parts | None = None, only: Tensor | None = None) -> RenderOutput:
        self._count(cameras, only)
        return self.renderer.render(cameras, parts, only)

    def pixels(self, cameras: Cameras, parts: Parts | None = None, only: Tensor | None = None) -> Tensor:
        self._count(cameras, only)
        return self.renderer.pixels(cameras, parts, only)

    def _count(self, cameras: Cameras, only: Tensor | None) -> None:
        self.rendered += len(cameras) if only is None else int(only.sum())


class RememberingRenderer:
    """Renders each view once and caches it; simple enough to be trusted in fast tests."""

    def __init__(self, renderer: Renderer):
        self.renderer = renderer
        self.views: dict[bytes, Tensor] = {}

    def render(self, cameras: Cameras, parts: Parts | None = None, only: Tensor | None = None) -> RenderOutput:
        return self.renderer.render(cameras, parts, only)

    def pixels(self, cameras: Cameras, parts: Parts | None = None, only: Tensor | None = None) -> Tensor:
        return draw_only(self._views, cameras, parts, only)

    def _views(self, cameras: Cameras, parts: Parts | None) -> Tensor:
        assert parts is None, "views are remembered by the camera alone"
        views = [self._view(cameras[row : row + 1]) for row in range(len(cameras))]
        return torch.stack(views) if views else torch.empty(0, cameras.height, cameras.width, 3, dtype=torch.uint8)

    def _view(self, camera: Cameras) -> Tensor:
        key = camera.camera_to_world.numpy().tobytes() + camera.K.numpy().tobytes()
        if key not in self.views:
            self.views[key] = self.renderer.pixels(camera)[0]
        return self.views[key]


def tiny_motion() -> LatticeMotion:
    """Return a lattice of 5 × 7 positions, 0.5 m apart, and 8 headings."""
    return LatticeMotion(HEIGHT, step=0.5, angle_step_deg=45.0, lower=(-1.0, -1.5), upper=(1.0, 1.5))


def tiny_task(max_steps: int = 20) -> Grid:
    """Return the grid task: its goal pose looks east at the red object; 27 poses count as reached, and all are free."""
    return Grid(tiny_motion(), goal=(0.5, 1.0, 0.0), max_steps=max_steps)


def tiny_robot() -> Robot:
    """Return a robot whose camera has 16 × 12 pixels."""
    return Robot(BODY, HEIGHT, image_width=16, image_height=12)


@cache
def tiny_renderer() -> RememberingRenderer:
    """Return the reference renderer behind a cache that the whole process shares."""
    return RememberingRenderer(ReferenceRenderer(tiny_gaussians()))


@cache
def tiny_plan() -> Plan:
    """Return the shortest paths in the room."""
    task = tiny_task()
    return plan(task.motion, BlockChecker(), task.reached)


def tiny_env(
    batch_size: Sequence[int] = (3,),
    seed: int | None = 0,
    max_steps: int = 20,
    first: int | None = None,
    threshold: float = 0.7,
    window: int = 100,
    renderer: Renderer | None = None,
) -> SplatEnv:
    """Return an env of robots in the room; a top-level function of plain values, which worker processes can call."""
    curriculum = Curriculum(tiny_plan(), first, threshold=threshold, window=window)
    drawing = SceneDrawing(renderer or tiny_renderer())
    return SplatEnv(drawing, BlockChecker(), tiny_robot(), tiny_task(max_steps), curriculum, batch_size, seed)


def tiny_overrides(folder: Path, task: str = "grid") -> list[str]:
    """Write the room into a folder, and return the overrides from which ``splatrl.make_env`` builds it."""
    path = folder / "tiny.ply"
    write_gaussians(path, tiny_gaussians())
    overrides = [
        f"task={task}",
        "device=cpu",  # the same on every machine
        "scene=file",
        f"scene.path={path}",
        "landmarks.goal=[0.5,1.0,0.0]",
        "landmarks.object=[0.75,1.0,0.5]",
        f"robot.height={HEIGHT}",
        "robot.image_width=16",
        "robot.image_height=12",
        "task.max_steps=20",
        "network.pool=1",
    ]
    bounds = ["task.motion.lower=[-1.0,-1.5]", "task.motion.upper=[1.0,1.5]"]
    if task == "grid":
        return [
            *overrides,
            *bounds,
            "robot.body.size=[0.3,0.3,0.2]",
            "task.motion.step=0.5",
            "task.motion.angle_step_deg=45.0",
        ]
    if task == "strides":
        overrides.remove("task.max_steps=20")
        bounds += ["task.motion.commands=2", "task.motion.span=0.2", "task.motion.variation.models=2"]
        bounds += ["task.motion.threads=1"]
    if task in ("drive", "push"):
        overrides += ["task.motion.spacing=0.25", "task.motion.headings=8"]
    if task == "drive":
        overrides += ["task.motion.time_step=0.4"]  # plans paths on a coarser grid
    if task in ("gates", "route", "walk"):
        bounds = ["task.motion.lower=[-1.3,-1.8]", "task.motion.upper=[1.3,1.8]", "task.motion.threads=1"]
    if task == "gates":
        bounds += ["task.courses=3", "task.test_courses=2", "task.course.gates=2", "task.course.clearance=0.15"]
        bounds += ["task.course.height=[0.6,0.8]", "task.course.distance=[0.8,1.4]", "task.motion.ceiling=1.5"]
    if task == "walk":
        bounds += [
            "task.courses=3",
            "task.test_courses=2",
            "task.course.clearance=0.2",
            "task.course.distance=[0.7,1.2]",
        ]
    if task == "route":
        bounds += ["task.courses=3", "task.test_courses=2", "task.course.waypoints=2", "task.course.clearance=0.2"]
    if task in ("pointnav", "imagenav"):
        bounds += ["task.goals=5", "task.test_goals=4", "task.nearest=0.3", "task.cell=0.1", "robot.body.radius=0.1"]
    return overrides if task in ("circle", "polar_plane", "hemisphere") else [*overrides, *bounds]


def bare_site() -> Site:
    """Return a site without a scene, for motions and tasks that stand on level ground."""
    nothing: Any = None
    return Site(nothing, nothing, nothing, Box((0.1, 0.1, 0.1)), True)
