"""The one environment class: a batch of robots in a single scene, or each in one of several."""

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property, partial
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs import Transform, TransformedEnv

from splatrl.collision.base import Checker
from splatrl.collision.nothing import NoChecker
from splatrl.collision.several import SeveralCheckers, checkers_of
from splatrl.curriculum.starts import Curriculum
from splatrl.device_faults import Faulty
from splatrl.envs.drawing.base import Drawing
from splatrl.envs.lattice_steps import LatticeSteps, suits
from splatrl.envs.lifecycle import Lifecycle
from splatrl.envs.restart import StateWhenAsked, maybe_reset, where_marked, with_rows
from splatrl.envs.robot import Robot
from splatrl.envs.rules import DRAW, Rules
from splatrl.envs.senses import Senses
from splatrl.envs.sensors.base import Sensor
from splatrl.envs.specs import env_specs
from splatrl.envs.stateful_env import StatefulEnv
from splatrl.envs.tasks.base import NOTHING, Task
from splatrl.envs.validation import (
    check_actions,
    check_batch_size,
    check_default_dtype,
    check_kind,
)
from splatrl.values import checked_seed


class SplatEnv(StateWhenAsked):
    """B robots that see, move and collide in splat scenes: a batch-locked TorchRL env.

    The complete state of an episode travels in the TensorDict, so the env itself holds only its random generator and
    the curriculum, both part of ``state_dict()``.

    In a step, the task's motion carries out the actions, the task judges the result once, and the drawing renders what
    the robots then see, earlier if the task judges by it. On a GPU neither a step nor a reset synchronises with the
    host. A reset of some rows draws start states for all rows, of which TorchRL keeps the requested ones; only the
    requested images are rendered, and transforms find in the other rows what the env returned last. Under
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
    Input: ``camera_offset`` [B, 6] float32, if present, moves the camera but not the robot (``Robot.cameras``). A
        step may be given ``_draw`` [B, 1] int64, a ``Draw``, which says whose view is needed; others are blank.
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
        self.scenes = len(checkers_of(checker))
        self.task, self.curriculum, self.sensors = task, curriculum, dict(sensors or {})
        self.curriculum.seat(self.numel())
        self.made_by: Callable[..., SplatEnv] | None = None
        self.generator = torch.Generator(self.device)
        self._last: dict[str, Tensor] = {}  # what the env returned last, shown for robots that a reset leaves alone
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
    def rules(self) -> Rules:
        """What beginnings and steps of episodes consist of."""
        return Rules(self.task, self.checker, self.senses, self._task_keys, self._sensor_keys)

    @property
    def lifecycle(self) -> Lifecycle:
        """The succession of the robots' episodes."""
        return Lifecycle(self.rules, self.curriculum, self.generator, self.batch_size.numel())

    @property
    def capturable(self) -> bool:
        """Whether a step can be captured in a CUDA graph: parts that record errors on the device never synchronise."""
        if self.task.motion.steps_on_host:
            return False
        checkers = checkers_of(self.checker)
        return isinstance(self.drawing.renderer, Faulty) and all(isinstance(c, (Faulty, NoChecker)) for c in checkers)

    def to(self, device: torch.device | str) -> "SplatEnv":
        """Move task and curriculum to a device; renderer and checker stay where they were created.

        On a new device, the env's generator restarts from the same seed.
        """
        super().to(device)
        self.__dict__.pop("lattice_steps", None)
        self._last = {}
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
    @torch.no_grad()
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
        start = self.lifecycle.given(given, only) if set_state else self.lifecycle.draw(only, seeds)
        kept = given if set_state else NOTHING
        begun = self.rules.begun(start, kept, given.get("camera_offset", None), only)
        return self._made(begun if only is None else self._among_last(begun, only))

    def restarted(self, after: Mapping[str, Tensor], rows: Tensor) -> dict[str, Tensor]:
        """Return a step's result, [B, ...] by key, with some rows replaced by new episodes as in a reset.

        Only these rows, [N] int64 and ascending, are drawn. Keys that a reset does not return are left out.
        """
        return self.lifecycle.restart(after, rows, self.lattice_steps)

    @torch.compiler.disable
    @torch.no_grad()
    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        stepping = tensordict.get("_step", None)
        return self._made(self._after(tensordict) if stepping is None else self._some_after(tensordict, stepping))

    def _after(self, given: TensorDictBase | Mapping[str, Tensor], rows: Tensor | None = None) -> dict[str, Tensor]:
        """Carry out a step in some rows, [N] int64 or None for all, and return all its entries: [N, ...] by key."""
        if (action := given.get("action", None)) is not None:
            check_kind(action, self._action)
        try:
            return self.lifecycle.step(given, rows, self.lattice_steps)
        except KeyError as error:
            optional = {"camera_offset", DRAW, *(() if self.scenes > 1 else ("scene",))}
            absent = [key for key in self.rules.reads if key not in {*given.keys(), *optional}]
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
        fresh = self._after({key: held[key].index_select(0, rows) for key in self.rules.reads if key in held}, rows)
        old = {key: value.new_zeros(self.numel(), *value.shape[1:]) for key, value in fresh.items()}
        old |= {key: held[key] for key, zeros in old.items() if key in held and _alike(held[key], zeros)}
        return dict(zip(fresh, with_rows(list(old.values()), rows, list(fresh.values())), strict=True))

    def _among_last(self, begun: dict[str, Tensor], only: Tensor) -> dict[str, Tensor]:
        """Return beginnings of episodes in some rows, [B] bool; other rows repeat the observations returned last.

        TorchRL discards these rows, but only after transforms have read them: statistics would count blank views.
        """
        ends = set(self.done_keys)
        return {
            key: where_marked(only, new, self._last[key]) if key in self._last and key not in ends else new
            for key, new in begun.items()
        }

    def _made(self, values: dict[str, Tensor]) -> TensorDict:
        """Wrap the env's own entries in a TensorDict, skipping its checks of each entry's shape and device."""
        self._last = values
        return TensorDict._new_unsafe(values, batch_size=self.batch_size, device=self.device)

    def _step_proc_data(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        """Return a step's result as it is: it is complete, so TorchRL need not check that."""
        return super()._step_proc_data(next_tensordict) if self.run_type_checks else next_tensordict

    @cached_property
    def lattice_steps(self) -> LatticeSteps | None:
        """Table of all the task's steps, computed before the first one; None where steps cannot be looked up."""
        if self.device.type != "cpu" or self.scenes > 1 or self.sensors or not suits(self.task, self.curriculum):
            return None
        task, checker = self.rules.at(None)
        return LatticeSteps(task, checker, self.curriculum, self.numel(), self.lifecycle.anywhere())

    @property
    def remembered(self) -> list[str]:
        """Memory keys that a new episode must reset: the sensors', and the task's if it chooses its own episodes."""
        return [*self._sensor_keys, *(self._task_keys if self.task.chooses_episodes else ())]

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
