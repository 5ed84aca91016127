"""The one environment class: a batch of robots in a single scene, or each in one of several.

The file is long because reset, step and state form a single contract, which the class documents.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property, partial
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs import Transform, TransformedEnv

from splatrl.collision.base import Checker
from splatrl.collision.nothing import NoChecker
from splatrl.collision.several import SeveralCheckers
from splatrl.curriculum.starts import Curriculum
from splatrl.envs.drawing.base import Drawing
from splatrl.envs.given import (
    check_actions,
    check_batch_size,
    check_default_dtype,
    check_kind,
    check_memory,
    check_seeds,
    given_scene,
    given_state,
)
from splatrl.envs.lattice_steps import LatticeSteps, Taken, suits
from splatrl.envs.restart import StateWhenAsked, maybe_reset, with_rows
from splatrl.envs.robot import Robot
from splatrl.envs.senses import Senses, Standing
from splatrl.envs.sensors.base import Sensor
from splatrl.envs.specs import env_specs
from splatrl.envs.stateful_env import StatefulEnv
from splatrl.envs.tasks.base import NOTHING, Anywhere, Outcome, Step, Task
from splatrl.faults import Faulty
from splatrl.values import checked_seed


class SplatEnv(StateWhenAsked):
    """B robots that see, move and collide in splat scenes: a batch-locked TorchRL env.

    The complete state of an episode travels in the TensorDict, so the env itself holds only its random generator and
    the curriculum, both part of ``state_dict()``.

    In a step, the task's motion carries out the actions, the drawing renders what the robots then see, and the task
    judges the result once. On a GPU neither a step nor a reset synchronises with the host. A reset of some rows draws
    start states for all rows, of which TorchRL keeps the requested ones; only the requested images are rendered. Under
    ``torch.compile``, step and reset run eagerly, between the graphs of the surrounding code.

    With several scenes, each episode takes place in one of them, drawn when it begins: ``scene`` [B, 1] int64, which
    travels in the TensorDict and must accompany a given ``state``. Checker and task select the values of each row's
    scene (``at``), and the renderer's models are the scenes, in the same order.

    Observation: ``pixels`` [B, H, W, 3] uint8, and whatever else drawing and ``sensors`` return. For users rather than
        the policy: ``state`` (the motion's), ``step_count`` [B, 1] int64, ``episode_return`` [B, 1] float32, ``level``
        [B, 1] int64 (curriculum level at which the episode began), ``outcome`` [B, 1] int64 (an ``Outcome``), ``goals``
        [B, 1] int64 (number reached in the episode so far), ``success`` [B, 1] bool (whether they are enough for the
        task), ``free_fraction`` [B, 1] float32 (fraction of the last move that was free; 1 when nothing was touched),
        and what task and sensors remember, such as ``target`` [B, 3] float32, position of the task's object, world,
        metres.
    Action: the motion's.
    Reward: [B, 1] float32, the task's.
    Termination: the task's.
    Truncation: after ``task.max_steps`` steps; never together with termination.
    Reset: start states come from the curriculum, or, with ``reset(td, set_state=True)``, from ``td["state"]``, together
        with any memory that ``td`` holds. ``reset(seeds=[...])`` takes a number or None for each robot; robots with a
        number draw their start, and whatever else their episode begins with, from a generator of their own.
    Partial steps: with ``_step`` [B, 1] bool, as TorchRL passes it, only the marked robots step and are drawn. For the
        others the result repeats their inputs, and is 0 where there is no input.
    Input: ``camera_offset`` [B, 6] float32, if present, moves the camera but not the robot (``Robot.cameras``).
    Parts: may be replaced only before the first step, since steps on a lattice may be precomputed at that point
        (``lattice_steps``).
    Pickling: a pickle holds the env's state and its parts, or, instead of the parts, ``made_by`` if it is set: a
        function that makes the env from a curriculum, a seed and a device (``World``).

    Args:
        drawing: draws the pixels.
        checker: holds the robot's body and finds what it touches; a ``SeveralCheckers`` makes an env of several scenes.
        robot: body and camera.
        task: motion, goals and rewards; for several scenes a ``stacked`` one.
        curriculum: decides where episodes begin.
        batch_size: [B], the number of robots.
        seed: seed of the env's generator.
        device: device of every tensor that the env takes and returns.
        sensors: sensors other than the camera, by key.

    Raises:
        ValueError: for a batch size that is not one positive number, a task whose memory uses the env's keys, a given
            state outside the motion's spec, or another default dtype of PyTorch than float32.
    """

    batch_locked = True
    _supports_set_state = True

    def __init__(
        self,
        drawing: Drawing,
        checker: Checker | SeveralCheckers,
        robot: Robot,
        task: Task,
        curriculum: Curriculum,
        batch_size: Sequence[int],
        seed: int | None = 0,
        device: torch.device | str = "cpu",
        sensors: Mapping[str, Sensor] | None = None,
    ):
        check_default_dtype()
        check_batch_size(batch_size)
        super().__init__(device=device, batch_size=torch.Size(batch_size))
        self.drawing, self.checker, self.robot = drawing, checker, robot
        self.scenes = len(checker.checkers) if isinstance(checker, SeveralCheckers) else 1
        self.task, self.curriculum, self.sensors = task, curriculum, dict(sensors or {})
        self.curriculum.seat(self.numel())
        self.made_by: Callable[..., SplatEnv] | None = None
        self.generator = torch.Generator(self.device)
        self._action = task.motion.action_spec  # of one robot
        self._task_keys, self._sensor_keys = tuple(task.memory_spec), tuple(self.senses.memory_spec())
        specs = env_specs(task, self.senses, self.scenes, self.batch_size, self.device)
        self.observation_spec, self.state_spec, self.action_spec, self.reward_spec, self.done_spec = specs
        # moved only now: the specs read the task's limits, which on a GPU would synchronise
        self.task = task.to(self.device)
        torch.nn.Module.to(self, self.device)  # EnvBase.to does nothing if the device is unchanged
        self.set_seed(seed)

    @property
    def senses(self) -> Senses:
        """Camera and sensors of the robots."""
        return Senses(self.drawing, self.robot, self.sensors)

    @property
    def capturable(self) -> bool:
        """Whether a step can be captured in a CUDA graph: parts that record errors on the device never synchronise."""
        checkers = self.checker.checkers if isinstance(self.checker, SeveralCheckers) else [self.checker]
        if self.task.motion.steps_on_host:
            return False
        return isinstance(self.drawing.renderer, Faulty) and all(isinstance(c, (Faulty, NoChecker)) for c in checkers)

    def to(self, device: torch.device | str) -> "SplatEnv":
        """Move task and curriculum to a device; renderer and checker stay where they were created.

        On a new device, the env's generator restarts from the same seed.
        """
        super().to(device)
        self.__dict__.pop("lattice_steps", None)
        self.task = self.task.to(self.device)
        if self.generator.device != self.device:
            self.generator = torch.Generator(self.device).manual_seed(self.generator.initial_seed())
        return self

    def append_transform(self, transform: Transform | Callable[[TensorDictBase], TensorDictBase]) -> TransformedEnv:
        """Return the env under a transform, keeping the state of both; see ``StatefulEnv``."""
        return StatefulEnv(self).append_transform(transform)

    def raise_faults(self) -> None:
        """Wait for the device, and raise the errors of renderer and checker since the last call; see ``Faulty``."""
        for part in (self.drawing.renderer, self.checker):
            if isinstance(part, Faulty):
                part.raise_faults()

    def maybe_reset(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Reset robots whose episode has ended; see ``EnvBase.maybe_reset``."""
        return maybe_reset(self, tensordict)

    @torch.compiler.disable
    def _reset(
        self,
        tensordict: TensorDictBase | None = None,
        *,
        set_state: bool = False,
        seeds: Sequence[int | None] | None = None,
        **_: Any,
    ) -> TensorDictBase:
        check_default_dtype()
        given = TensorDict(batch_size=self.batch_size) if tensordict is None else tensordict
        mask = given.get("_reset", None)
        only = None if mask is None else mask.flatten()
        begun = torch.ones(self.numel(), dtype=torch.bool, device=self.device) if only is None else only
        if set_state:
            scene = None if self.scenes == 1 else given_scene(given, self.scenes, only)
            state = given_state(given, self.task.motion.state_spec, only)
            level = torch.full((self.numel(), 1), -1, device=self.device)  # given states belong to no level
            memory = {**self._at(scene)[0].begin(state, self._chance(scene))}
            check_memory(given, self.task.memory_spec, self.task.given_together, only)
            self.curriculum.cut_off(begun)
        else:
            scene, state, memory = self._drawn(seeds)
            self.curriculum.begin(begun)
            level = self.curriculum.level.expand(self.numel(), 1).clone()
        kept = given if set_state else {}
        return self._made(self._beginning(scene, state, level, memory, kept, given.get("camera_offset", None), only))

    def restarted(self, after: Mapping[str, Tensor], rows: Tensor) -> dict[str, Tensor]:
        """Return a step's result, [B, ...] by key, with some rows replaced by new episodes as in a reset.

        Only these rows, [N] int64 and ascending, are drawn. Keys that a reset does not return are left out.
        """
        looked_up = None if self.lattice_steps is None else self.lattice_steps.begin(after, rows, self.generator)
        if looked_up is None:
            begun = self._begun(rows)
        else:
            state = looked_up.values["state"].index_select(0, rows)
            view = self.senses.view(self._standing(state, looked_up.body_to_world))
            begun = {"pixels": view.pixels, **view.shown}
        merged = with_rows([after[key] for key in begun], rows, list(begun.values()))
        return dict(zip(begun, merged, strict=True)) | (looked_up.values if looked_up else {})

    def _begun(self, rows: Tensor) -> dict[str, Tensor]:
        """Return the entries of episodes that begin in some rows, [N] int64: [N, ...] each."""
        scene, state, memory = self._drawn(None)
        self.curriculum.begin(
            torch.zeros(self.numel(), dtype=torch.bool, device=self.device).index_fill_(0, rows, True)
        )
        level = self.curriculum.level.expand(len(rows), 1).clone()
        scene = None if scene is None else scene.index_select(0, rows)
        memory = {key: value.index_select(0, rows) for key, value in memory.items()}
        return self._beginning(scene, state.index_select(0, rows), level, memory, {}, None, None)

    def _drawn(self, seeds: Sequence[int | None] | None) -> tuple[Tensor | None, Tensor, dict[str, Tensor]]:
        """Draw a new episode for each robot: scene, state, and the task's memory; see the class for ``seeds``."""
        if seeds is not None:
            check_seeds(seeds, self.numel())
        scene, state, memory = self._episodes(self.numel(), self.generator)
        for row, seed in enumerate(seeds or ()):
            if seed is not None:
                its_scene, its_state, its_memory = self._episodes(1, torch.Generator(self.device).manual_seed(seed))
                state[row] = its_state[0]
                if scene is not None and its_scene is not None:
                    scene[row] = its_scene[0]
                for key, value in memory.items():
                    value[row] = its_memory[key][0]
        return scene, state, memory

    def _episodes(self, count: int, generator: torch.Generator) -> tuple[Tensor | None, Tensor, dict[str, Tensor]]:
        """Draw N episodes of the current level with a generator: scene, state, and the task's memory."""
        scene = self.curriculum.scenes(count, generator)
        state = self.curriculum.sample(count, generator, scene)
        task, anywhere = self._at(scene)[0], self._chance(scene, count, generator)
        state = task.start(state, anywhere)
        return scene, state, {**task.begin(state, anywhere)}

    def _beginning(
        self,
        scene: Tensor | None,
        state: Tensor,
        level: Tensor,
        memory: dict[str, Tensor],
        kept: Mapping[str, Tensor] | TensorDictBase,
        camera_offset: Tensor | None,
        only: Tensor | None,
    ) -> dict[str, Tensor]:
        """Return the entries of N episodes that begin.

        Args:
            scene: [N] int64, scene of each episode; None if there is only one.
            state: [N, ...], start states.
            level: [N, 1] int64, curriculum levels.
            memory: the task's memory, [N, ...] by key.
            kept: given memory of task and sensors; where a key is present, it replaces the fresh value.
            camera_offset: see the class.
            only: [N] bool, the rows that are requested; None requests all. Other rows may hold anything.
        """
        task, checker = self._at(scene)
        memory |= {key: kept[key].clone() for key in memory if kept.get(key, None) is not None}
        robots = Standing(task, checker, scene, state, task.motion.body_to_world(state), memory)
        view, free_fraction = self.senses.view(robots, camera_offset, only), torch.ones(len(state), device=self.device)
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
            "goals": count.clone(),
            "success": flag,
            "free_fraction": free_fraction.unsqueeze(1),
            **{key: flag.clone() for key in ("done", "terminated", "truncated")},
        }

    def _at(self, scene: Tensor | None) -> tuple[Task, Checker]:
        """Return task and checker for rows in some scenes, [B] int64; None stands for the only scene."""
        if scene is None:
            assert not isinstance(self.checker, SeveralCheckers)
            return self.task, self.checker
        assert isinstance(self.checker, SeveralCheckers)
        return self.task.at(scene), self.checker.at(scene)

    @torch.compiler.disable
    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        stepping = tensordict.get("_step", None)
        return self._made(self._after(tensordict) if stepping is None else self._some_after(tensordict, stepping))

    def _after(self, given: TensorDictBase | Mapping[str, Tensor], rows: Tensor | None = None) -> dict[str, Tensor]:
        """Carry out a step in some rows, [N] int64 or None for all, and return all its entries: [N, ...] by key."""
        if (action := given.get("action", None)) is not None:
            check_kind(action, self._action)
        try:
            taken = None if self.lattice_steps is None else self.lattice_steps.step(given, rows)
            return self._stepped(given, rows) if taken is None else self._shown(taken, given)
        except KeyError as error:
            optional = {"camera_offset"} if self.scenes > 1 else {"camera_offset", "scene"}
            absent = [key for key in self._reads if key not in {*given.keys(), *optional}]
            if not absent:
                raise
            raise ValueError(
                f"step: expected {', '.join(absent)} in its TensorDict, in which episodes travel, got none; transforms "
                "such as ExcludeTransform must leave what a step reads"
            ) from error
        except (IndexError, ValueError):
            check_actions(given["action"], self.action_spec)
            raise

    def _some_after(self, given: TensorDictBase, stepping: Tensor) -> dict[str, Tensor]:
        """Do the same for some robots only, [B, 1] bool; the others keep their inputs, or 0 where there is none."""
        rows = stepping.flatten().nonzero().squeeze(1)
        held = {key: value for key, value in given.items() if isinstance(value, Tensor)}
        fresh = self._after({key: held[key].index_select(0, rows) for key in self._reads if key in held}, rows)
        old = {key: value.new_zeros(self.numel(), *value.shape[1:]) for key, value in fresh.items()}
        old |= {key: held[key] for key, zeros in old.items() if key in held and _alike(held[key], zeros)}
        return dict(zip(fresh, with_rows(list(old.values()), rows, list(fresh.values())), strict=True))

    @property
    def _reads(self) -> tuple[str, ...]:
        """Keys that a step reads; some of them may be absent."""
        counted = ("step_count", "episode_return", "level", "goals")
        return ("state", "action", *counted, "scene", "camera_offset", *self._task_keys, *self._sensor_keys)

    def _made(self, values: dict[str, Tensor]) -> TensorDict:
        """Wrap the env's own entries in a TensorDict, skipping its checks of each entry's shape and device."""
        return TensorDict._new_unsafe(values, batch_size=self.batch_size, device=self.device)

    def _step_proc_data(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        """Return a step's result as it is: it is complete, so TorchRL need not check that."""
        return super()._step_proc_data(next_tensordict) if self.run_type_checks else next_tensordict

    @cached_property
    def lattice_steps(self) -> LatticeSteps | None:
        """Table of all the task's steps, computed before the first one; None where steps cannot be looked up."""
        if self.device.type != "cpu" or self.scenes > 1 or self.sensors or not suits(self.task, self.curriculum):
            return None
        task, checker = self._at(None)
        return LatticeSteps(task, checker, self.curriculum, self.numel(), self._chance(None))

    def _shown(self, taken: Taken, given: TensorDictBase | Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Return the entries of steps that were looked up, with the views drawn."""
        after, poses = taken
        view = self.senses.view(self._standing(after["state"], poses), given.get("camera_offset", None))
        return {"pixels": view.pixels, **view.shown, **after}

    def _stepped(
        self, tensordict: TensorDictBase | Mapping[str, Tensor], rows: Tensor | None = None
    ) -> dict[str, Tensor]:
        """Carry out and judge steps with motion and task, and return all entries; see ``_after``."""
        before, action = tensordict["state"], tensordict["action"]
        scene = tensordict["scene"].squeeze(1) if self.scenes > 1 else None
        task, checker = self._at(scene)
        memory = {key: tensordict[key] for key in self._task_keys}
        move = task.motion.move(before, action, checker)
        robots = Standing(task, checker, scene, move.state, move.body_to_world, memory)
        view = self.senses.view(robots, tensordict.get("camera_offset", None))
        reward, terminated, outcome, remembered = task.judge(
            Step(before, action, move, memory, view.pixels, view.shown), self._chance(scene, len(before))
        )
        kept = {key: tensordict[key] for key in self._sensor_keys}
        known = {**memory, **remembered, **kept}
        step_count = tensordict["step_count"] + 1
        truncated = (step_count >= task.max_steps) & ~terminated
        goals = tensordict["goals"] + (outcome == Outcome.GOAL)
        success = goals >= (task.goals_for_success or 1)
        outcome = torch.where(truncated, Outcome.TIMEOUT, outcome)
        level, done = tensordict["level"], terminated | truncated
        self._record([level.flatten(), done.flatten(), success.flatten()], rows)
        return {
            "pixels": view.pixels,
            **view.shown,
            "state": move.state,
            **{key: value.clone() for key, value in (kept | {**remembered}).items()},
            **self.senses.read(robots, view, move.free_fraction, known, move.sensed),
            **({} if scene is None else {"scene": tensordict["scene"].clone()}),
            "step_count": step_count,
            "episode_return": tensordict["episode_return"] + reward,
            "level": level.clone(),
            "outcome": outcome,
            "goals": goals,
            "success": success,
            "free_fraction": move.free_fraction.unsqueeze(1),
            "reward": reward,
            "done": done,
            "terminated": terminated,
            "truncated": truncated,
        }

    def _record(self, ends: list[Tensor], rows: Tensor | None) -> None:
        """Let the curriculum record level, end and success of robots in some rows, [N] each; see ``_after``."""
        if rows is not None:
            ends = [each.new_zeros(self.numel()).index_copy(0, rows, each) for each in ends]
        self.curriculum.record(*ends)

    def _standing(self, state: Tensor, body_to_world: Tensor) -> Standing:
        """Place robots in the only scene, for a task that remembers nothing."""
        task, checker = self._at(None)
        return Standing(task, checker, None, state, body_to_world, NOTHING)

    @property
    def remembered(self) -> list[str]:
        """Memory keys that a new episode must reset: the sensors', and the task's if it chooses its own episodes."""
        return [*self._sensor_keys, *(self._task_keys if self.task.chooses_episodes else ())]

    def _chance(
        self, scene: Tensor | None, count: int | None = None, generator: torch.Generator | None = None
    ) -> Anywhere:
        generator = generator or self.generator
        return Anywhere(partial(self.anywhere, scene, count, generator), generator)

    def anywhere(
        self, scene: Tensor | None = None, count: int | None = None, generator: torch.Generator | None = None
    ) -> Tensor:
        """Draw a state for each of N robots from all of the curriculum's starts in its scene, regardless of the level.

        Args:
            scene: [N] int64, scene of each robot; None if there is only one.
            count: number of robots, N; None for all.
            generator: draws the states; None for the env's own.

        Returns:
            [N, ...].
        """
        return self.curriculum.anywhere(self.numel() if count is None else count, generator or self.generator, scene)

    def set_seed(self, seed: int | None = None, static_seed: bool = False) -> int | None:
        """Seed the env's generator; see ``EnvBase.set_seed``. None draws a seed, and others are refused by name."""
        return super().set_seed(None if seed is None else checked_seed(seed), static_seed)

    def _set_seed(self, seed: int | None) -> None:
        if seed is None:
            self.generator.seed()
        else:
            self.generator.manual_seed(seed)

    def __reduce__(self) -> tuple[Any, ...]:
        parts = (self.drawing, self.checker, self.robot, self.task, self.curriculum, tuple(self.batch_size))
        if self.made_by is None:
            make = partial(type(self), sensors=self.sensors)
            return _restored, (make, parts, self.device, self.get_extra_state())
        return _restored, (self.made_by, (self.curriculum,), self.device, self.get_extra_state())

    def get_extra_state(self) -> Tensor:
        """Return the state of the random generator, for ``state_dict()``: [n] uint8."""
        return self.generator.get_state()

    def set_extra_state(self, state: Tensor) -> None:
        """Restore the random generator, from ``load_state_dict()``."""
        self.generator.set_state(state.cpu())


def _alike(one: Tensor, other: Tensor) -> bool:
    return one.dtype == other.dtype and one.shape == other.shape


def _restored(make: Callable[..., SplatEnv], parts: tuple[Any, ...], device: torch.device, state: Tensor) -> SplatEnv:
    """Rebuild an env from its parts on a device, and restore its generator's state."""
    env = make(*parts, 0, device)
    env.set_extra_state(state)
    return env
