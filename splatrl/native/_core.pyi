"""The C++ core. Arrays are C-contiguous CPU memory: torch tensors and numpy arrays both go in without a copy."""

def isa() -> str:
    """The instruction set that kernels run with: the fastest one, or the one that $SPLATRL_ISA names.

    Raises:
        ValueError: where $SPLATRL_ISA names none of ``supported_isas()``.
    """

def supported_isas() -> list[str]:
    """The instruction sets that this processor can run, slowest first."""
