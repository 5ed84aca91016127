"""A policy on plain tensors: what it remembers goes in and comes out beside what it sees and does."""

from copy import deepcopy
from typing import NamedTuple

import torch
from tensordict import TensorDict
from torch import Tensor, nn
from torchrl.data import Categorical
from torchrl.envs import EnvBase, InitTracker, Transform
from torchrl.modules import ActorValueOperator

from splatrl.envs.nesting import layers
from splatrl.envs.transforms import Appearance, FrameStack, PoseNoise, Weather
from splatrl.training.heads import distribution
from splatrl.training.memory import STATE, Memory, RecurrentReset

FRAMES = "frames"
"""Name of the state of a policy that sees several views."""
NEXT = "next_"
"""Prefix of the outputs that are the states of the next step."""
SIMULATED = (Appearance, PoseNoise, Weather)
"""Transforms that make a simulated camera more like a real one; a real camera needs none of them."""
REMEMBERING = (FrameStack, InitTracker, RecurrentReset)
"""Transforms whose work ``StandalonePolicy`` does itself."""


class State(NamedTuple):
    """Something that a policy remembers.

    Attributes:
        name: of the input; the output has ``NEXT`` before it.
        shape: without the batch.
        dtype: of its numbers.
    """

    name: str
    shape: tuple[int, ...]
    dtype: torch.dtype


class StandalonePolicy(nn.Module):
    """The policy of an actor-critic, with the transforms that it needs, as a function of tensors.

    Input: ``pixels`` [B, H, W, 3] uint8, one view; for a policy that remembers also ``begin`` [B] bool, true in the
        first step of an episode, and its ``states``, which are not read there.
    Output: ``action``, the most probable one, [B] int64, or [B, D] float32 within the task's limits; for discrete
        actions ``probabilities`` [B, A] float32, for continuous ones ``loc`` and ``scale`` [B, D] float32, mean and
        standard deviation before the tanh; then the states of the next step.

    Args:
        model: actor and critic; it is copied to the CPU.
        env: the env in which it acts, with its transforms.

    Raises:
        ValueError: for a policy that reads something other than ``pixels``, or an env with a transform that can be
            neither carried over nor left out.
    """

    def __init__(self, model: ActorValueOperator, env: EnvBase):
        super().__init__()
        model = deepcopy(model).cpu().eval()
        self.trunk, self.head = model.module[0], model.get_policy_head()
        reads = self.trunk.module[0].in_keys
        if list(reads) != ["pixels"]:
            raise ValueError(f"inputs: expected a policy that reads pixels alone, got one of {', '.join(reads)}")
        for module in self.trunk.modules():
            if isinstance(module, Memory):
                module.stepwise = True
        spec = env.action_spec
        self.discrete = isinstance(spec, Categorical)
        height, width, channels = env.observation_spec["pixels"].shape[1:]
        self.image_shape = (height, width, 3)
        self.views, self.states = channels // 3, list[State]()
        if self.views > 1:
            self.states.append(State(FRAMES, (height, width, channels), torch.uint8))
        if STATE in env.observation_spec.keys():  # noqa: SIM118, a spec is no dict
            self.states.append(State(STATE, tuple(env.observation_spec[STATE].shape[1:]), torch.float32))
        self.left_out = _left_out(env)

    @property
    def inputs(self) -> list[str]:
        """Names of the inputs, in the order of ``forward``."""
        return ["pixels", *(["begin"] if self.states else []), *(state.name for state in self.states)]

    @property
    def outputs(self) -> list[str]:
        """Names of the outputs, in the order in which ``forward`` returns them."""
        about = ["probabilities"] if self.discrete else ["loc", "scale"]
        return ["action", *about, *(NEXT + state.name for state in self.states)]

    def example(self, batch: int) -> tuple[Tensor, ...]:
        """Inputs of zeros for a number of robots that begin."""
        pixels = torch.zeros(batch, *self.image_shape, dtype=torch.uint8)
        if not self.states:
            return (pixels,)
        states = (torch.zeros(batch, *state.shape, dtype=state.dtype) for state in self.states)
        return (pixels, torch.ones(batch, dtype=torch.bool), *states)

    def forward(self, pixels: Tensor, begin: Tensor | None = None, *states: Tensor) -> tuple[Tensor, ...]:
        """Act; see the class for inputs and outputs."""
        known = dict(zip((state.name for state in self.states), states, strict=True))
        following = {}
        if FRAMES in known:
            assert begin is not None, "a policy that remembers is told where episodes begin"
            kept = torch.cat([known[FRAMES][..., 3:], pixels], -1)
            pixels = torch.where(begin.view(-1, 1, 1, 1), torch.cat([pixels] * self.views, -1), kept)
            following[FRAMES] = pixels
        seen = TensorDict({"pixels": pixels}, batch_size=[])  # a batch size would become a constant of the file
        if STATE in known:
            assert begin is not None, "a policy that remembers is told where episodes begin"
            seen.update({STATE: known[STATE], "is_init": begin.unsqueeze(-1)})
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


def _left_out(env: EnvBase) -> list[str]:
    """Names of the transforms that only the simulated camera needs.

    Raises:
        ValueError: for a transform that is none of them, and that a ``StandalonePolicy`` does not do itself.
    """
    transforms: list[Transform] = [each for outer in layers(env)[1] for each in outer.transform]
    strange = [type(each).__name__ for each in transforms if not isinstance(each, (*SIMULATED, *REMEMBERING))]
    if strange:
        known = ", ".join(kind.__name__ for kind in (*SIMULATED, FrameStack))
        raise ValueError(f"transforms: expected some of {known}, which can be exported, got {', '.join(strange)}")
    return [type(each).__name__ for each in transforms if isinstance(each, SIMULATED)]
