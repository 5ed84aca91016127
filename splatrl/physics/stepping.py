"""Physics as a pure function of the state."""

import threading
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from splatrl.extras import require
from splatrl.native.threads import threads_of
from splatrl.physics.optional import needed
from splatrl.physics.state_layout import StateLayout
from splatrl.values import require_number


class Stepped(NamedTuple):
    """The result of stepping B states.

    Attributes:
        state: [B, n] float64, states after the last substep.
        sensed: [B, substeps, s] float64, sensor readings at the beginning of each substep.
        sound: [B] bool, False where the physics failed numerically; the state of such a row is unchanged, and its
            readings are 0.
    """

    state: Tensor
    sensed: Tensor
    sound: Tensor


class Physics:
    """Steps batches of states, each with one of several models of the same structure.

    A state is [n] float64: the index of its model in the bank, and MuJoCo's ``mjSTATE_FULLPHYSICS`` (``layout`` names
    the columns). Solvers are not warm-started from the last step, so a step is a function of the state and
    the controls alone: its result is bitwise the same alone, in a batch, in any order and with any number of threads.

    Args:
        models: an ``MjModel``, or several that differ only in their numbers, such as masses.
        substeps: number of substeps per step, each as long as the model's own time step.
        threads: number of threads that step rows in parallel; None takes all cores.

    Raises:
        ValueError: for no model, models of different sizes, or no substep.
    """

    def __init__(self, models: Any, substeps: int, threads: int | None = None):
        mujoco, rollout = needed(), require("mujoco.rollout", "physics")
        self.models: list[Any] = list(models) if isinstance(models, Sequence) else [models]
        require_number("substeps", substeps, 1, 10_000, whole=True)
        if not self.models:
            raise ValueError("models: expected at least one, got none")
        self._spec = int(mujoco.mjtState.mjSTATE_FULLPHYSICS)
        sizes = {(mujoco.mj_stateSize(model, self._spec), model.nu, model.nsensordata) for model in self.models}
        if len(sizes) > 1:
            raise ValueError(
                f"models: expected the same sizes of state, controls and sensors in all, got {sorted(sizes)}"
            )
        self.layout = StateLayout(int(self.model.nq), int(self.model.nv))
        self.substeps, self.threads = substeps, threads_of(threads)
        for model in self.models:
            model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)  # a failed row must stay failed
        self._rollout = rollout.Rollout(nthread=self.threads if self.threads > 1 else 0)
        self._data = [mujoco.MjData(self.models[0]) for _ in range(self.threads)]
        self._lock = threading.Lock()
        self._once: Physics | None = None

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.models, self.substeps, self.threads)

    def __deepcopy__(self, memo: dict[int, Any]) -> "Physics":
        return self

    @property
    def model(self) -> Any:
        """The first model."""
        return self.models[0]

    @property
    def size(self) -> int:
        """Length of a state, n."""
        return 1 + int(needed().mj_stateSize(self.model, self._spec))

    @property
    def once(self) -> "Physics":
        """The same physics with one substep per step."""
        if self._once is None:
            self._once = Physics(self.models, 1, self.threads)
        return self._once

    def state_of(self, qpos: Any = None, act: Any = None) -> Tensor:
        """Return the first model's state [n] float64 at rest, by default in the default pose without activations."""
        mujoco = needed()
        data = mujoco.MjData(self.model)
        if qpos is not None:
            data.qpos[:] = qpos
        if act is not None:
            data.act[:] = act
        found = np.zeros(self.size)
        mujoco.mj_getState(self.model, data, found[self.layout.mujoco], self._spec)
        return torch.from_numpy(found)

    def step(self, state: Tensor, ctrl: Tensor) -> Stepped:
        """Step states, holding one control over all substeps.

        Args:
            state: [B, n] float64.
            ctrl: [B, nu], the model's controls.

        Raises:
            ValueError: for controls that are not finite.
        """
        device = state.device
        if not len(state):  # MuJoCo's rollout crashes on an empty batch
            return Stepped(state, state.new_zeros(0, self.substeps, self.model.nsensordata), state.new_zeros(0).bool())
        before = np.ascontiguousarray(state.detach().cpu().numpy(), np.float64)
        held = np.ascontiguousarray(ctrl.detach().cpu().numpy(), np.float64)[:, None]
        count = len(before)
        rows = np.clip(np.nan_to_num(before[:, self.layout.model]), 0, len(self.models) - 1).astype(np.int64)
        models = [self.models[row] for row in rows] if len(self.models) > 1 else self.model
        with self._lock:
            states, sensed = self._rollout.rollout(
                models,
                self._data,
                before[:, self.layout.mujoco].copy(),
                np.broadcast_to(held, (count, self.substeps, held.shape[2])).copy(),
                nstep=self.substeps,
                initial_warmstart=np.zeros((count, self.model.nv)),
            )
        after, clock = before.copy(), self.layout.clock
        after[:, self.layout.mujoco] = states[:, -1]
        short = (
            before[:, clock] + (self.substeps - 0.5) * self.model.opt.timestep > after[:, clock]
        )  # stops at warnings
        sound = np.isfinite(after).all(1) & np.isfinite(sensed).all((1, 2)) & ~short
        if not sound.all() and len(wrong := np.flatnonzero(~np.isfinite(held).all((1, 2)))):
            raise ValueError(f"ctrl: expected finite numbers, got {held[wrong[0], 0].tolist()} in row {wrong[0]}")
        after = np.where(sound[:, None], after, before)
        sensed = np.where(sound[:, None, None], sensed, 0.0)
        return Stepped(*(torch.from_numpy(np.ascontiguousarray(one)).to(device) for one in (after, sensed, sound)))

    def sensor(self, name: str) -> slice | None:
        """Return the columns of ``sensed`` that belong to a sensor; None if the model has no such sensor."""
        mujoco = needed()
        number = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_SENSOR, name)
        if number < 0:
            return None
        first = int(self.model.sensor_adr[number])
        return slice(first, first + int(self.model.sensor_dim[number]))
