"""The rules of an episode: what its beginning and its steps consist of."""

from collections.abc import Mapping
from enum import IntEnum
from functools import partial
from typing import NamedTuple

import torch
from tensordict import TensorDictBase
from torch import Tensor

from splatrl.collision.base import Checker
from splatrl.collision.several import SeveralCheckers, checkers_of
from splatrl.envs.senses import Look, Senses, Standing
from splatrl.envs.tasks.base import NOTHING, Anywhere, Outcome, Step, Task

COUNTED = ("step_count", "episode_return", "level", "goals")
"""Keys of the counters that a step reads and updates."""
DRAW = "_draw"
"""Key of which views are drawn; see ``SplatEnv``."""


class Draw(IntEnum):
    """When a robot's view after a step is drawn."""

    NEVER = 0
    AT_END = 1
    """Only if its episode ends in this step."""
    ALWAYS = 2


class Start(NamedTuple):
    """N episodes that are about to begin.

    Attributes:
        scene: [N] int64, scene of each episode; None if there is only one.
        state: [N, ...] start states.
        level: [N, 1] int64, curriculum levels; -1 for given states.
        memory: the task's memory, [N, ...] by key.
    """

    scene: Tensor | None
    state: Tensor
    level: Tensor
    memory: dict[str, Tensor]

    def of(self, rows: Tensor) -> "Start":
        """Return some of the episodes, [M] int64."""
        scene = None if self.scene is None else self.scene.index_select(0, rows)
        memory = {key: value.index_select(0, rows) for key, value in self.memory.items()}
        return Start(scene, self.state.index_select(0, rows), self.level.index_select(0, rows), memory)


class Rules(NamedTuple):
    """What happens in episodes, as functions of the entries that travel in the TensorDict; nothing is kept here.

    Attributes:
        task: motion, goals and rewards.
        checker: finds what the robot's body touches.
        senses: camera and sensors of the robots.
        task_keys: keys of what the task remembers.
        sensor_keys: keys of what the sensors remember.
    """

    task: Task
    checker: Checker | SeveralCheckers
    senses: Senses
    task_keys: tuple[str, ...]
    sensor_keys: tuple[str, ...]

    @property
    def scenes(self) -> int:
        """Number of scenes."""
        return len(checkers_of(self.checker))

    @property
    def reads(self) -> tuple[str, ...]:
        """Keys that a step reads; some of them may be absent."""
        return ("state", "action", *COUNTED, "scene", "camera_offset", DRAW, *self.task_keys, *self.sensor_keys)

    def at(self, scene: Tensor | None) -> tuple[Task, Checker]:
        """Return task and checker for rows in some scenes, [N] int64; None stands for the only scene."""
        if scene is None:
            assert not isinstance(self.checker, SeveralCheckers)
            return self.task, self.checker
        assert isinstance(self.checker, SeveralCheckers)
        return self.task.at(scene), self.checker.at(scene)

    def begun(
        self,
        start: Start,
        kept: Mapping[str, Tensor] | TensorDictBase = NOTHING,
        camera_offset: Tensor | None = None,
        only: Tensor | None = None,
    ) -> dict[str, Tensor]:
        """Return the entries of N episodes that begin: [N, ...] by key.

        Args:
            start: the episodes.
            kept: given memory of task and sensors; where a key is present, it replaces the fresh value.
            camera_offset: [N, 6] float32, see ``SplatEnv``.
            only: [N] bool, the rows that are requested; None requests all. Other rows may hold anything.
        """
        scene, state, level, memory = start
        task, checker = self.at(scene)
        memory |= {key: kept[key].clone() for key in memory if kept.get(key, None) is not None}
        robots = Standing(task, checker, scene, state, task.motion.body_to_world(state), memory)
        view, free_fraction = self.senses.view(robots, camera_offset, only), torch.ones(len(state), device=state.device)
        count = torch.zeros_like(level)
        flag = torch.zeros_like(level, dtype=torch.bool)
        return {
            "pixels": view.pixels,
            **view.shown,
            "state": state,
            **memory,
            **self.senses.begin(robots, view, free_fraction, kept, only),
            **({} if scene is None else {"scene": scene.unsqueeze(1)}),
            "level": level,
            "step_count": count,
            "episode_return": torch.zeros_like(level, dtype=torch.float32),
            "outcome": count.clone(),
            "goals": task.goals_reached(state, memory),
            "success": flag,
            "free_fraction": free_fraction.unsqueeze(1),
            **{key: flag.clone() for key in ("done", "terminated", "truncated")},
        }

    def stepped(
        self, given: Mapping[str, Tensor] | TensorDictBase, scene: Tensor | None, anywhere: Anywhere
    ) -> dict[str, Tensor]:
        """Carry out and judge a step of N robots, and return its entries: [N, ...] by key.

        Args:
            given: the entries that a step ``reads``.
            scene: [N] int64, scene of each robot; None if there is only one.
            anywhere: see ``Task.judge``.
        """
        before, action = given["state"], given["action"]
        task, checker = self.at(scene)
        memory = {key: given[key] for key in self.task_keys}
        move = task.motion.move(before, action, checker)
        robots = Standing(task, checker, scene, move.state, move.body_to_world, memory)
        look = Look(partial(self.senses.view, robots, given.get("camera_offset", None)))
        reward, terminated, outcome, remembered = task.judge(Step(before, action, move, memory, look), anywhere)
        kept = {key: given[key] for key in self.sensor_keys}
        known = {**memory, **remembered, **kept}
        step_count = given["step_count"] + 1
        truncated = (step_count >= task.max_steps) & ~terminated
        done = terminated | truncated
        view = look.of(rows_to_draw(given, done))
        goals = given["goals"] + (outcome == Outcome.GOAL)
        return {
            "pixels": view.pixels,
            **view.shown,
            "state": move.state,
            **{key: value.clone() for key, value in (kept | {**remembered}).items()},
            **self.senses.read(robots, view, move.free_fraction, known, move.sensed),
            **({} if scene is None else {"scene": given["scene"].clone()}),
            "step_count": step_count,
            "episode_return": given["episode_return"] + reward,
            "level": given["level"].clone(),
            "outcome": torch.where(truncated, Outcome.TIMEOUT, outcome),
            "goals": goals,
            "success": goals >= (task.goals_for_success or 1),
            "free_fraction": move.free_fraction.unsqueeze(1),
            "reward": reward,
            "done": done,
            "terminated": terminated,
            "truncated": truncated,
        }

    def drawn(
        self, state: Tensor, body_to_world: Tensor, camera_offset: Tensor | None = None, only: Tensor | None = None
    ) -> dict[str, Tensor]:
        """Return what is drawn for robots in the only scene, for a task that remembers nothing: [N, ...] by key.

        Args:
            state: [N, ...] states.
            body_to_world: [N, 4, 4] float32, the poses of these states, metres.
            camera_offset: [N, 6] float32, see ``SplatEnv``.
            only: [N] bool, the rows to draw; None draws all.
        """
        task, checker = self.at(None)
        view = self.senses.view(Standing(task, checker, None, state, body_to_world, NOTHING), camera_offset, only)
        return {"pixels": view.pixels, **view.shown}


def rows_to_draw(given: Mapping[str, Tensor] | TensorDictBase, done: Tensor) -> Tensor | None:
    """Return the rows whose views are needed after a step, [N] bool, or None for all.

    Args:
        given: the entries that the step ``reads``.
        done: [N, 1] bool, whether the episode has ended.
    """
    draw = given.get(DRAW, None)
    return None if draw is None else (draw + done >= Draw.ALWAYS).flatten()
