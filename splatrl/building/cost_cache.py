"""Shortest-path costs, computed once per place and kept in the cache."""

import json
from collections.abc import Callable
from functools import cache
from hashlib import blake2b
from pathlib import Path

import numpy as np
import torch
from omegaconf import DictConfig, OmegaConf

from splatrl.collision.occupancy import Occupancy
from splatrl.configuration.targets import targets
from splatrl.curriculum.field import Field, Moves, cost_field
from splatrl.files import digest_of
from splatrl.made_with import digests_of
from splatrl.native import _core
from splatrl.scenes.cache import cached_arrays

DEPENDS_ON = ("collision", "curriculum", "envs/tasks", "motions", "physics")
"""Sub-packages whose Python code and robots the costs depend on."""


def remembering(cfg: DictConfig, occupancy: Occupancy) -> Callable[[Moves], Field]:
    """Return ``cost_field`` with a cache, used as long as task, robot, checker, occupancy and repeats are the same.

    Task and robot are the same if their settings and the content of the files that these name are, such as MJCF.

    Only splatrl's own tasks, robots and checkers are cached, because changes in another package's code go unnoticed.

    Args:
        cfg: config with one scene.
        occupancy: the solid voxels.
    """
    parts = OmegaConf.create({"task": cfg.task, "robot": cfg.robot, "checker": cfg.collision.cpu}, parent=cfg)
    if not all(str(target).startswith("splatrl.") for _, target in targets(parts)):
        return cost_field
    plain, files = OmegaConf.to_container(parts, resolve=True), digests_of(parts)

    def found(moves: Moves) -> Field:
        recipe = json.dumps([plain, files, moves.repeats, occupancy.digest, _code()], sort_keys=True)
        name = f"costs-{blake2b(recipe.encode(), digest_size=16).hexdigest()}"
        kept = cached_arrays(name, lambda: {"costs": cost_field(moves).cost_to_go.numpy()}, what="costs")
        costs = kept.get("costs")
        if costs is None or costs.shape != (len(moves.motion.nodes()),) or costs.dtype != np.float32:
            return cost_field(moves)
        return Field(moves.motion, torch.from_numpy(costs))

    return found


@cache
def _code() -> str:
    """Return a digest of the code that the costs depend on: Python modules, built-in robots and the compiled core."""
    package = Path(__file__).parents[1]
    inner = (path for name in DEPENDS_ON for path in package.joinpath(name).rglob("*"))
    modules = [*package.glob("*.py"), *(path for path in inner if path.suffix in (".py", ".xml"))]
    return digest_of([*sorted(modules), Path(_core.__file__)])
