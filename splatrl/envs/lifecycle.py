"""From one episode to the next: episodes are drawn and begin, take their steps, and the curriculum records their ends.

What outlives an episode, the generator and the curriculum's progress, changes only here.
"""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import NamedTuple

import torch
from tensordict import TensorDictBase
from torch import Tensor

from splatrl.curriculum.starts import Curriculum
from splatrl.envs.lattice_steps import LatticeSteps
from splatrl.envs.restart import with_rows
from splatrl.envs.rules import Rules, Start, rows_to_draw
from splatrl.envs.tasks.base import Anywhere
from splatrl.envs.validation import check_memory, check_seeds, given_scene, given_state


class Lifecycle(NamedTuple):
    """The succession of episodes of B robots.

    Attributes:
        rules: what beginnings and steps consist of.
        curriculum: decides where episodes begin, and records their ends.
        generator: draws whatever is random.
        robots: number of robots, B.
    """

    rules: Rules
    curriculum: Curriculum
    generator: torch.Generator
    robots: int

    def draw(self, only: Tensor | None = None, seeds: Sequence[int | None] | None = None) -> Start:
        """Draw a new episode for each robot.

        Args:
            only: [B] bool, the rows in which episodes begin; None begins all.
            seeds: see ``SplatEnv``.
        """
        if seeds is not None:
            check_seeds(seeds, self.robots)
        scene, state, memory = self._drawn(self.robots, self.generator)
        for row, seed in enumerate(seeds or ()):
            if seed is not None:
                its_scene, its_state, its_memory = self._drawn(1, torch.Generator(state.device).manual_seed(seed))
                state[row] = its_state[0]
                if scene is not None and its_scene is not None:
                    scene[row] = its_scene[0]
                for key, value in memory.items():
                    value[row] = its_memory[key][0]
        self.curriculum.begin(self._all() if only is None else only)
        return Start(scene, state, self.curriculum.level.expand(self.robots, 1).clone(), memory)

    def given(self, given: TensorDictBase, only: Tensor | None = None) -> Start:
        """Take the beginning of each robot's episode from ``state`` and, of several scenes, ``scene``.

        Args:
            given: [B]; the task's memory in it is checked, too.
            only: see ``draw``.

        Raises:
            ValueError: for values outside their spec, or missing ones.
        """
        task, scenes = self.rules.task, self.rules.scenes
        scene = None if scenes == 1 else given_scene(given, scenes, only)
        state = given_state(given, task.motion.state_spec, only)
        memory = {**self.rules.at(scene)[0].begin(state, self.anywhere(scene))}
        check_memory(given, task.memory_spec, task.given_together, only)
        self.curriculum.cut_off(self._all() if only is None else only)
        return Start(scene, state, self.curriculum.level.new_full((self.robots, 1), -1), memory)

    def step(
        self,
        given: Mapping[str, Tensor] | TensorDictBase,
        rows: Tensor | None = None,
        table: LatticeSteps | None = None,
    ) -> dict[str, Tensor]:
        """Take a step, and return all its entries: [N, ...] by key.

        Args:
            given: the entries that a step reads, [N, ...] by key.
            rows: [N] int64, the rows that step; None for all.
            table: where steps are looked up that it knows, with the same results; None computes all.
        """
        taken = None if table is None else table.step(given, rows)
        if taken is not None:
            after, poses = taken
            offset, only = given.get("camera_offset", None), rows_to_draw(given, after["done"])
            return {**self.rules.drawn(after["state"], poses, offset, only), **after}
        scene = given["scene"].squeeze(1) if self.rules.scenes > 1 else None
        after = self.rules.stepped(given, scene, self.anywhere(scene, len(given["state"])))
        ends = [after[key].flatten() for key in ("level", "done", "success")]
        if rows is not None:
            ends = [each.new_zeros(self.robots).index_copy(0, rows, each) for each in ends]
        self.curriculum.record(*ends)
        return after

    def restart(
        self, after: Mapping[str, Tensor], rows: Tensor, table: LatticeSteps | None = None
    ) -> dict[str, Tensor]:
        """Return a step's result with new episodes in some rows; see ``SplatEnv.restarted`` and ``step``."""
        begun = None if table is None else table.begin(after, rows, self.generator)
        if begun is None:
            start = self.draw(torch.zeros_like(self._all()).index_fill_(0, rows, True))
            fresh = self.rules.begun(start.of(rows))
        else:
            fresh = self.rules.drawn(begun.values["state"].index_select(0, rows), begun.body_to_world)
        merged = with_rows([after[key] for key in fresh], rows, list(fresh.values()))
        return dict(zip(fresh, merged, strict=True)) | (begun.values if begun else {})

    def anywhere(
        self, scene: Tensor | None = None, count: int | None = None, generator: torch.Generator | None = None
    ) -> Anywhere:
        """Return what draws a state for each of N robots from all of the curriculum's starts, whatever its level.

        Args:
            scene: [N] int64, scene of each robot; None if there is only one.
            count: number of robots, N; None for all.
            generator: draws the states; None for the env's own.
        """
        generator, count = generator or self.generator, self.robots if count is None else count
        return Anywhere(partial(self.curriculum.anywhere, count, generator, scene), generator)

    def _drawn(self, count: int, generator: torch.Generator) -> tuple[Tensor | None, Tensor, dict[str, Tensor]]:
        """Draw N episodes of the current level with a generator: scene, state, and the task's memory."""
        scene = self.curriculum.scenes(count, generator)
        state = self.curriculum.sample(count, generator, scene)
        task, anywhere = self.rules.at(scene)[0], self.anywhere(scene, count, generator)
        state = task.start(state, anywhere)
        return scene, state, {**task.begin(state, anywhere)}

    def _all(self) -> Tensor:
        """Mark every robot, [B] bool."""
        return self.curriculum.level.new_ones(self.robots, dtype=torch.bool)
