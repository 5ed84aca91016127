"""Gymnasium wrappers: one robot as a ``gymnasium.Env``, a batch as a ``gymnasium.vector.VectorEnv``.

Both are here, although that makes the file long, because they convert spaces, actions and observations alike.
"""

from collections.abc import Sequence
from typing import Any, Literal

import gymnasium
import numpy as np
import numpy.typing as npt
import torch
from gymnasium.spaces import Box, Dict, Discrete, MultiBinary
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Bounded, Categorical, TensorSpec
from torchrl.envs import EnvBase

from splatrl.envs.nesting import check_layers, layers
from splatrl.faults import Faulty
from splatrl.values import checked_seed

Pixels = npt.NDArray[np.uint8]
Observation = Pixels | dict[str, npt.NDArray[Any]]
Action = np.int64 | npt.NDArray[np.float32]
Actions = npt.NDArray[np.int64] | npt.NDArray[np.float32]
Infos = dict[str, Any]

_METADATA: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 10}


class GymnasiumEnv(gymnasium.Env[Observation, Action]):
    """A single robot as a Gymnasium env.

    Observation: [H, W, 3] uint8, the ego view; with ``sensors`` a dictionary that holds it under ``pixels``, and each
        sensor's reading under the sensor's key.
    Action: the task's, ``Discrete``; for continuous control a ``Box`` of float32 in [-1, 1], as Gymnasium's clients
        expect, mapped linearly onto the task's limits: ``drive`` stands still at (-1/3, 0), not at 0.
    Info: ``outcome`` (int, an ``Outcome``), ``goals`` (int, number reached so far), ``success`` (bool), ``state`` (the
        task's state, an array), ``level`` (int, the curriculum's level, from 0, at which the episode began; -1 at a
        given state) and, with several scenes, ``scene`` (int, the scene in which the episode takes place).
    Reset: ``reset(seed=...)`` seeds the starts, ``reset(options={"state": ...})`` begins at the given task state; with
        several scenes ``options`` must hold its ``scene``, too.
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

    metadata = _METADATA

    def __init__(self, env: EnvBase, render_mode: Literal["rgb_array"] | None = "rgb_array"):
        if env.batch_size != (1,):
            raise ValueError(f"env: expected batch size [1], got {list(env.batch_size)}")
        self.env, self.render_mode = env, _checked_mode(render_mode)
        self.observation_space, self.action_space = _spaces(env)
        self._present: TensorDictBase | None = None
        self._over = False  # whether the episode has ended

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Observation, Infos]:
        """Begin an episode and return its first observation and info."""
        super().reset(seed=seed)
        self._present, self._over = _begin(self.env, seed, options, None if seed is None else [seed]), False
        return _seen_by(_observed(self.env, self._present), 0), _one(_infos(self._present))

    def step(self, action: Action) -> tuple[Observation, float, bool, bool, Infos]:
        """Take one action."""
        if self._present is None or self._over:
            raise gymnasium.error.ResetNeeded("step: expected a call to reset() first")
        step = self.env.step(_act(self.env, self._present, self.action_space, action))
        _raise_faults(self.env)
        after = step["next"]
        self._present = self.env.step_mdp(step)
        terminated, truncated = bool(after["terminated"]), bool(after["truncated"])
        self._over = terminated or truncated
        seen = _seen_by(_observed(self.env, after), 0)
        return seen, after["reward"].item(), terminated, truncated, _one(_infos(after))

    def render(self) -> Pixels | None:
        """Return the current view, [H, W, 3] uint8; None without a render mode."""
        if self.render_mode is None:
            return None
        if self._present is None:
            raise gymnasium.error.ResetNeeded("render: expected a call to reset() first")
        return _views(self._present)[0]


class GymnasiumVectorEnv(VectorEnv[Observation, Actions, npt.NDArray[Any]]):
    """A batch of robots as a Gymnasium vector env.

    Depending on ``autoreset_mode``, a robot whose episode ends begins the next one in the same step; in the following
    step, in which its action is ignored and its reward is 0; or when the client resets it.

    Observation: [B, H, W, 3] uint8; with ``sensors`` a dictionary, see ``GymnasiumEnv``.
    Action: [B] int64, or [B, n] float32 in [-1, 1] for continuous control; see ``GymnasiumEnv``.
    Info: ``outcome``, ``goals``, ``success``, ``state``, ``level`` and, with several scenes, ``scene`` that belong to
        the observation, [B, ...] each. With same-step resets, ``final_obs`` and ``final_info`` hold the last
        observation and info of robots whose episode ended. Each entry has a mask, [B] bool, under ``_<name>``.
    Reset: a single seed is used for the whole batch. With a list of seeds, each robot's start depends only on its own
        seed, and everything drawn later depends on all of them; robots with None draw from the env's generator as
        before. ``options={"reset_mask": ...}``, [B] bool, restarts only some of the robots.
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
        self.metadata = {**_METADATA, "autoreset_mode": self.autoreset_mode}
        self.env, self.num_envs, self.render_mode = env, env.numel(), _checked_mode(render_mode)
        self.single_observation_space, self.single_action_space = _spaces(env)
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
            self._present = _begin(self.env, together, options, seeds)  # type: ignore[arg-type]
        else:
            if together is not None:
                self.env.set_seed(int(together))  # type: ignore[arg-type]
            self._present = self._restarted(self._present, chosen, {} if seeds is None else {"seeds": seeds})
        self._over[... if chosen is None else chosen] = False
        return _observed(self.env, self._present), self._told(chosen)

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
        acted = _act(self.env, self._present, self.action_space, actions)
        return (self._step_over if self._over.any() else self._step)(acted)

    def _step(self, acted: TensorDictBase) -> tuple[Any, ...]:
        """Take a step in which all robots act."""
        same = self.autoreset_mode == AutoresetMode.SAME_STEP
        step, self._present = self.env.step_and_maybe_reset(acted) if same else self._stepped(acted)
        _raise_faults(self.env)
        after = step["next"]
        infos, ended = self._told(), _column(after, "done")
        if same and ended.any():
            last, seen = np.full(self.num_envs, None, dtype=object), _observed(self.env, after)
            for row in ended.nonzero()[0].tolist():
                last[row] = _seen_by(seen, row)
            infos |= _masked({"final_obs": last, "final_info": _masked(_infos(after), ended)}, ended)
        if not same:
            self._over = ended
        reward = _column(after, "reward").astype(np.float64)
        seen = _observed(self.env, self._present)
        return seen, reward, _column(after, "terminated"), _column(after, "truncated"), infos

    def _step_over(self, acted: TensorDictBase) -> tuple[Any, ...]:
        """Take a step in which some robots begin an episode and the others act."""
        over, mask = self._over, torch.as_tensor(self._over, device=self.env.device).unsqueeze(1)
        acted["level"] = torch.where(mask, -1, acted["level"])  # the curriculum counts an ended episode only once
        step, present = self._stepped(acted)
        _raise_faults(self.env)
        self._present = self._restarted(present, over, {})
        after = step["next"]
        terminated, truncated = (_column(after, key) & ~over for key in ("terminated", "truncated"))
        self._over = terminated | truncated
        reward = np.where(over, 0.0, _column(after, "reward").astype(np.float64))
        return _observed(self.env, self._present), reward, terminated, truncated, self._told()

    def _stepped(self, acted: TensorDictBase) -> tuple[TensorDictBase, TensorDictBase]:
        step = self.env.step(acted)
        return step, self.env.step_mdp(step)

    def _told(self, rows: npt.NDArray[np.bool_] | None = None) -> Infos:
        """Return the infos that belong to the current observation, of all robots or of some, [B] bool."""
        assert self._present is not None
        return _masked(_infos(self._present), np.ones(self.num_envs, dtype=bool) if rows is None else rows)

    def render(self) -> tuple[Pixels, ...] | None:
        """Return the current views, [H, W, 3] uint8 each; None without a render mode."""
        if self.render_mode is None:
            return None
        if self._present is None:
            raise gymnasium.error.ResetNeeded("render: expected a call to reset() first")
        return tuple(_views(self._present))


def _checked_mode(render_mode: str | None) -> str | None:
    if render_mode not in (None, "rgb_array"):
        raise ValueError(f"render_mode: expected 'rgb_array' or None, got {render_mode!r}")
    return render_mode


def _spaces(env: EnvBase) -> tuple[gymnasium.Space[Any], gymnasium.Space[Any]]:
    """Return the observation space and the action space of one robot."""
    check_layers(env)
    observed = {key: _observation_space(env.observation_spec[key]) for key in _observed_keys(env)}
    return Dict(observed) if len(observed) > 1 else observed["pixels"], _action_space(env.action_spec)


def _observation_space(spec: TensorSpec) -> gymnasium.Space[Any]:
    """Return one robot's observation space for a key, from the spec of the batch."""
    shape = tuple(spec.shape[1:])
    if spec.dtype == torch.bool:
        return MultiBinary(shape)
    kind = torch.empty(0, dtype=spec.dtype).numpy().dtype
    if isinstance(spec, Bounded):
        return Box(spec.low[0].cpu().numpy(), spec.high[0].cpu().numpy(), shape, kind)
    return Box(-np.inf, np.inf, shape, kind)


def _action_space(spec: TensorSpec) -> gymnasium.Space[Any]:
    """Return one robot's action space, from the spec of the batch."""
    if isinstance(spec, Categorical):
        return Discrete(int(spec.n))
    if isinstance(spec, Bounded) and spec.dtype == torch.float32:
        return Box(-1.0, 1.0, tuple(spec.shape[1:]), np.float32)
    raise ValueError(f"env: expected a discrete or bounded float32 action, got {type(spec).__name__} {spec.dtype}")


def _together(seeds: list[int | None]) -> int | None:
    """Derive a seed for the batch from the seeds of all robots; None if any robot has none."""
    known = [seed for seed in seeds if seed is not None]
    return int(np.random.SeedSequence(known).generate_state(1)[0]) if len(known) == len(seeds) else None


def _begin(
    env: EnvBase, seed: int | None, options: dict[str, Any] | None, seeds: list[int | None] | None = None
) -> TensorDictBase:
    specs = dict(env.observation_spec.items())
    expected = {key: specs[key] for key in ("state", "scene") if key in specs}
    if options and options.keys() != expected.keys():
        raise ValueError(f"options: expected {' and '.join(map(repr, expected))}, got {sorted(options)}")
    if seed is not None:
        env.set_seed(int(seed))
    if not options:
        return env.reset() if seeds is None else env.reset(seeds=seeds)
    given = {key: _given(f"options[{key!r}]", options[key], spec) for key, spec in expected.items()}
    return env.reset(TensorDict(given, env.batch_size, device=env.device), set_state=True)


def _given(name: str, value: Any, spec: TensorSpec) -> Tensor:
    """Return what a client gives for a key of the batch, [B, ...]; ``name`` is for the message."""
    given = torch.as_tensor(value, dtype=spec.dtype, device=spec.device)
    placed = given.reshape(spec.shape) if given.numel() == spec.shape.numel() else None
    if placed is None or not spec.is_in(placed):
        raise ValueError(f"{name}: expected shape {list(spec.shape)} and values within bounds, got {given.tolist()}")
    return placed


def _act(env: EnvBase, present: TensorDictBase, space: gymnasium.Space[Any], actions: Any) -> TensorDictBase:
    continuous = isinstance(space, Box)
    if continuous:
        actions = np.asarray(actions, space.dtype)  # clients may pass float64
    if not space.contains(actions):
        raise ValueError(f"action: expected an action in {space}, got {actions}")
    spec = env.action_spec
    action = torch.as_tensor(actions, dtype=spec.dtype, device=env.device).reshape(spec.shape)
    if continuous:
        action = torch.lerp(spec.low, spec.high, (action + 1) / 2)
    return present.set("action", action)


def _raise_faults(env: EnvBase) -> None:
    """Raise errors that renderer or checker recorded on the device: Gymnasium's arrays synchronise with it anyway."""
    base = layers(env)[0]
    if isinstance(base, Faulty):
        base.raise_faults()


def _observed_keys(env: EnvBase) -> list[str]:
    """Return the observed keys: the pixels, and those of the other sensors."""
    return ["pixels", *(key for key in layers(env)[0].sensors if key != "pixels")]


def _observed(env: EnvBase, td: TensorDictBase) -> Observation:
    """Return copies of the observations of a batch of robots: clients may edit what they are given."""
    arrays = {key: td[key].to("cpu", copy=True).numpy() for key in _observed_keys(env)}
    if len(arrays) == 1:
        return arrays["pixels"]
    return {key: each.astype(np.int8) if each.dtype == bool else each for key, each in arrays.items()}


def _seen_by(observed: Observation, row: int) -> Observation:
    """Return the observation of one robot of a batch."""
    return {key: each[row] for key, each in observed.items()} if isinstance(observed, dict) else observed[row]


def _pixels(td: TensorDictBase) -> Pixels:
    return td["pixels"].cpu().numpy()


def _views(td: TensorDictBase) -> Pixels:
    """Return copies of the latest views, [B, H, W, 3]: policies with ``memory=stack`` observe several at once."""
    return _pixels(td)[..., -3:].copy()


def _column(td: TensorDictBase, key: str) -> npt.NDArray[Any]:
    return td[key].squeeze(1).cpu().numpy()


def _infos(td: TensorDictBase) -> Infos:
    held = set(td.keys())
    columns = {key: _column(td, key) for key in ("outcome", "goals", "success", "level", "scene") if key in held}
    return {key: each.copy() for key, each in {**columns, "state": td["state"].cpu().numpy()}.items()}  # see _observed


def _one(infos: Infos) -> Infos:
    """Return the infos of the only robot, with scalars as Python numbers."""
    rows = {key: value[0] for key, value in infos.items()}
    return {key: row.item() if row.ndim == 0 else row for key, row in rows.items()}


def _masked(infos: Infos, rows: npt.NDArray[np.bool_]) -> Infos:
    """Add to each info a mask of the rows for which it is valid, as Gymnasium's vector envs do."""
    return infos | {f"_{key}": rows for key in infos}
