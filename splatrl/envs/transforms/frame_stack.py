"""Frame stacking: the last few views, concatenated along the channel axis."""

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Bounded, Composite
from torchrl.envs import Compose, Transform

from splatrl.values import require_number


class FrameStack(Transform):
    """Stacks the last N views along the channel axis, oldest first; an episode begins with its first view repeated.

    A view [B, H, W, C] uint8 becomes [B, H, W, N · C]. Unlike TorchRL's ``CatFrames``, it keeps nothing outside the
    TensorDict: a step reads the earlier views from its input, and a reset to a given state those that are given with
    it, so both depend on their input alone. Nor does it synchronise with the host to find out where episodes begin.
    Transforms that change views belong inside it, since what is outside would be stacked again in the next step.

    Args:
        N: number of views.
        in_keys: keys of the images.
        dim: channel axis; only -1, the last one, is supported.

    Raises:
        ValueError: for fewer than one view, any other axis, a transform outside that changes the views, or an input
            without the stack of earlier views.
    """

    def __init__(self, N: int, in_keys: tuple[str, ...] = ("pixels",), dim: int = -1):
        if dim != -1:
            raise ValueError(f"stack.dim: expected -1, the channel axis, got {dim}")
        require_number("stack.N", N, 1, whole=True)
        super().__init__(in_keys=list(in_keys), out_keys=list(in_keys))
        self.N = N

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        for key in self.in_keys:
            view, given = tensordict_reset[key], tensordict.get(key, None)
            stack = torch.stack([*view.unbind(-1)] * self.N, -1)
            if given is not None:
                goes_on = tensordict_reset["level"] == -1  # level -1 marks a given state, whose past is given with it
                earlier = self._checked(key, given, view)[..., : -view.shape[-1]]
                stack = torch.where(goes_on[..., None, None], torch.cat([earlier, view], -1), stack)
            tensordict_reset.set(key, stack)
        return tensordict_reset

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        for key in self.in_keys:
            view = next_tensordict[key]
            next_tensordict.set(key, _pushed(self._checked(key, tensordict.get(key, None), view), view))
        return next_tensordict

    def _checked(self, key: str, given: Tensor | None, view: Tensor) -> Tensor:
        """Return the stack that was given with a state after checking that it is one of views like this one."""
        shape = (*view.shape[:-1], self.N * view.shape[-1])
        if given is None or given.shape != shape or given.dtype != view.dtype:
            got = "none" if given is None else f"{given.dtype} {list(given.shape)}"
            raise ValueError(
                f"{key}: expected the stack of the last {self.N} views, {view.dtype} {list(shape)}, got {got}"
            )
        return given

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Change nothing: recorded views are already stacked."""
        return tensordict

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Widen the images of the observation."""
        self._refuse_changes_outside()
        return self._with_stacks(observation_spec, observation_spec)

    def transform_state_spec(self, state_spec: Composite) -> Composite:
        """Read the stacks from the input of a step or a reset."""
        assert self.parent is not None
        return self._with_stacks(state_spec, self.parent.observation_spec)

    def _with_stacks(self, spec: Composite, observed: Composite) -> Composite:
        spec = spec.clone()
        for key in self.in_keys:
            view = observed[key]
            low, high = (torch.cat([bound] * self.N, -1) for bound in (view.space.low, view.space.high))
            spec[key] = Bounded(low, high, shape=low.shape, dtype=view.dtype, device=spec.device)
        return spec

    def _refuse_changes_outside(self) -> None:
        env = self.container
        if env is None:
            return
        parts = [one for one in env.transform.modules() if isinstance(one, Transform) and not isinstance(one, Compose)]
        place = next(number for number, one in enumerate(parts) if one is self)
        for one in parts[place + 1 :]:
            if changed := set(one.out_keys or ()) & set(self.out_keys):
                raise ValueError(
                    f"{type(one).__name__}: expected inside FrameStack, which would stack again what it writes to "
                    f"{', '.join(map(str, changed))}, or with other out_keys"
                )


def _pushed(stack: Tensor, view: Tensor) -> Tensor:
    """Return a stack of views with a new one at its end instead of the oldest: [..., N · C], [..., C].

    It is filled by one copy of everything and one of each channel, since joining pixels copies a few bytes at a time.
    """
    pushed, channels = stack.new_empty(stack.shape), view.shape[-1]
    pushed.view(-1)[:-channels] = stack.contiguous().view(-1)[channels:]
    for channel in range(channels):
        pushed[..., channel - channels] = view[..., channel]
    return pushed
