"""A batch of robots as a Stable-Baselines3 ``VecEnv``; requires the extra ``sb3``."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import Wrapper
from torchrl.envs import EnvBase

from splatrl.envs.gymnasium_conversion import Actions, Infos, Observation, Pixels
from splatrl.envs.gymnasium_vector_env import GymnasiumVectorEnv
from splatrl.extras import require

require("stable_baselines3", "sb3")
from stable_baselines3.common.vec_env import VecEnv  # noqa: E402

Indices = int | Iterable[int] | None


class StableBaselinesVecEnv(VecEnv):
    """A batch of robots for the algorithms of Stable-Baselines3, all stepped in one call.

    Observation and action are those of ``GymnasiumVectorEnv``. A robot whose episode ends begins the next one in the
    same step; its info then holds ``terminal_observation``, ``TimeLimit.truncated`` and the final values of all that
    ``GymnasiumEnv`` tells, and ``reset_infos`` holds the values at the new beginning. Wrap it in ``VecMonitor`` to
    record episode returns and lengths, and with ``info_keywords=("spl", ...)`` any of these values. ``seed(s)`` gives
    the robots the seeds s, s + 1, … for the next reset.

    The curriculum begins at its easiest level in every new env, so make one for evaluation with ``curriculum=none``.

    Example:
        >>> import splatrl
        >>> from stable_baselines3 import PPO
        >>> env = StableBaselinesVecEnv(splatrl.make_env(batch_size=[8]))
        >>> model = PPO("CnnPolicy", env, n_steps=32, batch_size=64).learn(256)

    Args:
        env: a ``SplatEnv``, bare or under transforms.

    Raises:
        ImportError: if Stable-Baselines3 is not installed.
        ValueError: for an env whose batch size is not [B], or an action that is neither discrete nor bounded.
    """

    def __init__(self, env: EnvBase):
        self.vector = GymnasiumVectorEnv(env)
        self._actions: Actions | None = None
        spaces = self.vector.single_observation_space, self.vector.single_action_space
        super().__init__(self.vector.num_envs, *spaces)

    def reset(self) -> Observation:
        """Restart all episodes; returns [B, H, W, 3] uint8, or a dictionary."""
        seeds = None if all(seed is None for seed in self._seeds) else list(self._seeds)
        observations, infos = self.vector.reset(seed=seeds, options=_together(self._options))
        self.reset_infos = _rows(infos)
        self._reset_seeds()
        self._reset_options()
        return observations

    def step_async(self, actions: Actions) -> None:
        """Store the actions for the next ``step_wait``."""
        self._actions = actions

    def step_wait(self) -> tuple[Observation, npt.NDArray[np.float32], npt.NDArray[np.bool_], list[Infos]]:
        """Take the stored action of each robot; returns observation, reward [B] float32, done [B] bool, and B infos."""
        assert self._actions is not None, "step_wait: expected a call to step_async() first"
        observations, rewards, terminated, truncated, infos = self.vector.step(self._actions)
        done = terminated | truncated
        told = _rows(infos)
        last = _rows(infos["final_info"]) if done.any() else []
        for row in np.flatnonzero(done).tolist():
            self.reset_infos[row], told[row] = told[row], last[row]
            told[row]["terminal_observation"] = infos["final_obs"][row]
            told[row]["TimeLimit.truncated"] = bool(truncated[row] and not terminated[row])
        return observations, rewards.astype(np.float32), done, told

    def close(self) -> None:
        """Close the env."""
        self.vector.close()

    def get_images(self) -> Sequence[Pixels]:
        """Return the current views, [H, W, 3] uint8 each."""
        return self.vector.render() or ()

    def get_attr(self, attr_name: str, indices: Indices = None) -> list[Any]:
        """Return an attribute, which all robots share, once for each requested robot; a space is that of one robot."""
        one = self if attr_name in ("action_space", "observation_space") else self.vector
        return [getattr(one, attr_name)] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: Indices = None) -> None:
        """Set an attribute of all robots.

        Raises:
            ValueError: for a subset of the robots, since they share the attribute.
        """
        if len(list(self._get_indices(indices))) != self.num_envs:
            raise ValueError(f"indices: expected all robots, since they share {attr_name}, got {indices}")
        setattr(self.vector, attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: Indices = None, **method_kwargs: Any
    ) -> list[Any]:
        """Refuse to call methods of individual robots, which are stepped together.

        Raises:
            NotImplementedError: always.
        """
        raise NotImplementedError(f"{method_name}: expected a call on .vector, since robots have no separate envs")

    def env_is_wrapped(self, wrapper_class: type[Wrapper[Any, Any, Any, Any]], indices: Indices = None) -> list[bool]:
        """Return False for each requested robot: robots have no wrappers of their own."""
        return [False] * len(list(self._get_indices(indices)))


def _together(options: Sequence[dict[str, Any]]) -> dict[str, Any] | None:
    """Merge the robots' options into one for the batch; each key must be given for all robots or for none."""
    if not any(options):
        return None
    keys = {key for option in options for key in option}
    for key in keys:
        if not all(key in option for option in options):
            raise ValueError(f"options: expected {key!r} for all robots or for none, got it for some")
    return {key: np.stack([np.asarray(option[key]) for option in options]) for key in keys}


def _rows(infos: Infos) -> list[Infos]:
    """Return the info of each robot, with scalars as Python numbers."""
    own = {
        key: each for key, each in infos.items() if not key.startswith("_") and key not in ("final_obs", "final_info")
    }
    columns = [each.tolist() if each.ndim == 1 else list(each) for each in own.values()]
    return [dict(zip(own, row, strict=True)) for row in zip(*columns, strict=True)]
