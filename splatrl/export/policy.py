"""A policy as a function of plain tensors: its memory is an explicit input and output."""

from copy import deepcopy
from typing import NamedTuple

import torch
from tensordict import TensorDict
from torch import Tensor, nn
from torchrl.data import Categorical
from torchrl.envs import EnvBase, InitTracker, Transform
from torchrl.modules import ActorValueOperator

from splatrl.envs.nesting import layers
from splatrl.envs.transforms import SIMULATED, FrameStack, simulated
from splatrl.training.asymmetric import actors_trunk
from splatrl.training.heads import distribution
from splatrl.training.memory import STATE, Memory, RecurrentReset

FRAMES = "frames"
"""Name of the state that holds the last views of a policy with stacked frames; those of other images have the image's
name before it, as in ``depth_frames``."""
NEXT = "next_"
"""Prefix of the outputs that hold the states for the next step."""
REMEMBERING = (FrameStack, InitTracker, RecurrentReset)
"""Transforms whose work ``StandalonePolicy`` does itself."""


class Named(NamedTuple):
    """An observation or a state of a policy.

    Attributes:
        name: name of the input; the output of a state has the prefix ``NEXT``.
        shape: shape without the batch dimension.
        dtype: data type.
    """

    name: str
    shape: tuple[int, ...]
    dtype: torch.dtype


class StandalonePolicy(nn.Module):
    """The policy of an actor-critic, with the transforms that it needs, as a function of tensors.

    Input: the observations: ``pixels`` [B, H, W, 3] uint8 and other images, each a single view, and the sensor readings
        that it uses, unprocessed; for a policy with memory also ``begin`` [B] bool, true in the first step of an
        episode, and its ``states``, which are ignored in that step.
    Output: ``action``, the most probable one, [B] int64, or [B, D] float32 within the task's limits; for discrete
        actions ``probabilities`` [B, A] float32, for continuous ones ``loc`` and ``scale`` [B, D] float32, mean and
        standard deviation before the tanh; then the states for the next step.

    Args:
        model: actor and critic; a copy is moved to the CPU.
        env: the env in which the policy acts, with its transforms.

    Raises:
        ValueError: for an env with a transform that can be neither carried over nor left out.
    """

    def __init__(self, model: ActorValueOperator, env: EnvBase):
        super().__init__()
        model = deepcopy(model).cpu().eval()
        self.trunk, self.head = actors_trunk(model), model.get_policy_head()
        for module in self.trunk.modules():
            if isinstance(module, Memory):
                module.stepwise = True
        spec = env.action_spec
        self.discrete = isinstance(spec, Categorical)
        seen = env.observation_spec
        observed = {str(key): tuple(seen[key].shape[1:]) for key in self.trunk.module[0].in_keys}
        self.stacks, self.states = dict[str, tuple[str, int]](), list[Named]()
        for key, views in _stacked(env).items():
            if key in observed:
                stack, view = observed[key], (*observed[key][:-1], observed[key][-1] // views)
                self.stacks[key], observed[key] = (FRAMES if key == "pixels" else f"{key}_{FRAMES}", views), view
                self.states.append(Named(self.stacks[key][0], stack, seen[key].dtype))
        self.observed = [Named(key, shape, seen[key].dtype) for key, shape in observed.items()]
        if STATE in seen.keys():  # noqa: SIM118, a spec is no dict
            self.states.append(Named(STATE, tuple(seen[STATE].shape[1:]), torch.float32))
        self.left_out = _left_out(env)

    @property
    def inputs(self) -> list[str]:
        """Names of the inputs, in the order in which ``forward`` takes them."""
        known = [each.name for each in self.observed], [state.name for state in self.states]
        return [*known[0], *(["begin"] if self.states else []), *known[1]]

    @property
    def outputs(self) -> list[str]:
        """Names of the outputs, in the order in which ``forward`` returns them."""
        about = ["probabilities"] if self.discrete else ["loc", "scale"]
        return ["action", *about, *(NEXT + state.name for state in self.states)]

    def example(self, batch: int) -> tuple[Tensor, ...]:
        """Return all-zero ``inputs`` for robots whose episodes begin, [batch, ...] each; ``begin`` is true."""
        seen, states = (
            [torch.zeros(batch, *each.shape, dtype=each.dtype) for each in named]
            for named in (self.observed, self.states)
        )
        return (*seen, *([torch.ones(batch, dtype=torch.bool)] if states else []), *states)

    def forward(self, *given: Tensor) -> tuple[Tensor, ...]:
        """Act; see the class for inputs and outputs."""
        known = dict(zip(self.inputs, given, strict=True))
        observed = {each.name: known[each.name] for each in self.observed}
        following = {}
        for key, (name, views) in self.stacks.items():
            view = known[key]
            kept, begun = torch.cat([known[name][..., view.shape[-1] :], view], -1), torch.cat([view] * views, -1)
            observed[key] = following[name] = torch.where(known["begin"].view(-1, 1, 1, 1), begun, kept)
        seen = TensorDict(observed, batch_size=[])  # a batch size would be baked into the file
        if STATE in known:
            seen.update({STATE: known[STATE], "is_init": known["begin"].unsqueeze(-1)})
        thought = self.trunk(seen)
        if STATE in known:
            following[STATE] = thought["next", STATE]
        chosen = distribution(self.head, thought["hidden"])
        kept_states = tuple(following[state.name] for state in self.states)
        if self.discrete:
            probabilities = chosen.logits.softmax(-1)  # type: ignore[attr-defined]
            return (probabilities.argmax(-1), probabilities, *kept_states)
        share = (chosen.loc.tanh() + 1.0) / 2.0  # type: ignore[attr-defined]
        action = torch.lerp(chosen.low, chosen.high, share)  # type: ignore[attr-defined]
        return (action, chosen.loc, chosen.scale, *kept_states)  # type: ignore[attr-defined]


def _stacked(env: EnvBase) -> dict[str, int]:
    """Return how many views an env stacks of each image that it stacks, if more than one."""
    stacks = [each for outer in layers(env)[1] for each in outer.transform if isinstance(each, FrameStack)]
    return {str(key): each.N for each in stacks for key in each.in_keys if each.N > 1}


def _left_out(env: EnvBase) -> list[str]:
    """Return the names of the transforms that only the simulation needs.

    Raises:
        ValueError: for any other transform whose work ``StandalonePolicy`` does not do itself.
    """
    transforms: list[Transform] = [each for outer in layers(env)[1] for each in outer.transform]
    strange = [type(each).__name__ for each in transforms if not isinstance(each, (*SIMULATED, *REMEMBERING))]
    if strange:
        known = ", ".join(kind.__name__ for kind in (*SIMULATED, FrameStack))
        raise ValueError(f"transforms: expected only those that can be exported ({known}), got {', '.join(strange)}")
    return simulated(transforms)
