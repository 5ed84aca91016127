"""Generated yards as scenes, generated once and kept in the user's cache directory, with the places that tasks need."""

import functools
import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from subprocess import DEVNULL, Popen
from typing import Any

import numpy as np
import torch

from splatrl.files import cache_dir, digest_of
from splatrl.scenes.cache import Arrays, cached_arrays
from splatrl.scenes.gaussians import Gaussians
from splatrl.scenes.scene import Bounds, Scene, checked_bounds
from splatrl.scenes.yards.generator import made_yard
from splatrl.values import require_number

FIELDS = ("means", "quats", "scales", "opacities", "sh")
HEIGHT = 3.0
"""Height of a yard's bounds, metres."""
ROBOT_HEIGHT = 0.4
"""Height of the centre of the robot that a yard is checked with, metres."""
CLEARANCE = 0.45
"""Distance from the sides of a yard to the region where robots walk, metres."""


@dataclass(frozen=True, eq=False)
class Yard:
    """A generated yard, and the places in it that tasks need.

    Attributes:
        seed: seed that it was generated from.
        scene: its Gaussians and bounds.
        goal: x and y in metres and yaw in degrees of a free pose that looks straight at the red egg, on the lattice
            of the grid task.
        object: x, y and z of a free place where an apple hangs, metres.
        egg: x, y and z of the centre of the red egg, metres.
        walk: lower and upper x and y between which a robot can walk, metres; the grid task uses the 2 × 2 m around
            the origin.
        blocked: fraction of the places in those 2 × 2 m where the body fits at no heading.
        longest: steps of the grid task from the farthest free pose to the goal.
    """

    seed: int
    scene: Scene
    goal: tuple[float, float, float]
    object: tuple[float, float, float]
    egg: tuple[float, float, float]
    walk: tuple[tuple[float, float], tuple[float, float]]
    blocked: float
    longest: int


def yard(seed: int = 0, bounds: Sequence[Sequence[float]] | None = None) -> Scene:
    """Generate a yard whose walls, size, paths, trees, furniture, egg and light differ for every seed.

    Generating one takes about half a second; it is then kept in the user's cache directory, in 2 to 4 MB. The same seed
    gives the same bytes. ``yards`` also returns its goal; on the command line, ``scene=yard scene.seed=3`` sets it.

    Example:
        >>> yard(3).name
        'yard-3'

    Args:
        seed: seed of the yard, at least 0.
        bounds: lower and upper corner, world frame, metres; None takes the space inside its walls.

    Raises:
        ValueError: for a seed that is not a whole number of at least 0, or for empty bounds.
    """
    require_number("scene.seed", seed, 0, 2**63 - 1, whole=True)
    scene = _yard(seed, _cached(seed)).scene
    return scene if bounds is None else Scene(scene.name, scene.gaussians, checked_bounds(bounds))


def yards(seeds: Iterable[int], workers: int = 1) -> list[Yard]:
    """Generate several yards, in the order of the seeds, each with its goal and the other places that tasks need.

    Example:
        >>> [one.scene.name for one in yards([3, 5])]
        ['yard-3', 'yard-5']

    Args:
        seeds: whole numbers of at least 0.
        workers: number of processes that generate the yards missing from the cache.

    Raises:
        ValueError: for a seed or a number of workers that is out of range.
    """
    return list(made_yards(seeds, workers))


def made_yards(seeds: Iterable[int], workers: int = 1) -> Iterator[Yard]:
    """Yield the same yards as ``yards``, each as soon as it is ready, so that a progress bar can show them."""
    wanted = list(seeds)
    for seed in wanted:
        require_number("scene.seed", seed, 0, 2**63 - 1, whole=True)
    require_number("workers", workers, 1, whole=True)
    missing = [seed for seed in dict.fromkeys(wanted) if not _path(seed).is_file()]
    if workers == 1 or len(missing) < 2:
        yield from (_yard(seed, _cached(seed)) for seed in wanted)
        return
    shares = [missing[number::workers] for number in range(min(workers, len(missing)))]
    makers = {seed: number for number, share in enumerate(shares) for seed in share}
    command = [sys.executable, "-m", "splatrl.scenes.yards"]  # a pool would import the caller's script again
    processes = [Popen([*command, *map(str, share)], stdout=DEVNULL) for share in shares]
    try:
        for seed in wanted:
            maker = processes[makers[seed]] if seed in makers else None
            while maker is not None and not _path(seed).is_file() and maker.poll() is None:
                time.sleep(0.02)
            yield _yard(seed, _cached(seed))
    finally:
        for process in processes:
            process.terminate()
            process.wait()


def proposals(seed: int) -> dict[str, Any]:
    """Return the training settings that a yard proposes, by the keys of a ``scene.yaml``."""
    require_number("scene.seed", seed, 0, 2**63 - 1, whole=True)
    one = _yard(seed, _cached(seed))
    return {"goal": list(one.goal), "object": list(one.object)}


def _yard(seed: int, arrays: Arrays) -> Yard:
    x0, y0, x1, y1 = (float(value) for value in arrays["outline"])
    tensors = {name: torch.from_numpy(arrays[name]) for name in FIELDS}
    gaussians = Gaussians(**tensors, batch_size=[len(tensors["means"])])
    bounds: Bounds = ((x0, y0, 0.0), (x1, y1, HEIGHT))
    blocked, longest = arrays["difficulty"].tolist()
    return Yard(
        seed=seed,
        scene=Scene(f"yard-{seed}", gaussians, bounds),
        goal=_three(arrays["goal"]),
        object=_three(arrays["object"]),
        egg=_three(arrays["egg"]),
        walk=((x0 + CLEARANCE, y0 + CLEARANCE), (x1 - CLEARANCE, y1 - CLEARANCE)),
        blocked=blocked,
        longest=int(longest),
    )


def _three(values: np.ndarray[Any, Any]) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in values)
    return x, y, z


def _cached(seed: int) -> Arrays:
    return cached_arrays(_name(seed), functools.partial(_made, seed))


def _made(seed: int) -> Arrays:
    made = made_yard(seed)
    layout, found = made.layout, made.found
    return {
        **{name: getattr(made.gaussians, name).numpy() for name in FIELDS},
        "outline": np.array(layout.outline),
        "goal": np.array(layout.goal),
        "object": np.array([*made.hanging, ROBOT_HEIGHT]),
        "egg": np.array(layout.egg.center),
        "difficulty": np.array([found.blocked, found.longest]),
    }


def _path(seed: int) -> Path:
    return cache_dir() / f"{_name(seed)}.npz"


def _name(seed: int) -> str:
    return f"yard-{seed}-{_source_digest()}"


@functools.cache
def _source_digest() -> str:
    """Return a fingerprint of the generator's source, so that no other version ever uses its cached yards."""
    folders = Path(__file__).parent, Path(__file__).parents[1] / "yard"
    return digest_of(path for folder in folders for path in sorted(folder.glob("*.py")))
