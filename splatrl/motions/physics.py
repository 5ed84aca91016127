"""A robot with its own MJCF body, put into a scene among things, where MuJoCo simulates its motion."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from splatrl.collision.occupancy import Occupancy
from splatrl.motions.drive import DriveMotion
from splatrl.motions.servos import driven, twin_speeds
from splatrl.motions.simulated import SimulatedMotion
from splatrl.motions.site import Fits, Site, narrowed
from splatrl.physics import Physics, Terrain, level_ground
from splatrl.physics.bank import Variation, bank
from splatrl.physics.body_poses import BodyPoses
from splatrl.physics.checks import (
    compare_axle,
    require_heading,
    require_multiple,
    require_rest,
    require_shown,
    require_sound,
)
from splatrl.physics.compose import SCENE
from splatrl.physics.gaussians import BodyGaussians, Models
from splatrl.physics.looks import compare_looks, shown_bodies
from splatrl.physics.robot_world import RobotWorld
from splatrl.physics.robots import mjcf_path
from splatrl.physics.survey import survey_ground, survey_terrain, without_ground
from splatrl.physics.things import Things
from splatrl.scenes.scene import Scene
from splatrl.values import require_number

GROUNDS = ("scene", "level")
BEYOND = 1.0
"""Minimum margin, metres, around the robots' region in which physics knows the solid voxels if things are pushed, which
can roll away."""


class PhysicsMotion(SimulatedMotion):
    """An MJCF robot on the ground of a scene, among the scene's boxes and things that the robot may move.

    A state is [n] float64, whose columns ``layout`` names: it holds the poses and velocities of the robot and all
    things, and the number of the model in the bank that they obey. An action sets the actuators' controls, within their
    ``ctrlrange``, for one time step. Moves are never reverted: contacts push back. ``Move.free_fraction`` is the
    fraction of substeps before the robot first touches a box or a thing that it must not push, according to contact
    sensors at the beginning of each substep.

    Ahead is the x axis of the robot's first body as its file writes it. Shortest paths are those of a kinematic twin, a
    ``DriveMotion`` with the robot's speeds, so that starts and distances work as for other motions. If the robot's only
    actuators are velocity servos called forward and turn, in this order, it takes the same actions as the twin.

    ``settle`` puts the robot into a scene, where episodes begin only if it touches nothing; until then, it stands on
    level ground.

    Args:
        path: the robot's MJCF file, or the name of one of splatrl's own robots. The robot has one body at the top, with
            a free joint.
        camera: name of the camera; ``body_to_world`` returns poses of the body that carries it.
        things: MJCF files of things that stand or lie in the scene, by name; their poses are columns of the state.
        pushed: names of the things that the robot may touch.
        time_step: duration of an action, seconds.
        substep: duration of a substep of the physics, seconds; None takes the robot's own.
        linear: lowest and highest speed of the twin, metres per second; None takes the limits of the servo forward.
        angular_deg: the twin's highest angular velocity, degrees per second; None takes that of the servo turn.
        lower: with ``upper``, the bounds of the robots; see ``DriveMotion``.
        upper: see ``lower``.
        spacing: with ``headings``, the places and directions where they may start; see ``DriveMotion``.
        headings: see ``spacing``.
        ceiling: height above the ground up to which robots can meet solid voxels, metres, for robots that fly; None
            takes the highest point of the robot and the things where they stand.
        variation: how the physics differs between episodes.
        threads: number of threads that step robots in parallel; None takes all cores.
        ground: ``scene`` for the ground and boxes of the scene; ``level`` for an infinite level plane with nothing on
            it, for robots that do not look.
        looks: splat files, by name of thing, to draw in place of the thing's geoms, which then only make contact; in
            metres, in the frame of the thing's first body.

    Raises:
        FileNotFoundError: for MJCF files that do not exist.
        ImportError: without the extra ``physics``.
        ValueError: for MJCF that is refused or lacks a free joint, the camera or the range of an actuator, or has turn
            before forward; for speeds that neither are given nor follow from actuators; for a number out of range;
            for a robot that points up or down, or whose physics fails within one action; or for a thing of which
            nothing is drawn, or that falls or rises from where its file puts it.
    """

    def __init__(
        self,
        path: str | Path,
        camera: str,
        things: Mapping[str, str] | None = None,
        pushed: Sequence[str] = (),
        time_step: float = 0.1,
        substep: float | None = None,
        linear: Sequence[float] | None = None,
        angular_deg: float | None = None,
        lower: Sequence[float] = (-1.0, -1.0),
        upper: Sequence[float] = (1.0, 1.0),
        spacing: float = 0.1,
        headings: int = 36,
        ceiling: float | None = None,
        variation: Variation | None = None,
        threads: int | None = None,
        ground: str = "scene",
        looks: Mapping[str, str | Path] | None = None,
    ):
        super().__init__()
        if ground not in GROUNDS:
            raise ValueError(f"task.motion.ground: expected {' or '.join(GROUNDS)}, got {ground!r}")
        self.ground = ground
        self.path, self.camera, self.things = mjcf_path(str(path)), camera, Things(things or {}, pushed, looks or {})
        self.time_step, self.substep, self.threads = time_step, substep, threads
        self.variation, self.ceiling = variation or Variation(), ceiling
        self.models = Models()
        require_number("task.motion.time_step", time_step, 1e-4, 10.0)
        if substep is not None:
            require_number("task.motion.substep", substep, 1e-5, 1.0)
        if ceiling is not None:
            require_number("task.motion.ceiling", ceiling, 0.2, 1e3)
        self.register_buffer("limits", torch.zeros(2, 0), persistent=False)
        self.register_buffer("home", torch.zeros(0, dtype=torch.float64), persistent=False)
        self.stand_on(level_ground())
        require_heading(self.path, self.home[self.layout.orientation])
        require_sound(self.world, self.physics)
        require_shown(self.things, self._shown)
        require_rest(self.world, self.physics, self.things, self.held)
        self.driven = driven(self.world)
        if self.driven:
            compare_axle(self.world, self.physics, self.things, self.held)
        speeds = twin_speeds(self.world, linear, angular_deg)
        height = float(self.home[self.layout.position][2])
        self.twin = DriveMotion(height, time_step, *speeds, lower, upper, spacing, headings)
        self.step, self.angle_step, self.height = self.twin.step, self.twin.angle_step, None

    def obstacles(self, scene: Scene, occupancy: Occupancy, antialiased: bool) -> Occupancy:
        """Return the solid voxels that physics does not take as ground: grass reaches into low bodies."""
        if self.ground != "scene":
            return occupancy
        lower, upper = self.twin.lower.tolist(), self.twin.upper.tolist()
        return without_ground(occupancy, survey_ground(scene, occupancy, lower, upper, antialiased))

    def settle(self, site: Site, fits: Fits) -> Fits:
        """Put the robot and its things into a scene, where it begins only if it is ``clear``; see ``Motion``.

        Raises:
            ValueError: for ranges of a variation that has no variants, unless the task makes variants of its own.
        """
        if site.varies and self.variation.unused:
            raise ValueError("task.motion.variation.models: expected more than 1 for ranges other than [1, 1], got 1")
        if self.ground == "scene":  # level ground needs no survey
            lower, upper = self.twin.lower.tolist(), self.twin.upper.tolist()
            beyond = max(site.leeway, BEYOND if self.things.pushed else 0.0)
            reach = max(site.body.radius, self.world.reach) + beyond
            found = survey_terrain(site.scene, site.occupancy, lower, upper, reach, self.top, site.antialiased)
            self.stand_on(found.terrain)
        compare_looks(self.world, self.things.looks, list(map(BodyGaussians, self._shown, self.models)))
        return narrowed(fits, lambda poses: self.clear(self.nearest(self.planar_of(poses))))

    def stand_on(self, terrain: Terrain) -> None:
        """Put the robot and its things on a terrain."""
        world = RobotWorld(self.path, self.things.paths, terrain, self.substep)
        self.top = world.top if self.ceiling is None else self.ceiling
        substeps = require_multiple(self.held, world.model.opt.timestep)
        self.physics = Physics(bank(world.model, self.variation), substeps, self.threads)
        self.layout, self.terrain, self.world = self.physics.layout, terrain, world
        device = self.home.device
        self.home, self.still = self.physics.state_of(world.qpos, world.act).to(device), torch.from_numpy(world.ctrl)
        self.limits = world.control_limits().to(device)
        if not self.models:  # appearance does not depend on the scene
            found = shown_bodies(world, self.things.looks)
            self.models, self._shown = Models(body.gaussians for body in found), [body.body for body in found]
        self.bodies = BodyPoses(self.physics.models, world, self.camera, self._shown)
        hits = [self.physics.sensor(f"touch/{name}") for name in (SCENE, *self.things.unpushed)]
        self.hits = [column for hit in hits if hit is not None for column in range(hit.start, hit.stop)]

    def obey(self, models: Sequence[Any]) -> None:
        """Replace the bank of models by others, which differ from the first only in their numbers."""
        self.physics = Physics(models, self.physics.substeps, self.threads)
        self.bodies = BodyPoses(models, self.world, self.camera, self._shown)

    def repeat(self, count: int) -> None:
        """Make ``count`` copies of each thing, with names numbered from 1."""
        self.things = self.things.copies(count)
        self.models = Models()
        self.stand_on(self.terrain)

    def region(self) -> Tensor:
        """Return the corners of the bounds, up to the ceiling or the robot's highest point: [2, 3] float32, metres."""
        region = self.twin.region()
        region[1, 2] = max(float(region[1, 2]), self.top)
        return region

    @property
    def seconds_per_step(self) -> float:
        """Duration of an action, seconds."""
        return self.time_step

    @property
    def held(self) -> float:
        """Duration for which controls are held, seconds."""
        return self.time_step
