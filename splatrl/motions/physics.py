"""A robot with its own MJCF body, whose motion MuJoCo simulates.

The file is long because the class explains the keys of ``conf/motion/physics.yaml`` one by one.
"""

import math
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torchrl.data import Bounded

from splatrl.collision.base import Checker
from splatrl.collision.occupancy import Occupancy
from splatrl.files import expanded
from splatrl.geometry import invert_rigid, planar_of, quat_yaws
from splatrl.motions.base import Move
from splatrl.motions.drive import DriveMotion
from splatrl.motions.servos import driven, twin_speeds
from splatrl.motions.site import Fits, Site, narrowed
from splatrl.motions.twin import TwinMotion
from splatrl.physics import Kinematics, Physics, Solids, Terrain, level_ground
from splatrl.physics.bank import Variation, bank
from splatrl.physics.compose import RESERVED, SCENE
from splatrl.physics.gaussians import SHOWN_GROUPS, BodyGaussians, Models, gaussians_from_mjcf
from splatrl.physics.kinematics import rotated, turned_back
from splatrl.physics.robot_world import RobotWorld
from splatrl.physics.robots import mjcf_path
from splatrl.physics.standing import on_ground
from splatrl.physics.survey import survey_ground, survey_terrain, without_ground
from splatrl.renderers.parts import Parts
from splatrl.scenes.scene import Scene
from splatrl.values import require_number

GROUNDS = ("scene", "level")
LEAST_AHEAD = 0.1
"""Smallest horizontal part of the unit vector that points ahead, for which a standing robot has a heading."""
BEYOND = 1.0
"""Minimum margin, metres, around the robots' region in which physics knows the solid voxels if things are pushed, which
can roll away."""
RESTING, SETTLED = 0.2, 0.02
"""Seconds for which a thing must rest where its file puts it, and metres by which its height may change meanwhile."""
LARGER = 3.0
"""Ratio of the sizes of a look and the geoms that it replaces above which one of them probably is in another unit."""
APART = 1e3
"""Distance between things, and from the robot, where it is checked that they rest, metres."""
FAR = 1e9
"""Bound on the magnitude of every number in a state."""


class PhysicsMotion(TwinMotion):
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

    action_names: tuple[str, ...] = ()
    steps_on_host = True
    stacks = False
    limits: Tensor  # [2, nu] float32, lowest and highest controls
    home: Tensor  # [n] float64, the state at rest at the origin

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
        self.path, self.camera, self.pushed = mjcf_path(str(path)), camera, tuple(pushed)
        self.thing_paths = {str(name): mjcf_path(str(place)) for name, place in (things or {}).items()}
        self.looks = {str(name): expanded(place) for name, place in (looks or {}).items()}
        self._check_names()
        self.time_step, self.substep, self.threads = time_step, substep, threads
        self.variation, self.ceiling = variation or Variation(), ceiling
        self.models = Models()
        self._single: Physics | None = None
        require_number("task.motion.time_step", time_step, 1e-4, 10.0)
        if substep is not None:
            require_number("task.motion.substep", substep, 1e-5, 1.0)
        if ceiling is not None:
            require_number("task.motion.ceiling", ceiling, 0.2, 1e3)
        self.register_buffer("limits", torch.zeros(2, 0), persistent=False)
        self.register_buffer("home", torch.zeros(0, dtype=torch.float64), persistent=False)
        self.stand_on(level_ground())
        self._check_ahead()
        self._check_sound()
        self._check_things()
        self.driven = driven(self.world)
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
            beyond = max(site.leeway, BEYOND if self.pushed else 0.0)
            reach = max(site.body.radius, self.world.reach) + beyond
            found = survey_terrain(site.scene, site.occupancy, lower, upper, reach, self.top, site.antialiased)
            self.stand_on(found.terrain)
        self._compare_looks()
        return narrowed(fits, lambda poses: self.clear(self.nearest(self.planar_of(poses))))

    def stand_on(self, terrain: Terrain) -> None:
        """Put the robot and its things on a terrain."""
        world = RobotWorld(self.path, self.thing_paths, terrain, self.substep)
        self.top = world.top if self.ceiling is None else self.ceiling
        timestep = world.model.opt.timestep
        substeps = self.held / timestep
        if round(substeps) < 1 or abs(substeps - round(substeps)) > 1e-6:
            raise ValueError(
                f"task.motion.time_step: expected a multiple of the robot's timestep, {timestep:g} s, got {self.held:g}"
            )
        self.physics = Physics(bank(world.model, self.variation), round(substeps), self.threads)
        self.layout, self.terrain, self.world = self.physics.layout, terrain, world
        home, device = self.physics.state_of(world.qpos), self.home.device
        home[self.layout.activations][: len(world.act)] = torch.from_numpy(world.act)
        self.home, self.still = home.to(device), torch.from_numpy(world.ctrl)
        self.limits = world.control_limits().to(device)
        if not self.models:  # appearance does not depend on the scene
            found = world.gaussians(self.looks)
            self.models, self._shown = Models(body.gaussians for body in found), [body.body for body in found]
        self._place_bodies()
        hits = [self.physics.sensor(f"touch/{name}") for name in (SCENE, *self.thing_paths) if name not in self.pushed]
        self.hits = [columns for columns in hits if columns is not None]

    def obey(self, models: Sequence[Any]) -> None:
        """Replace the bank of models by others, which differ from the first only in their numbers."""
        self.physics = Physics(models, self.physics.substeps, self.threads)
        self._place_bodies()

    def repeat(self, count: int) -> None:
        """Make ``count`` copies of each thing, with names numbered from 1."""

        def numbered(name: str) -> list[str]:
            return [f"{name}{number}" for number in range(1, count + 1)]

        self.thing_paths = {one: path for name, path in self.thing_paths.items() for one in numbered(name)}
        self.looks = {one: path for name, path in self.looks.items() for one in numbered(name)}
        self.pushed = tuple(one for name in self.pushed for one in numbered(name))
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

    @property
    def action_spec(self) -> Bounded:
        """Spec of one robot's action: the control of each actuator, [nu] float32; no batch."""
        return Bounded(low=self.limits[0], high=self.limits[1], shape=(self.limits.shape[1],), dtype=torch.float32)

    @property
    def state_spec(self) -> Bounded:
        """Spec of one robot's state: finite numbers, [n] float64; no batch."""
        return Bounded(low=-FAR, high=FAR, shape=(len(self.home),), dtype=torch.float64)

    def move(self, state: Tensor, action: Tensor, checker: Checker) -> Move:
        """Step the physics; see ``Motion``. A robot whose physics fails keeps its state and counts as out of bounds."""
        ctrl = action.clamp(self.limits[0], self.limits[1])
        after, sensed, sound = self.physics.step(self.of_physics(state), ctrl)
        return self.moved(after, sensed, sound)

    def touched(self, sensed: Tensor) -> Tensor:
        """Return in which substeps robots touch what they must not touch: [B, S, s] -> [B, S] bool."""
        found = torch.zeros(sensed.shape[:2], dtype=torch.bool, device=sensed.device)
        for columns in self.hits:
            found |= (sensed[..., columns] > 0).any(2)
        return found

    def moved(self, after: Tensor, sensed: Tensor, sound: Tensor) -> Move:
        """Return the result of an action, given states after it [B, n], readings [B, S, s] and sound physics [B]."""
        touched = self.touched(sensed)
        first = touched.int().argmax(1)  # the first substep that touches
        free = torch.where(touched.any(1), first / touched.shape[1], 1.0).float()
        return Move(after, self.body_to_world(after), free, self.inside(after) & sound, sensed, sound)

    def clear(self, state: Tensor) -> Tensor:
        """Return whether robots touch nothing but the ground and what they may push: [N, n] -> [N] bool."""
        _, sensed, sound = self._once.step(self.of_physics(state), self._rest(state))
        return sound & ~self.touched(sensed).squeeze(1)

    def sensed(self, state: Tensor) -> Tensor:
        """Return the readings of MuJoCo's sensors at starts, with actuators at rest: [B, n] -> [B, s] float64."""
        return self._once.step(self.of_physics(state), self._rest(state)).sensed.squeeze(1)

    def of_physics(self, state: Tensor) -> Tensor:
        """Return the columns that the physics steps, to which subclasses may append others: [B, n] -> [B, size]."""
        return state[:, : self.physics.size]

    @property
    def _once(self) -> Physics:
        """The physics with one substep per step."""
        if self._single is None or self._single.models is not self.physics.models:
            self._single = Physics(self.physics.models, 1, self.threads)
        return self._single

    def _rest(self, state: Tensor) -> Tensor:
        """Return the controls of the robot's first keyframe, or zeros without one: [B, nu] float64."""
        return self.still.to(state).expand(len(state), -1)

    def velocity(self, state: Tensor) -> Tensor:
        """Return linear and angular velocity of the robot's first body: [B, n] -> [B, 6] float64.

        Both are in the body's own frame, metres per second and radians per second.
        """
        ahead = rotated(turned_back(state[:, self.layout.orientation]), state[:, self.layout.velocity])
        return torch.cat([ahead, state[:, self.layout.angular_velocity]], 1)

    def planar(self, state: Tensor) -> Tensor:
        """Return x, y and yaw of the robot's first body: [B, n] -> [B, 3] float64, metres, and radians in [0, τ).

        The yaw is that of the body's x axis, which points ahead.
        """
        x, y, _ = state[:, self.layout.position].unbind(1)
        return torch.stack([x, y, quat_yaws(state[:, self.layout.orientation]) % math.tau], 1)

    def body_to_world(self, state: Tensor) -> Tensor:
        """Return the poses of the body that carries the camera: [B, n] -> [B, 4, 4] float32."""
        place, turn = self.kinematics(state)
        return self.kinematics.as_poses(place[:, :1], turn[:, :1]).squeeze(1)

    def planar_of(self, body_to_world: Tensor) -> Tensor:
        """Return x, y and yaw of the first body of robots at rest in poses: [N, 4, 4] -> [N, 3]; see ``Motion``."""
        home = self.home.unsqueeze(0)
        first = self.kinematics.as_poses(home[:, self.layout.position], home[:, self.layout.orientation])
        return planar_of(body_to_world @ (invert_rigid(self.body_to_world(home)) @ first))

    def placed(self, planar: Tensor) -> Tensor:
        """Return states in which robots stand at rest on the ground, and things on it where their files place them.

        Args:
            planar: [N, 3] positions and headings: x and y in metres, yaw in radians.

        Returns:
            [N, n] float64.
        """
        state = self.home.repeat(len(planar), 1)
        state[:, self.layout.pose] = on_ground(planar.to(self.home), self.home[self.layout.pose], self.terrain)
        return state

    def model_of(self, state: Tensor) -> Tensor:
        """Return the number of the bank's model that states obey, valid even if a state is NaN: [B, n] -> [B] int64."""
        return self.layout.model_of(state, len(self.physics.models))

    def with_model(self, state: Tensor, number: Tensor) -> Tensor:
        """Replace the models of the bank that states obey: [B, n], [B] -> [B, n]."""
        return torch.cat([number.unsqueeze(1).to(state), state[:, self.layout.mujoco]], 1)

    def varied(self, state: Tensor, generator: torch.Generator) -> Tensor:
        """Replace the models that states obey by ones drawn uniformly from the bank: [B, n] -> [B, n]."""
        count = len(self.physics.models)
        if count == 1:
            return state
        drawn = torch.randint(count, (len(state), 1), generator=generator, device=state.device)
        return self.with_model(state, drawn.squeeze(1))

    def thing(self, name: str) -> slice:
        """Return the columns of a state that hold the position and orientation of a thing with a free joint, [7].

        Raises:
            ValueError: for an unknown thing, or one that cannot move freely.
        """
        if (address := self.world.free_joint(name)) is None:
            raise ValueError(f"task.motion.things: expected {name!r} to have a free joint, found none")
        return self.layout.free_joint(address)

    def parts(self, state: Tensor, first: int = 1) -> Parts:
        """Return the parts to draw, the scene and the moving bodies where they are: [B, n] -> [B, 1 + M] parts.

        Args:
            state: [B, n] states.
            first: index of the first of ``models`` among the renderer's models.
        """
        place, turn = self.kinematics(state)
        moving = self.kinematics.as_poses(place[:, 1:], turn[:, 1:])
        scene = torch.eye(4, device=state.device).expand(len(state), 1, 4, 4)
        numbers = torch.arange(first, first + moving.shape[1], device=state.device)
        model = torch.cat([torch.zeros_like(numbers[:1]), numbers]).expand(len(state), -1)
        return Parts(model, torch.cat([scene, moving], 1))

    def ranges(self, state: Tensor, body_to_world: Tensor, beams: Tensor, reach: float) -> Tensor:
        """Return how far beams go before they enter a thing's solid geoms; see ``Motion``."""
        return self.solids.ranges(state, body_to_world, beams, reach)

    def _place_bodies(self) -> None:
        """Prepare where the bodies of states are: those that carry the camera, are drawn, or are solid."""
        models, world = self.physics.models, self.world
        self.kinematics = Kinematics(models, [world.body_of_camera(self.camera), *self._shown])
        self.solids = Solids(models, list(world.things.values()))

    def _check_names(self) -> None:
        """Refuse names that things cannot have in a model, and names of no thing."""
        if taken := [name for name in self.thing_paths if name in RESERVED or "/" in name]:
            raise ValueError(
                f"task.motion.things: expected names without / and other than {', '.join(RESERVED)}, got {taken[0]}"
            )
        for key, names in (("looks", self.looks), ("pushed", self.pushed)):
            if unknown := set(names) - set(self.thing_paths):
                raise ValueError(
                    f"task.motion.{key}: expected names from task.motion.things, got {', '.join(sorted(unknown))}"
                )

    def _check_ahead(self) -> None:
        """Refuse a robot whose first body's x axis points up or down where it stands, so that it has no heading."""
        _, w, x, y, z = self.home[self.layout.pose][2:].tolist()
        up = 2.0 * (x * z - w * y)
        if math.sqrt(max(0.0, 1.0 - up * up)) < LEAST_AHEAD:
            raise ValueError(
                f"{self.path}: expected a first body whose x axis points ahead, got one that points "
                f"{'up' if up > 0 else 'down'}; put the turned parts into a body within it"
            )

    def _check_sound(self) -> None:
        """Refuse a robot whose physics fails within an action with the lowest, highest or alternating controls."""
        low, high = self.world.control_limits()
        every_other = torch.where(torch.arange(len(low)) % 2 == 0, low, high)
        number = torch.arange(len(self.physics.models)).repeat_interleave(3)
        home = self.with_model(self.of_physics(self.home.expand(len(number), -1)), number)
        controls = torch.stack([low, high, every_other]).repeat(len(self.physics.models), 1)
        if not self.physics.step(home, controls).sound.all():
            raise ValueError(
                f"{self.path}: expected physics that can carry out any action, got one that fails within the first; "
                "lower the timestep or the actuators' gains (kv, kp), or add armature to their joints"
            )

    def _check_things(self) -> None:
        """Refuse things that are not drawn, and those with a free joint that do not rest on level ground."""
        for name, path in self.thing_paths.items():
            if not any(body.startswith(f"{name}/") for body in self._shown):
                raise ValueError(
                    f"task.motion.things: {path}: expected a thing with geoms that are drawn (group below "
                    f"{SHOWN_GROUPS}, visible rgba), got none; show one, or give a splat in task.motion.looks.{name}"
                )
        free = {name: self.thing(name) for name in self.thing_paths if self.world.free_joint(name) is not None}
        if not free:
            return
        state = self.of_physics(self.home.unsqueeze(0)).clone()
        for number, columns in enumerate(free.values()):
            state[:, columns][:, 0] += APART * (number + 1)
        before = state
        for _ in range(math.ceil(RESTING / self.held)):
            state = self.physics.step(state, self._rest(state)).state
        for name, columns in free.items():
            risen = float((state - before)[0, columns][2])
            if not abs(risen) <= SETTLED:  # also true for NaN
                raise ValueError(
                    f"task.motion.things: {self.thing_paths[name]}: expected a thing that rests on z = 0 where its "
                    f"file puts it, got one that {'rises' if risen > 0 else 'falls'} by {100 * abs(risen):.3g} cm "
                    f"within {RESTING:g} s; set the pos of its body, and let its geoms touch (contype, conaffinity)"
                )

    def _compare_looks(self) -> None:
        """Warn of looks that are much larger or smaller than the geoms that they replace."""
        for path, name in {path: name for name, path in reversed(self.looks.items())}.items():  # copies share a look
            replaced = gaussians_from_mjcf(self.world.model, f"{name}/")
            if not replaced:
                continue
            shown = zip(self._shown, self.models, strict=True)
            look = [BodyGaussians(*each) for each in shown if each[0] == self.world.things[name]]
            size, own = self.world.size_of(look), self.world.size_of(replaced)
            if not own / LARGER <= size <= LARGER * own:
                warnings.warn(
                    f"task.motion.looks.{name}: {path} is {size:.2g} m across, and the geoms that it replaces are "
                    f"{own:.2g} m; a look is in metres, in the frame of the thing's first body",
                    stacklevel=2,
                )
