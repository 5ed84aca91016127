"""Whether code runs for its values, or is only traced."""

import torch
from torch import Tensor
from torch._C._functorch import is_functorch_wrapped_tensor


def traced(tensor: Tensor) -> bool:
    """Whether a compiler, a tracer or ``vmap`` follows what is done to a tensor, which then has no memory to read."""
    return torch.compiler.is_compiling() or torch.jit.is_tracing() or is_functorch_wrapped_tensor(tensor)
