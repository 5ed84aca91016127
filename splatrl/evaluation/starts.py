"""Chooses the starts and goals of evaluations: spread over a start set, drawn with a seed, or read from a file."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple, cast

import torch
from torch import Tensor

from splatrl.envs.tasks.base import ChoosingTask, GoalTask
from splatrl.envs.world import World, Worlds
from splatrl.evaluation.episode_sets import MOST_EPISODES, read_episodes, write_episodes
from splatrl.motions import Motion
from splatrl.values import under_key

EPISODES_SEED = 3000
"""Seed of the starts and goals drawn for tests; each scene adds its index."""
PHYSICS_SEED = 4000
"""Seed of what a motion varies between the episodes of tests; each scene adds its index."""


def spread(rows: Tensor, most: int) -> Tensor:
    """Return an evenly spaced subset of the rows of a start set: [N] -> [min(N, most)]."""
    count = min(most, len(rows))
    return rows[torch.linspace(0, len(rows) - 1, count, dtype=torch.float64).round().long()]


class Chosen(NamedTuple):
    """N chosen starts in a world.

    Attributes:
        state: [N, D] states.
        scene: [N] int64, index of the scene; None in a world with one scene.
        distance: [N] int64, length of the shortest path from each, steps; unused if each episode has its own goal.
        memory: the task's memory at each start, by key, for tasks whose episodes have goals of their own.
    """

    state: Tensor
    scene: Tensor | None
    distance: Tensor
    memory: Mapping[str, Tensor] = {}

    def repeated(self, times: int) -> "Chosen":
        """Repeat each start ``times`` times in a row."""
        scene = None if self.scene is None else self.scene.repeat_interleave(times, 0)
        memory = {key: value.repeat_interleave(times, 0) for key, value in self.memory.items()}
        return Chosen(self.state.repeat_interleave(times, 0), scene, self.distance.repeat_interleave(times, 0), memory)


def given_episodes(world: World | Worlds, path: Path, most: int = MOST_EPISODES) -> tuple[World | Worlds, Chosen]:
    """Read the first ``most`` episodes from a file, and give the world a task that knows their goals.

    Returns:
        The world with that task, and the starts of the episodes with the task's memory at each.

    Raises:
        ValueError: for a task whose episodes have no goals of their own, starts that are not free, or a file that
            ``read_episodes`` or ``GoalTask.with_goals`` refuses.
    """
    if world.task.goal_radius is None:
        raise ValueError(
            f"evaluation.episodes: expected a navigation task, such as task=pointnav, got {type(world.task).__name__}"
        )
    start, goal, scene = (values[:most] for values in read_episodes(path, world.names))
    rows, states = [], []
    for number, (name, one) in enumerate(zip(world.names, world.worlds, strict=True)):
        mine, motion = (scene == number).nonzero().squeeze(1), one.task.motion
        state = varied(motion, motion.nearest(start[mine].double()), number)
        wrong = mine[one.plan.checker.collides(motion.body_to_world(state)) | ~motion.inside(state)].tolist()
        rows.append(mine)
        states.append(state)
        if wrong:
            place = [round(value, 3) for value in start[wrong[0], :2].tolist()]
            raise ValueError(
                f"{path}: episode {wrong[0]}: expected a start where the robot fits, got {place} in scene {name}"
            )
    state = torch.cat(states)[torch.cat(rows).argsort()]
    with under_key(str(path)):
        task, memory = cast(GoalTask, world.task).with_goals(state, goal, scene)
    chosen = Chosen(state, scene if len(world.worlds) > 1 else None, torch.zeros(len(state), dtype=torch.int64), memory)
    return replace(world, task=task, made_by=None), chosen


def some_in(world: World | Worlds, number: int, chosen: Chosen, most: int) -> tuple[World, Chosen]:
    """Choose up to ``most`` of the episodes of a ``GoalTask`` in one scene, evenly spaced.

    Args:
        world: world in which the episodes take place.
        number: index of the scene.
        chosen: starts of the episodes in all scenes, with the task's memory at each.
        most: maximum number of episodes.

    Returns:
        The world of the scene, with a task that knows their goals, and their starts.
    """
    here = torch.arange(len(chosen.state)) if chosen.scene is None else (chosen.scene == number).nonzero().squeeze(1)
    rows, one = spread(here, most), world.worlds[number]
    state, goal = chosen.state[rows], chosen.memory["goal"][rows]
    task, memory = cast(GoalTask, one.task).with_goals(state, goal, torch.zeros_like(rows))
    return replace(one, task=task, made_by=None), Chosen(state, None, chosen.distance[rows], memory)


def save_episodes(path: Path, world: World | Worlds, chosen: Chosen, radius: float) -> None:
    """Write the episodes of a ``GoalTask`` in the format that ``given_episodes`` reads.

    Args:
        path: file to write.
        world: world in which they take place.
        chosen: starts of the episodes, with the task's memory at each.
        radius: distance from the goal within which a stop is a success, metres.
    """
    count = len(chosen.state)
    scene = torch.zeros(count, dtype=torch.int64) if chosen.scene is None else chosen.scene
    start, heights = torch.empty(count, 3, dtype=torch.float64), torch.empty(count)
    for number, one in enumerate(world.worlds):
        mine, motion = scene == number, one.task.motion
        start[mine] = motion.planar(chosen.state[mine])
        heights[mine] = motion.body_to_world(chosen.state[mine])[:, 2, 3]
    write_episodes(path, start, chosen.memory, [world.names[number] for number in scene.tolist()], heights, radius)


def spread_starts(world: World | Worlds, most: int) -> Chosen:
    """Choose up to ``most`` starts, evenly spaced over the start set.

    With several scenes, each gets an equal number, at least one, spaced over its own start set. If each episode of the
    task has its own goal, starts and goals are drawn at random instead, with a fixed seed. What the motion varies
    between episodes, such as the physics, depends on the seed and the row alone.
    """
    if world.task.chooses_episodes:
        return _drawn_episodes(world, most)
    plans = [one.plan for one in world.worlds]
    rows = [spread(plan.start_rows, max(1, most // len(plans))) for plan in plans]
    scene = torch.arange(len(plans)).repeat_interleave(torch.tensor([len(own) for own in rows]))
    states = torch.cat(
        [varied(one.task.motion, one.plan.states[rows[number]], number) for number, one in enumerate(world.worlds)]
    )
    distance = torch.cat([plan.distance[own] for plan, own in zip(plans, rows, strict=True)])
    return Chosen(states, scene if len(plans) > 1 else None, distance)


def varied(motion: Motion, state: Tensor, scene: int = 0) -> Tensor:
    """Return starts with what a motion varies between episodes, drawn with a fixed seed: [N, n] -> [N, n]."""
    return motion.varied(state, torch.Generator().manual_seed(PHYSICS_SEED + scene))


def _drawn_episodes(world: World | Worlds, most: int) -> Chosen:
    """Draw starts and goals for tests, equally many in each scene."""
    count, together = max(1, most // len(world.worlds)), cast(ChoosingTask, world.task)
    drawn: list[dict[str, Tensor]] = []
    for number, one in enumerate(world.worlds):
        task = cast(ChoosingTask, one.task)
        own = task.episodes(one.plan.starts.cpu(), count, EPISODES_SEED + number)
        drawn.append(together.in_scene(own, number))
    episodes = {key: torch.cat([each[key] for each in drawn]) for key in drawn[0]}
    scene = torch.arange(len(drawn)).repeat_interleave(count)
    state = episodes.pop("state")
    return Chosen(state, scene if len(drawn) > 1 else None, torch.zeros(len(state), dtype=torch.int64), episodes)
