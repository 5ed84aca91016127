"""Two scene folders that differ in all that belongs to a scene: position, bounds, height, goal and object."""

from pathlib import Path

from splatrl.scenes import write_gaussians
from tests.tiny import tiny_gaussians

ROOMS = {
    "west": """
splat: room.ply
robot_height: 0.5
goal: [0.5, 1.0, 0.0]
object: [0.75, 1.0, 0.5]
walk: [[-1.0, -1.5], [1.0, 1.5]]
""",
    "east": """
splat: room.ply
world_from_splat: {translation: [5.0, 0.0, 0.1]}
robot_height: 0.65
goal: [5.5, 0.5, 0.0]
object: [5.75, 1.0, 0.6]
walk: [[4.0, -1.5], [6.0, 1.0]]
""",
}
"""The ``scene.yaml`` of each folder, by the folder's name."""


def two_rooms(folder: Path) -> list[Path]:
    """Write the two scene folders into a folder, and return their paths."""
    result = []
    for name, stated in ROOMS.items():
        place = folder / name
        place.mkdir()
        gaussians = tiny_gaussians()
        gaussians.sh = gaussians.sh if name == "west" else gaussians.sh.flip(2)  # swaps red and blue
        write_gaussians(place / "room.ply", gaussians)
        (place / "scene.yaml").write_text(stated.lstrip())
        result.append(place)
    return result


def overrides(task: str = "grid") -> list[str]:
    """Return the overrides that do not belong to a scene."""
    result = [f"task={task}", "device=cpu", "robot.image_width=16", "robot.image_height=12", "network.pool=1"]
    result += ["task.max_steps=20"]
    if task == "grid":
        result += ["robot.body.size=[0.3,0.3,0.2]", "task.motion.step=0.5", "task.motion.angle_step_deg=45.0"]
    if task == "drive":
        result += ["task.motion.time_step=0.4", "task.motion.spacing=0.25", "task.motion.headings=8"]
    return result


def in_both(folder: Path, task: str = "grid") -> list[str]:
    """Write both scenes into a folder, and return the overrides of a batch that spans them."""
    paths = ",".join(str(place) for place in two_rooms(folder))
    return [*overrides(task), "scene=many", f"scene.paths=[{paths}]"]
