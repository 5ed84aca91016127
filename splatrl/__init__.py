"""splatrl: reinforcement learning for robots that see a captured Gaussian splatting scene.

Names are imported on first use, so ``import splatrl`` is fast and imports neither TorchRL nor Hydra. It registers the
tasks with Gymnasium: ``gymnasium.make("splatrl/Grid-v0")``.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from splatrl.gymnasium_ids import register_ids

if TYPE_CHECKING:
    from splatrl.bodies import Box, Capsule, Sphere
    from splatrl.building import env_makers, make_env
    from splatrl.cameras import Cameras
    from splatrl.envs.robot import Robot
    from splatrl.envs.splat_env import SplatEnv
    from splatrl.envs.world import World
    from splatrl.scenes import Gaussians, Scene, backyard, read_scene
    from splatrl.scenes.town import town
    from splatrl.scenes.yards import yard, yards

    __version__: str

_HOMES = {
    "Box": "bodies",
    "Cameras": "cameras",
    "Capsule": "bodies",
    "Gaussians": "scenes",
    "Robot": "envs.robot",
    "Scene": "scenes",
    "Sphere": "bodies",
    "SplatEnv": "envs.splat_env",
    "World": "envs.world",
    "backyard": "scenes",
    "env_makers": "building",
    "make_env": "building",
    "read_scene": "scenes",
    "town": "scenes.town",
    "yard": "scenes.yards",
    "yards": "scenes.yards",
}

__all__ = [
    "Box",
    "Cameras",
    "Capsule",
    "Gaussians",
    "Robot",
    "Scene",
    "Sphere",
    "SplatEnv",
    "World",
    "backyard",
    "env_makers",
    "make_env",
    "read_scene",
    "town",
    "yard",
    "yards",
]

register_ids()


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return import_module("importlib.metadata").version(__name__)  # its import would take half of the package's
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
