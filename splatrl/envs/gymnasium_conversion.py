"""Between TorchRL and Gymnasium: spaces, resets, actions, observations and infos of a batch of robots."""

from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
import torch
from gymnasium.spaces import Box, Dict, Discrete, MultiBinary
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Bounded, Categorical, TensorSpec
from torchrl.envs import EnvBase

from splatrl.envs.nesting import check_layers, layers
from splatrl.envs.rules import COUNTED
from splatrl.envs.tasks.measures import path_measures

Pixels = npt.NDArray[np.uint8]
Observation = Pixels | dict[str, npt.NDArray[Any]]
Action = np.int64 | npt.NDArray[np.float32]
Actions = npt.NDArray[np.int64] | npt.NDArray[np.float32]
Infos = dict[str, Any]

ADDED = ("is_success", "spl", "soft_spl", "final_obs", "final_info")
"""Infos that no env holds: the name of ``success`` in other libraries, measures of navigation, and ends of episodes."""
METADATA: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 10}


def checked_mode(render_mode: str | None) -> str | None:
    """Return a render mode, or refuse it with a ValueError."""
    if render_mode not in (None, "rgb_array"):
        raise ValueError(f"render_mode: expected 'rgb_array' or None, got {render_mode!r}")
    return render_mode


def spaces_of(env: EnvBase) -> tuple[gymnasium.Space[Any], gymnasium.Space[Any]]:
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


def begin(
    env: EnvBase, seed: int | None, options: dict[str, Any] | None, seeds: list[int | None] | None = None
) -> TensorDictBase:
    """Begin episodes of all robots, and return the result of the reset.

    Args:
        env: the robots' env.
        seed: seed of the env's generator; None leaves it as it is.
        options: infos of the moments at which episodes are to begin: ``state`` and, with several scenes, ``scene``, and
            as much of what task, sensors and transforms remember as is to be restored; None draws episodes.
        seeds: a seed for each robot; see ``SplatEnv``.

    Raises:
        ValueError: for other options, or values that do not fit their spec.
    """
    specs = dict(env.observation_spec.items())
    needed = [key for key in ("state", "scene") if key in specs]
    known = specs.keys() | {*ADDED}
    if options and not ({*needed} <= options.keys() and {key.removeprefix("_") for key in options} <= known):
        remembered = sorted({*layers(env)[0].state_spec.keys()} - {*needed, *COUNTED})
        wanted = " and ".join(map(repr, needed)) + (f", with any of {', '.join(remembered)}" if remembered else "")
        raise ValueError(f"options: expected {wanted}, got {sorted(options)}")
    if seed is not None:
        env.set_seed(int(seed))
    if not options:
        return env.reset() if seeds is None else env.reset(seeds=seeds)
    read = {key: spec for key, spec in specs.items() if key in options and key not in COUNTED}
    given = {key: _given(f"options[{key!r}]", options[key], spec) for key, spec in read.items()}
    return env.reset(TensorDict(given, env.batch_size, device=env.device), set_state=True)


def _given(name: str, value: Any, spec: TensorSpec) -> Tensor:
    """Return what a client gives for a key of the batch, [B, ...]; ``name`` is for the message."""
    given = torch.as_tensor(value, dtype=spec.dtype, device=spec.device)
    placed = given.reshape(spec.shape) if given.numel() == spec.shape.numel() else None
    if placed is None or not spec.is_in(placed):
        raise ValueError(f"{name}: expected shape {list(spec.shape)} and values within bounds, got {given.tolist()}")
    return placed


def act(env: EnvBase, present: TensorDictBase, space: gymnasium.Space[Any], actions: Any) -> TensorDictBase:
    """Return the input of the env's next step, with a client's actions.

    Args:
        env: the robots' env.
        present: [B], the result of the last reset or step; it gains the key ``action``.
        space: the client's action space.
        actions: actions in this space.

    Raises:
        ValueError: for actions outside the space.
    """
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


def _observed_keys(env: EnvBase) -> list[str]:
    """Return the observed keys: the pixels, and those of the other sensors."""
    return ["pixels", *(key for key in layers(env)[0].sensors if key != "pixels")]


def observed(env: EnvBase, td: TensorDictBase, rows: Tensor | None = None) -> Observation:
    """Return copies of the observations of all robots, or of some, [N] int64: clients may edit what they are given."""
    found = {key: td[key] if rows is None else td[key].index_select(0, rows) for key in _observed_keys(env)}
    arrays = {key: each.to("cpu", copy=True).numpy() for key, each in found.items()}
    if len(arrays) == 1:
        return arrays["pixels"]
    return {key: each.astype(np.int8) if each.dtype == bool else each for key, each in arrays.items()}


def seen_by(observed: Observation, row: int) -> Observation:
    """Return the observation of one robot of a batch."""
    return {key: each[row] for key, each in observed.items()} if isinstance(observed, dict) else observed[row]


def views_of(td: TensorDictBase) -> Pixels:
    """Return copies of the latest views, [B, H, W, 3]: policies with ``memory=stack`` observe several at once."""
    return td["pixels"].cpu().numpy()[..., -3:].copy()


def column(td: TensorDictBase, key: str) -> npt.NDArray[Any]:
    """Return an entry with one value per robot: [B]."""
    return td[key].squeeze(1).cpu().numpy()


def infos_of(env: EnvBase, td: TensorDictBase) -> Infos:
    """Return the infos of a batch of robots, [B, ...] by key: the numbers and vectors that are not observed.

    They are copies, since clients may edit what they are given. ``is_success``, ``spl`` and ``soft_spl`` are computed
    from the others.
    """
    held, specs = {*td.keys()} - {*_observed_keys(env)}, env.observation_spec
    told = {key: td[key].cpu() for key, spec in specs.items(True, True) if key in held and spec.ndim <= 2}
    told = {key: each if key == "state" or each.shape[1:] != (1,) else each.squeeze(1) for key, each in told.items()}
    told["is_success"] = told["success"]
    if "start_distance" in told:
        told |= path_measures(told["success"], told)
    return {key: each.numpy().copy() for key, each in told.items()}


def infos_of_one(infos: Infos) -> Infos:
    """Return the infos of the only robot, with scalars as Python numbers."""
    rows = {key: value[0] for key, value in infos.items()}
    return {key: row.item() if row.ndim == 0 else row for key, row in rows.items()}


def masked(infos: Infos, rows: npt.NDArray[np.bool_]) -> Infos:
    """Add to each info a mask of the rows for which it is valid, as Gymnasium's vector envs do."""
    return infos | {f"_{key}": rows for key in infos}
