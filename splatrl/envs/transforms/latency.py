"""Latency of views and actions."""

from collections.abc import Mapping, Sequence

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite, Unbounded

from splatrl.envs.drawing.depth_drawing import VIEW_DEPTH
from splatrl.envs.restart import where_marked
from splatrl.envs.transforms.randomness import RandomTransform
from splatrl.values import are_numbers, require_number

MOST = 64
"""Maximum delay, steps."""
NO_FLOAT, NO_CHOICE = 1e9, -1
"""Placeholders, for continuous and discrete actions, of an action not chosen yet; they lie outside any action space."""
VIEWS = ("pixels", "depth", VIEW_DEPTH)
"""Keys of what the camera sees: its image, what its depth sensor reads, and the depth that weather needs."""


class Latency(RandomTransform):
    """Delays the camera's views and the robot's actions by whole numbers of steps, drawn anew for each episode.

    Real cameras and links have varying latency (GaussGym also draws both delays per episode). Until an episode has an
    action that is old enough, its first action is carried out; until it has a view that is old enough, its first view
    is shown. A view is everything in ``VIEWS`` that is observed: depth comes from the same camera, and is as late as
    ``pixels``. Rewards, termination and other sensor readings are not delayed.

    It adds to the observation ``latency`` [B, 2] int64, delays of camera and action in this episode, steps;
    ``late_pixels`` [B, C + 1, H, W, 3] uint8 (and ``late_depth`` likewise, if depth is observed), the latest views in
    the order in which they were taken, where C is the camera's maximum delay; and ``late_action`` [B, A, ...], the
    latest actions chosen, where A is the action's maximum delay. A reset to a given state together with these values
    continues the episode. Since nothing is kept outside the TensorDict, rows do not depend on each other.

    Args:
        camera: minimum and maximum delay of views, steps.
        action: minimum and maximum delay of actions, steps.
        seed: seed of the transform's own generator (``RandomTransform``).

    Raises:
        ValueError: for anything but two whole numbers with 0 ≤ lowest ≤ highest ≤ 64.
    """

    def __init__(self, camera: Sequence[int] = (0, 1), action: Sequence[int] = (0, 1), seed: int = 0):
        super().__init__(seed, out_keys=["pixels", "late_pixels", "latency", "late_action"])
        for name, pair in (("camera", camera), ("action", action)):
            if not are_numbers(pair, 2):
                raise ValueError(f"latency.{name}: expected the lowest and the highest delay, got {pair}")
            for value in pair:
                require_number(f"latency.{name}", value, 0, MOST, whole=True)
            if pair[0] > pair[1]:
                raise ValueError(f"latency.{name}: expected lowest ≤ highest, got {list(pair)}")
        self.low, self.high = (camera[0], action[0]), (camera[1], action[1])
        self.remembered = ("latency", "late_action") if self.high[1] else ("latency",)  # views repeat by themselves

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        if self.env is None:
            return tensordict
        action, late = tensordict["action"], tensordict["late_action"]
        chosen = action.unsqueeze(1)
        chain = torch.cat([torch.where(late == _none_of(action.dtype), chosen, late), chosen], 1)
        tensordict.set("action", _taken(chain, tensordict["latency"][:, 1]))
        return tensordict.set("late_action", chain[:, 1:].clone())

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        views = {
            key: torch.cat([tensordict[_late(key)][:, 1:], next_tensordict[key].unsqueeze(1)], 1)
            for key in _viewed(next_tensordict)
        }
        kept = {key: tensordict[key].clone() for key in ("latency", "late_action")}
        return self._shown(next_tensordict, views, kept["latency"]).update(kept)

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        batch, device = tensordict_reset.batch_size, tensordict_reset["pixels"].device
        options = {"generator": self.generator, "device": device}
        drawn = [torch.randint(low, high + 1, batch, **options) for low, high in zip(self.low, self.high, strict=True)]
        spec = self.parent.full_action_spec["action"] if self.parent is not None else None
        assert spec is not None, "latency: expected a parent env, found none"
        shape = (batch[0], self.high[1], *spec.shape[1:])
        late = torch.full(shape, _none_of(spec.dtype), dtype=spec.dtype, device=device)
        viewed, values = _viewed(tensordict_reset), {"latency": torch.stack(drawn, -1), "late_action": late}
        for key in viewed:
            view = tensordict_reset[key].unsqueeze(1)
            values[_late(key)] = view.repeat(1, self.high[0] + 1, *[1] * (view.ndim - 2))
        goes_on = tensordict_reset["level"] == -1  # level -1 marks a given state, whose past is given with it
        for key in values:
            given = tensordict.get(key, None)
            if given is not None:
                values[key] = where_marked(goes_on.flatten(), given, values[key])
        tensordict_reset.set("late_action", values["late_action"]).set("latency", values["latency"])
        return self._shown(tensordict_reset, {key: values[_late(key)] for key in viewed}, values["latency"])

    @staticmethod
    def _shown(tensordict: TensorDictBase, views: Mapping[str, Tensor], latency: Tensor) -> TensorDictBase:
        for key, taken in views.items():
            tensordict.set(_late(key), taken).set(key, _taken(taken, latency[:, 0]))
        return tensordict

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Change nothing: recorded views are already delayed."""
        return tensordict

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add the delays and the past views and actions to the observation."""
        return self._with_late(observation_spec, observation_spec)

    def transform_state_spec(self, state_spec: Composite) -> Composite:
        """Read the delays and the past views and actions from the input of a step or a reset."""
        assert self.parent is not None
        return self._with_late(state_spec, self.parent.observation_spec)

    def _with_late(self, spec: Composite, observed: Composite) -> Composite:
        assert self.parent is not None
        action, spec = self.parent.full_action_spec["action"], spec.clone()
        for key in _viewed(observed):
            one = observed[key]
            shape = (spec.shape[0], self.high[0] + 1, *one.shape[1:])
            spec[_late(key)] = Unbounded(shape=shape, dtype=one.dtype, device=spec.device)
        actions = (spec.shape[0], self.high[1], *action.shape[1:])
        spec["latency"] = Unbounded(shape=(*spec.shape, 2), dtype=torch.int64, device=spec.device)
        spec["late_action"] = Unbounded(shape=actions, dtype=action.dtype, device=spec.device)
        return spec


def _viewed(observed: TensorDictBase | Composite) -> list[str]:
    """Return the keys of what is observed of the camera's views."""
    return [key for key in VIEWS if key in observed.keys()]  # noqa: SIM118, neither is a dict


def _late(key: str) -> str:
    """Return the key of the latest views."""
    return f"late_{key}"


def _none_of(dtype: torch.dtype) -> float | int:
    """Return the placeholder of an action not chosen yet, by dtype."""
    return NO_FLOAT if dtype.is_floating_point else NO_CHOICE


def _taken(chain: Tensor, late: Tensor) -> Tensor:
    """Select each row's entry that lies ``late`` steps before its last: [B, K, ...], [B] -> [B, ...]."""
    last = torch.arange(1, len(chain) + 1, device=chain.device) * chain.shape[1] - 1
    return chain.flatten(0, 1).index_select(0, last - late)  # copies whole views, where chain[rows, late] takes bytes
