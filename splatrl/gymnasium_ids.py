"""Gymnasium ids of the tasks: after ``import splatrl``, ``gymnasium.make("splatrl/Grid-v0")`` works."""

from __future__ import annotations

import secrets
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal

import gymnasium

if TYPE_CHECKING:
    from splatrl.envs.gymnasium_env import GymnasiumEnv
    from splatrl.envs.gymnasium_vector_env import GymnasiumVectorEnv

TASKS: tuple[str, ...] = (
    *("grid", "fps", "apple", "sim2real", "snake", "drive", "circle", "polar_plane", "hemisphere", "poster"),
    *("pointnav", "imagenav", "push", "gates", "route", "walk", "strides"),
)
"""Tasks in conf/task that get an id."""


def gymnasium_id(task: str) -> str:
    """Return the Gymnasium id of a task: ``splatrl/PolarPlane-v0`` for ``polar_plane``."""
    return f"splatrl/{''.join(word.capitalize() for word in task.split('_'))}-v0"


def register_ids() -> None:
    """Register the tasks with Gymnasium; their dependencies are imported only when the first env is made."""
    for task in TASKS:
        gymnasium.register(
            gymnasium_id(task),
            entry_point="splatrl.gymnasium_ids:make_one",
            vector_entry_point="splatrl.gymnasium_ids:make_batch",
            kwargs={"task": task},
        )


def make_one(
    task: str,
    scene: str = "backyard",
    overrides: Sequence[str] = (),
    seed: int | None = None,
    render_mode: Literal["rgb_array"] | None = None,
) -> GymnasiumEnv:
    """Make an env with one robot, for ``gymnasium.make``.

    Args:
        task: name of a task.
        scene: name of a scene, a splat file, or a scene's folder.
        overrides: settings in Hydra's grammar, as on the command line: ``["robot.height=0.4"]``.
        seed: seed of the starts until ``reset(seed=...)`` sets another; None draws one from the operating system's
            entropy, as Gymnasium's own envs do.
        render_mode: what ``render`` returns: the current view for ``rgb_array``, nothing for None.

    Raises:
        ValueError: for settings that are refused.
    """
    from splatrl.building import make_env
    from splatrl.envs.gymnasium_env import GymnasiumEnv

    return GymnasiumEnv(make_env(_overrides(task, scene, overrides), [1], _seeded(seed)), render_mode)


def make_batch(
    num_envs: int,
    task: str,
    scene: str = "backyard",
    overrides: Sequence[str] = (),
    seed: int | None = None,
    max_episode_steps: int | None = None,
    **options: Any,
) -> GymnasiumVectorEnv:
    """Make a vector env with a batch of robots in one scene, for ``gymnasium.make_vec``.

    Args:
        num_envs: number of robots.
        task: see ``make_one``.
        scene: see ``make_one``.
        overrides: see ``make_one``.
        seed: see ``make_one``.
        max_episode_steps: sets ``task.max_steps``, as Gymnasium's argument of this name; None or -1 leaves it.
        options: further arguments of ``GymnasiumVectorEnv``.

    Raises:
        ValueError: for settings that are refused.
    """
    from splatrl.building import make_env
    from splatrl.envs.gymnasium_vector_env import GymnasiumVectorEnv

    limit = [] if max_episode_steps in (None, -1) else [f"task.max_steps={max_episode_steps}"]
    chosen = [*_overrides(task, scene, overrides), *limit]
    return GymnasiumVectorEnv(make_env(chosen, [num_envs], _seeded(seed)), **options)


def _seeded(seed: int | None) -> int:
    return secrets.randbits(63) if seed is None else seed


def _overrides(task: str, scene: str, overrides: Sequence[str]) -> list[str]:
    from splatrl.configuration import check_texts, quoted

    check_texts(overrides)
    return [f"task={quoted(task)}", f"scene={quoted(scene)}", *overrides]
