"""One robot as a ``gymnasium.Env``."""

from typing import Any, Literal

import gymnasium
from tensordict import TensorDictBase
from torchrl.envs import EnvBase

from splatrl.envs.gymnasium_conversion import (
    METADATA,
    Action,
    Infos,
    Observation,
    Pixels,
    act,
    begin,
    checked_mode,
    infos_of,
    infos_of_one,
    observed,
    seen_by,
    spaces_of,
    views_of,
)
from splatrl.envs.nesting import raise_faults


class GymnasiumEnv(gymnasium.Env[Observation, Action]):
    """A single robot as a Gymnasium env.

    Observation: [H, W, 3] uint8, the ego view; with ``sensors`` a dictionary that holds it under ``pixels``, and each
        sensor's reading under the sensor's key.
    Action: the task's, ``Discrete``; for continuous control a ``Box`` of float32 in [-1, 1], as Gymnasium's clients
        expect, mapped linearly onto the task's limits: ``drive`` stands still at (-1/3, 0), not at 0.
    Info: every number and vector that env and transforms have beside the observation, by key: ``outcome`` (int, an
        ``Outcome``), ``success`` (bool), ``state`` (the task's state, an array), ``step_count``, ``level`` (int, the
        curriculum's level, from 0, at which the episode began; -1 at a given state), with several scenes ``scene``, and
        what the task remembers, such as ``goal`` and ``distance_to_goal``. ``is_success`` equals ``success``, and
        navigation tasks add ``spl`` and ``soft_spl`` (``path_measures``).
    Reset: ``reset(seed=...)`` seeds the starts. ``reset(options=info)`` begins at the state, in the scene and with the
        memory of an info; the counters begin at zero. ``options`` may also be a part of an info: ``state`` must be in
        it, with several scenes also ``scene``, and what the task remembers is drawn anew where it is left out.
    Curriculum: begins at its easiest level in every new env, so make one for evaluation with ``curriculum=none``.

    Example:
        >>> import splatrl
        >>> env = GymnasiumEnv(splatrl.make_env(batch_size=[1]))
        >>> observation, info = env.reset(seed=0)

    Args:
        env: a ``SplatEnv``, bare or under transforms, of batch size [1].
        render_mode: ``"rgb_array"`` makes ``render`` return the current view; None disables it.

    Raises:
        ValueError: for any other batch size or render mode, or an action that is neither discrete nor bounded.
    """

    metadata = METADATA

    def __init__(self, env: EnvBase, render_mode: Literal["rgb_array"] | None = "rgb_array"):
        if env.batch_size != (1,):
            raise ValueError(f"env: expected batch size [1], got {list(env.batch_size)}")
        self.env, self.render_mode = env, checked_mode(render_mode)
        self.observation_space, self.action_space = spaces_of(env)
        self._present: TensorDictBase | None = None
        self._over = False  # whether the episode has ended

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Observation, Infos]:
        """Begin an episode and return its first observation and info."""
        super().reset(seed=seed)
        self._present, self._over = begin(self.env, seed, options, None if seed is None else [seed]), False
        return seen_by(observed(self.env, self._present), 0), infos_of_one(infos_of(self.env, self._present))

    def step(self, action: Action) -> tuple[Observation, float, bool, bool, Infos]:
        """Take one action."""
        if self._present is None or self._over:
            raise gymnasium.error.ResetNeeded("step: expected a call to reset() first")
        step = self.env.step(act(self.env, self._present, self.action_space, action))
        raise_faults(self.env)  # waits for nothing more: Gymnasium's arrays synchronise anyway
        after = step["next"]
        self._present = self.env.step_mdp(step)
        terminated, truncated = bool(after["terminated"]), bool(after["truncated"])
        self._over = terminated or truncated
        seen = seen_by(observed(self.env, after), 0)
        return seen, after["reward"].item(), terminated, truncated, infos_of_one(infos_of(self.env, after))

    def render(self) -> Pixels | None:
        """Return the current view, [H, W, 3] uint8; None without a render mode."""
        if self.render_mode is None:
            return None
        if self._present is None:
            raise gymnasium.error.ResetNeeded("render: expected a call to reset() first")
        return views_of(self._present)[0]
