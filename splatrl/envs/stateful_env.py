"""An env under transforms that keeps the state of both."""

from collections import OrderedDict
from collections.abc import Mapping
from typing import Any

from torchrl.envs import TransformedEnv

BASE, TRANSFORM = "base_env.", "transform."


class StatefulEnv(TransformedEnv):
    """TorchRL's env under transforms, whose ``state_dict()`` holds the base env's generator and curriculum as well.

    That of ``TransformedEnv`` holds the transforms' alone, so an env that was restored from it went on elsewhere.
    """

    def state_dict(self, *args: Any, **kwargs: Any) -> "OrderedDict[str, Any]":
        """State of the base env and of the transforms, each under its prefix."""
        parts = ((BASE, self.base_env), (TRANSFORM, self.transform))
        return OrderedDict(
            (prefix + key, value) for prefix, part in parts for key, value in part.state_dict(*args, **kwargs).items()
        )

    def load_state_dict(self, state_dict: Mapping[str, Any], **kwargs: Any) -> None:
        """Restore a ``state_dict()``, or that of the transforms alone, which is all that TorchRL's collectors keep."""
        self.reset()  # gives transforms that remember frames the sizes that they had
        if not any(key.startswith((BASE, TRANSFORM)) for key in state_dict):
            self.transform.load_state_dict(OrderedDict(state_dict), **kwargs)
            return
        for prefix, part in ((BASE, self.base_env), (TRANSFORM, self.transform)):
            own = {key.removeprefix(prefix): value for key, value in state_dict.items() if key.startswith(prefix)}
            part.load_state_dict(OrderedDict(own), **kwargs)
