"""The page itself: the splats, the layers over them, and the initial camera."""

import math
import threading
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor

from splatrl.collision.occupancy import Occupancy
from splatrl.curriculum import Plan
from splatrl.scenes.description import PATH
from splatrl.scenes.scene import Bounds, Scene
from splatrl.viewer.layers import box_lines, free_places, path_lines, surface
from splatrl.viewer.server import address, close, open_server
from splatrl.viewer.splats import BYTES, Splats, parts_of

if TYPE_CHECKING:
    import viser

SOLID, FREE, NO_WAY, WALKED, LIMITS = (88, 110, 150), (46, 160, 67), (227, 179, 65), (31, 111, 235), (130, 80, 223)
AWAY, ABOVE = 0.8, 0.7
"""Horizontal distance and height of the initial camera from the scene's centre, as multiples of its longer side."""
NEAREST, BEYOND = 1e-3, 3.0
"""Nearest distance that the page draws, as a multiple of the scene's longer side; and the farthest, as a multiple of
that side or, if it is longer, of the distance of the farthest Gaussian from the centre."""
AS_MANY = "automatic"
SIDES = 8
"""Number of viewpoints around the scene, at the same distance, from which its colours are averaged."""


class Page:
    """A page that shows a scene, and to which other modules add panels.

    Args:
        scene: the scene to show.
        host: address of this machine to listen on.
        port: port to listen on.

    Raises:
        ImportError: without the extra ``view``.
        ValueError: for a host or a port that cannot be listened on.
    """

    def __init__(self, scene: Scene, host: str = "127.0.0.1", port: int = 8080):
        self.scene = scene
        self.turn = threading.RLock()  # held while drawing or stepping: callbacks run in many threads
        parts = parts_of(scene.gaussians, around(scene.bounds))
        self.server: viser.ViserServer = open_server(host, port, scene.name)
        self._aim(scene)
        self.layers = self.server.gui.add_folder("layers")
        self.splats = Splats(self.server, parts)
        self._layer("splats", self.splats.root, True)
        self._offer_fewer()
        self._lines("bounds", box_lines(scene.bounds), LIMITS)
        self.bytes = BYTES * len(scene.gaussians)

    @property
    def address(self) -> str:
        """The page's URL."""
        return address(self.server)

    def close(self) -> None:
        """Stop serving."""
        close(self.server)

    def show_occupancy(self, occupancy: Occupancy) -> None:
        """Offer a layer with the solid voxels, which is computed and sent when it is first switched on."""

        def add() -> Any:
            vertices, triangles = surface(occupancy)
            options: dict[str, Any] = {"flat_shading": True, "side": "double", "opacity": 0.85}
            return self.server.scene.add_mesh_simple("/solid", vertices, triangles, color=SOLID, **options)

        if occupancy.count:
            self._later("solid", add)

    def show_free(self, plan: Plan) -> None:
        """Offer a layer of where robots fit: green where the goal can be reached from, yellow where it cannot."""
        leads, others = free_places(plan)
        colors = np.repeat(np.array([FREE, NO_WAY], np.uint8), [len(leads), len(others)], 0)
        size = 0.25 * plan.motion.step

        def add() -> Any:
            return self.server.scene.add_point_cloud(
                "/free", np.concatenate([leads, others]), colors, point_size=size, point_shape="circle"
            )

        self._later("free space at the robot's height", add)

    def show_path(self, folder: Path) -> None:
        """Show the path of the camera that captured a scene as a layer, if the scene's folder has one."""
        lines = path_lines(folder, PATH)
        if lines is not None and len(lines):
            self._lines("camera path", lines, WALKED, True)

    def move_bounds(self, bounds: Bounds) -> None:
        """Draw the bounds somewhere else."""
        self._bounds.points = box_lines(bounds)

    def _offer_fewer(self) -> None:
        """Let visitors choose how many splats are drawn, if there is more than one part of them."""
        counts = [f"{count:,}" for count in self.splats.counts]
        if len(counts) < 2:
            return
        hint = "the most important splats first: more look better, fewer render faster"
        with self.layers:
            choice = self.server.gui.add_dropdown("splats drawn", [AS_MANY, *counts], initial_value=AS_MANY, hint=hint)

        @choice.on_update
        def choose(_: object) -> None:
            self.splats.show(None if choice.value == AS_MANY else 1 + counts.index(choice.value))

    def _lines(self, name: str, lines: Any, color: tuple[int, int, int], visible: bool = False) -> None:
        node = self.server.scene.add_line_segments(f"/{name}", lines, color, thickness=2, thickness_units="screen")
        if name == "bounds":
            self._bounds = node
        self._layer(name, node, visible)

    def _layer(self, name: str, node: Any, visible: bool) -> None:
        node.visible = visible
        with self.layers:
            box = self.server.gui.add_checkbox(name, visible)

        @box.on_update
        def toggle(_: object) -> None:
            node.visible = box.value

    def _later(self, name: str, add: Callable[[], Any]) -> None:
        with self.layers:
            box = self.server.gui.add_checkbox(name, False)
        made: list[Any] = []

        @box.on_update
        def toggle(_: object) -> None:
            if not made:
                made.append(add())
            made[0].visible = box.value

    def _aim(self, scene: Scene) -> None:
        """Place the initial camera above the scene, on the side where it is lowest, looking down at its centre.

        It draws from 0.01 to 1,000 m, as viser's camera does, or nearer and farther if the scene needs it.
        """
        lower, upper = np.array(scene.bounds)
        middle, means = 0.5 * (lower + upper), scene.gaussians.means.cpu().numpy()
        walls = means[((means >= middle * [0, 0, 1] + lower * [1, 1, 0]) & (means <= upper)).all(1)]
        tall = (walls.mean(0) - middle)[:2] if len(walls) else np.zeros(2)
        length, side = float(np.linalg.norm(tall)), float((upper - lower)[:2].max()) or 1.0
        ahead = tall / length if length > 0.02 * side else np.array([0.6, 0.8])
        camera = self.server.initial_camera
        camera.position = middle + side * np.array([*(-AWAY * ahead), ABOVE])
        camera.look_at, camera.up = middle, np.array([0.0, 0.0, 1.0])
        farthest = float(np.linalg.norm(means - middle, axis=1).max(initial=side))
        camera.near = min(camera.near, NEAREST * side)
        camera.far = max(camera.far, BEYOND * farthest)


def around(bounds: Bounds) -> Tensor:
    """Return viewpoints around a scene from which a visitor may look at it: [SIDES, 3], metres."""
    lower, upper = torch.tensor(bounds)
    turn = math.tau * torch.arange(SIDES) / SIDES
    away = torch.stack([AWAY * turn.cos(), AWAY * turn.sin(), torch.full_like(turn, ABOVE)], 1)
    return 0.5 * (lower + upper) + (upper - lower)[:2].max() * away
