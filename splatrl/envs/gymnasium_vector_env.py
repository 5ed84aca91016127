"""A batch of robots as a ``gymnasium.vector.VectorEnv``."""

from collections.abc import Sequence
from typing import Any, Literal

import gymnasium
import numpy as np
import numpy.typing as npt
import torch
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from tensordict import TensorDictBase
from torchrl.envs import EnvBase

from splatrl.envs.gymnasium_conversion import (
    METADATA,
    Actions,
    Infos,
    Observation,
    Pixels,
    act,
    begin,
    checked_mode,
    column,
    infos_of,
    masked,
    observed,
    seen_by,
    spaces_of,
    views_of,
)
from splatrl.envs.nesting import raise_faults
from splatrl.values import checked_seed


class GymnasiumVectorEnv(VectorEnv[Observation, Actions, npt.NDArray[Any]]):
    """A batch of robots as a Gymnasium vector env.

    Depending on ``autoreset_mode``, a robot whose episode ends begins the next one in the same step; in the following
    step, in which its action is ignored and its reward is 0; or when the client resets it.

    Observation: [B, H, W, 3] uint8; with ``sensors`` a dictionary, see ``GymnasiumEnv``.
    Action: [B] int64, or [B, n] float32 in [-1, 1] for continuous control; see ``GymnasiumEnv``.
    Info: that of ``GymnasiumEnv`` for each robot, [B, ...] by key; it belongs to the observation. With same-step
        resets, ``final_obs`` and ``final_info`` hold the last observation and info of robots whose episode ended. Each
        entry has a mask, [B] bool, under ``_<name>``.
    Reset: a single seed is used for the whole batch. With a list of seeds, each robot's start depends only on its own
        seed, and everything drawn later depends on all of them; robots with None draw from the env's generator as
        before. ``options={"reset_mask": ...}``, [B] bool, restarts only some of the robots; other options are those
        of ``GymnasiumEnv`` with a row for each robot.
    Curriculum: see ``GymnasiumEnv``.

    Args:
        env: a ``SplatEnv``, bare or under transforms.
        autoreset_mode: ``SAME_STEP``; ``NEXT_STEP``, which some of Gymnasium's wrappers require; or ``DISABLED``.
        render_mode: ``"rgb_array"`` makes ``render`` return the current views; None disables it.

    Raises:
        ValueError: for an env whose batch size is not [B], an action that is neither discrete nor bounded, any other
            mode, or a list of seeds of another length.
    """

    def __init__(
        self,
        env: EnvBase,
        autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
        render_mode: Literal["rgb_array"] | None = "rgb_array",
    ):
        if env.ndim != 1:
            raise ValueError(f"env: expected batch size [B], got {list(env.batch_size)}")
        modes = {mode.value: mode for mode in AutoresetMode}
        named = getattr(autoreset_mode, "value", autoreset_mode)
        if named not in modes:
            raise ValueError(f"autoreset_mode: expected one of {', '.join(modes)}, got {named}")
        self.autoreset_mode = modes[named]
        self.metadata = {**METADATA, "autoreset_mode": self.autoreset_mode}
        self.env, self.num_envs, self.render_mode = env, env.numel(), checked_mode(render_mode)
        self.single_observation_space, self.single_action_space = spaces_of(env)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._present: TensorDictBase | None = None
        self._over = np.zeros(self.num_envs, dtype=bool)  # robots whose episode ended, to be reset in the next step

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, Infos]:
        """Restart all episodes, or only those that ``options={"reset_mask": [B] bool}`` selects."""
        chosen = self._chosen(options)
        several = isinstance(seed, (Sequence, np.ndarray))
        seeds = [None if one is None else checked_seed(one) for one in seed] if several else None  # type: ignore[union-attr]
        if seeds is not None and len(seeds) != self.num_envs:
            raise ValueError(f"seed: expected one number, or a list of {self.num_envs}, got {seeds}")
        together = seed if seeds is None else _together(seeds)
        super().reset(seed=together)  # type: ignore[arg-type]
        if chosen is None:
            self._present = begin(self.env, together, options, seeds)  # type: ignore[arg-type]
        else:
            if together is not None:
                self.env.set_seed(int(together))  # type: ignore[arg-type]
            self._present = self._restarted(self._present, chosen, {} if seeds is None else {"seeds": seeds})
        self._over[... if chosen is None else chosen] = False
        return observed(self.env, self._present), self._told(chosen)

    def _chosen(self, options: dict[str, Any] | None) -> npt.NDArray[np.bool_] | None:
        """Return the robots that a reset is to restart, [B] bool; None for all."""
        if not options or "reset_mask" not in options:
            return None
        if self._present is None:
            raise gymnasium.error.ResetNeeded("reset: expected a call without reset_mask first")
        mask = np.asarray(options["reset_mask"])
        if len(options) > 1 or (mask.dtype, mask.shape) != (bool, (self.num_envs,)) or not mask.any():
            wanted = f"'reset_mask' alone, [{self.num_envs}] bool with at least one True"
            raise ValueError(f"options: expected {wanted}, got {options!r:.120}")
        return mask

    def _restarted(
        self, present: TensorDictBase | None, rows: npt.NDArray[np.bool_], settings: dict[str, Any]
    ) -> TensorDictBase:
        """Return the batch with new episodes for some robots, [B] bool; ``settings`` are further ones of the reset."""
        assert present is not None
        mask = torch.as_tensor(rows, device=self.env.device).unsqueeze(1)
        return self.env.reset(present.set("_reset", mask), select_reset_only=True, **settings)

    def step(
        self, actions: Actions
    ) -> tuple[Observation, npt.NDArray[np.float64], npt.NDArray[np.bool_], npt.NDArray[np.bool_], Infos]:
        """Take one action per robot.

        Args:
            actions: [B] int64, or [B, n] float32; see the class.

        Returns:
            Observation; reward [B] float64; terminated and truncated, [B] bool each; info.
        """
        if self._present is None:
            raise gymnasium.error.ResetNeeded("step: expected a call to reset() first")
        if self._over.any() and self.autoreset_mode == AutoresetMode.DISABLED:
            raise gymnasium.error.ResetNeeded("step: expected a reset of the robots whose episode has ended first")
        acted = act(self.env, self._present, self.action_space, actions)
        return (self._step_over if self._over.any() else self._step)(acted)

    def _step(self, acted: TensorDictBase) -> tuple[Any, ...]:
        """Take a step in which all robots act."""
        same = self.autoreset_mode == AutoresetMode.SAME_STEP
        step, self._present = self.env.step_and_maybe_reset(acted) if same else self._stepped(acted)
        raise_faults(self.env)  # waits for nothing more: Gymnasium's arrays synchronise anyway
        after = step["next"]
        infos, ended = self._told(), column(after, "done")
        if same and ended.any():
            last, rows = np.full(self.num_envs, None, dtype=object), ended.nonzero()[0]
            seen = observed(self.env, after, torch.as_tensor(rows, device=self.env.device))
            for number, row in enumerate(rows.tolist()):
                last[row] = seen_by(seen, number)
            infos |= masked({"final_obs": last, "final_info": masked(infos_of(self.env, after), ended)}, ended)
        if not same:
            self._over = ended
        reward = column(after, "reward").astype(np.float64)
        seen = observed(self.env, self._present)
        return seen, reward, column(after, "terminated"), column(after, "truncated"), infos

    def _step_over(self, acted: TensorDictBase) -> tuple[Any, ...]:
        """Take a step in which some robots begin an episode and the others act."""
        over, mask = self._over, torch.as_tensor(self._over, device=self.env.device).unsqueeze(1)
        acted["level"] = torch.where(mask, -1, acted["level"])  # the curriculum counts an ended episode only once
        step, present = self._stepped(acted)
        raise_faults(self.env)
        self._present = self._restarted(present, over, {})
        after = step["next"]
        terminated, truncated = (column(after, key) & ~over for key in ("terminated", "truncated"))
        self._over = terminated | truncated
        reward = np.where(over, 0.0, column(after, "reward").astype(np.float64))
        return observed(self.env, self._present), reward, terminated, truncated, self._told()

    def _stepped(self, acted: TensorDictBase) -> tuple[TensorDictBase, TensorDictBase]:
        step = self.env.step(acted)
        return step, self.env.step_mdp(step)

    def _told(self, rows: npt.NDArray[np.bool_] | None = None) -> Infos:
        """Return the infos that belong to the current observation, of all robots or of some, [B] bool."""
        assert self._present is not None
        return masked(infos_of(self.env, self._present), np.ones(self.num_envs, dtype=bool) if rows is None else rows)

    def render(self) -> tuple[Pixels, ...] | None:
        """Return the current views, [H, W, 3] uint8 each; None without a render mode."""
        if self.render_mode is None:
            return None
        if self._present is None:
            raise gymnasium.error.ResetNeeded("render: expected a call to reset() first")
        return tuple(views_of(self._present))


def _together(seeds: list[int | None]) -> int | None:
    """Derive a seed for the batch from the seeds of all robots; None if any robot has none."""
    known = [seed for seed in seeds if seed is not None]
    return int(np.random.SeedSequence(known).generate_state(1)[0]) if len(known) == len(seeds) else None
