"""What robots could do in a scene that comes without cameras: what is solid, where to walk, and what to look for."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

from splatrl.capture.lattice import remarks
from splatrl.capture.pictures import GOALS, draw_goals
from splatrl.capture.suggestions import Goal, place_proposals, seen_in_splat, suggest
from splatrl.capture.walkable import walkable_area
from splatrl.collision.occupancy import Occupancy
from splatrl.evaluation.scene_pictures import draw_scene, stated_occupancy, survey_occupancy
from splatrl.evaluation.terrain_pictures import draw_terrain
from splatrl.physics.survey import Surveyed, find_terrain
from splatrl.scenes.scene import Bounds, Scene

REACH = 0.3
"""Maximum reach, in metres, of a robot with physics beyond its position and above its camera, for drawing boxes."""
FILL = 0.2
"""Width of the openings that count as closed, metres, as in training."""
Walk = tuple[Sequence[float], Sequence[float]]
"""Lower and upper corner of where robots walk, x and y in metres."""


@dataclass(frozen=True)
class ScenePictures:
    """Pictures of what an inspection finds, drawn as files in one folder.

    Attributes:
        folder: the folder, created if necessary.
        antialiased: whether the scene is rendered antialiased; False gives classic 3DGS images.
    """

    folder: Path
    antialiased: bool = True

    def of_scene(self, scene: Scene, occupancy: Occupancy, floor: float, height: float) -> list[Path]:
        """Draw what is free and solid, and a view from inside; return the files."""
        return draw_scene(scene, occupancy, floor, height, self.folder, self.antialiased)

    def view(self, scene: Scene) -> Path:
        """Return the file with the view from inside that ``of_scene`` draws."""
        return self.folder / f"{scene.name}-view.png"

    def of_goals(self, scene: Scene, goals: Sequence[Goal], height: float) -> list[Path]:
        """Draw the view from each goal, if there are any; return the files."""
        if not goals:
            return []
        draw_goals(scene.gaussians, goals, height, self.folder / GOALS, self.antialiased)
        return [self.folder / GOALS]

    def of_terrain(self, scene: Scene, found: Surveyed, walk: Walk) -> list[Path]:
        """Draw the ground and the boxes that physics uses; return the files."""
        picture = self.folder / f"{scene.name}-ground.png"
        draw_terrain(scene.gaussians, found, *walk, picture, self.antialiased)
        return [picture]


class Proposed(NamedTuple):
    """What an inspection proposes for a scene's ``scene.yaml``.

    Attributes:
        bounds: bounds of where robots can be, metres.
        settings: other keys and their values.
        lines: what was found, to be printed.
    """

    bounds: Bounds
    settings: dict[str, Any]
    lines: list[str]


def inspect_occupancy(
    scene: Scene,
    floor: float,
    height: float,
    pictures: ScenePictures,
    resolution: float | None = None,
    stated: Mapping[str, Any] | None = None,
) -> tuple[Occupancy, list[str]]:
    """Find what is solid, and draw it.

    Args:
        scene: the scene, in the world frame.
        floor: height of the floor, metres.
        height: height of the robot, metres.
        pictures: draws what is found.
        resolution: edge of a voxel, metres; None chooses one.
        stated: keys and values of the scene's ``scene.yaml``, by which training decides what is solid; None for a scene
            without one.

    Returns:
        What is solid, and lines that say how much.

    Raises:
        ValueError: for a scene without extent, or a grid that becomes too large.
    """
    occupancy = survey_occupancy(scene, resolution) if stated is None else stated_occupancy(scene, stated, resolution)
    return occupancy, [str(occupancy.report()), *_drew(pictures.of_scene(scene, occupancy, floor, height))]


def inspect_terrain(
    scene: Scene, occupancy: Occupancy, walk: Walk, height: float, pictures: ScenePictures
) -> list[str]:
    """Find and draw the ground and the boxes with which a robot with physics would collide; return what was found.

    Args:
        scene: the scene, in the world frame.
        occupancy: what is solid in it.
        walk: where robots walk.
        height: height of the robot, metres.
        pictures: draws what is found.
    """
    (left, front), (right, back) = walk
    bottom, top = scene.bounds[0][2], scene.bounds[1][2]
    around = (left - REACH, front - REACH, bottom), (right + REACH, back + REACH, max(top, bottom + 2 * height))
    filled = occupancy.solid(FILL, around=around)
    try:
        found = find_terrain(scene, filled, *walk, REACH, height + REACH, pictures.antialiased)
    except ValueError as error:
        return [f"ground      none: {str(error).removeprefix('ground: ')}"]
    boxes = f"boxes       {len(found.terrain.boxes)}, up to {height + REACH:g} m above the ground"
    return [str(found.ground), boxes, *_drew(pictures.of_terrain(scene, found, walk))]


def propose(scene: Scene, occupancy: Occupancy, floor: float, height: float, pictures: ScenePictures) -> Proposed:
    """Find where robots could walk and which goals they could look for, and draw both.

    Args:
        scene: the scene, in the world frame.
        occupancy: what is solid in it.
        floor: height of the floor, metres.
        height: height of the robot, metres.
        pictures: draws what is found.
    """
    area = walkable_area(scene, occupancy, floor, height)
    if area is None:
        reason = f"no floor has free space {height:g} m above it; try another --height, --up or --scale"
        return Proposed(scene.bounds, {}, [f"goals       none: {reason}"])
    if area.robot_height <= 0.0:
        reason = f"expected the floor at z = 0, got {floor:.4g} m; raise it with --matrix or --translation"
        return Proposed(scene.bounds, {}, [f"goals       none: {reason}"])
    found = suggest(seen_in_splat(scene.gaussians), area)
    lines = _drew(pictures.of_goals(scene, found.goals, area.robot_height))
    for number, goal in enumerate(found.goals, 1):
        lines.append(f"goal {number}      {list(goal)}" + (", written as the scene's goal" if number == 1 else ""))
    lines += inspect_terrain(replace(scene, bounds=area.bounds), area.occupancy, area.walk, height, pictures)
    (left, bottom), (right, top) = area.walk
    lines.append(f"walk        x {left:g} to {right:g}, y {bottom:g} to {top:g} m, steps of {area.spacing:g} m")
    lines += [f"            {said}" for said in remarks(area.ground(), area.walk, area.spacing)]
    return Proposed(area.bounds, place_proposals(area, found), lines)


def _drew(files: Sequence[Path]) -> list[str]:
    return [f"drew        {file}" for file in files]
