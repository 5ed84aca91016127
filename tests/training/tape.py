"""A CUDA graph without CUDA: the operations of one call, replayed on the same tensors."""

from collections.abc import Callable
from typing import Any

from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import TreeSpec, tree_flatten, tree_leaves, tree_unflatten


class Tape(TorchDispatchMode):
    """Records every operation on tensors, and replays them.

    Inputs that the recording did not create stay what they were: the same tensor, or the same number. So, as with a
    CUDA graph, whatever Python decides or rebinds is frozen.
    """

    def __init__(self) -> None:
        super().__init__()
        self.operations: list[tuple[Any, list[Any], TreeSpec, list[Any]]] = []

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        out = func(*args, **(kwargs or {}))
        given, shape = tree_flatten((args, kwargs or {}))
        self.operations.append((func, given, shape, tree_leaves(out)))
        return out

    def replay(self) -> None:
        """Replay all operations."""
        made: dict[int, Tensor] = {}

        def now(value: Any) -> Any:
            return made.get(id(value), value) if isinstance(value, Tensor) else value

        for func, given, shape, out in self.operations:
            args, kwargs = tree_unflatten(map(now, given), shape)
            for before, after in zip(out, tree_leaves(func(*args, **kwargs)), strict=True):
                if isinstance(before, Tensor):
                    made[id(before)] = after


class Taped:
    """Stands in for ``CudaGraph``: the fourth call is recorded, and later ones are replays."""

    def __init__(self, function: Callable[[], None]):
        self.function, self.calls = function, 0
        self.tape = Tape()

    def __call__(self) -> None:
        self.calls += 1
        if self.calls < 4:
            self.function()
        elif self.calls == 4:
            with self.tape:
                self.function()
        else:
            self.tape.replay()
