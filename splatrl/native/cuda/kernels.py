"""Loading kernels on a GPU, and launching them."""

import ctypes
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from splatrl.native.cuda.compiler import compiled

FREELY_SHARED = 48 * 1024
"""Bytes of dynamic shared memory that a block may use without opting in to more."""


class Kernels(Protocol):
    """The kernels of one source, on one device.

    Attributes:
        device: the device on which they run and which holds their tensors.
        multiprocessors: number of multiprocessors of that device.
        memory: memory of that device, bytes.
    """

    device: torch.device
    multiprocessors: int
    memory: int

    def resident(self, name: str, threads: int, shared: int = 0) -> int:
        """Return how many blocks of a kernel fit on a multiprocessor at a time, at least 1."""
        ...

    def launch(self, name: str, blocks: int, threads: int, *arguments: Any, shared: int = 0) -> None:
        """Queue a kernel on PyTorch's current stream of the device, and return at once.

        Args:
            name: name of the kernel.
            blocks: number of blocks in the grid.
            threads: number of threads per block.
            arguments: arguments of the kernel. A tensor, which must be contiguous and on the device, is passed as its
                address, None as a null pointer, an int with 32 bits, a float in single precision, and ctypes values are
                passed as they are.
            shared: bytes of dynamic shared memory.
        """
        ...


Load = Callable[[str, Mapping[str, int]], Kernels]
"""Function that loads the kernels of a source, compiled with the given macros."""


def packed(arguments: tuple[Any, ...], device: torch.device) -> list[Any]:
    """Convert the arguments of a kernel to ctypes values."""
    values: list[Any] = []
    for argument in arguments:
        if isinstance(argument, Tensor):
            assert argument.device == device and argument.is_contiguous(), (argument.device, argument.stride())
            values.append(ctypes.c_void_p(argument.data_ptr()))
        elif argument is None:
            values.append(ctypes.c_void_p(0))
        elif isinstance(argument, int):
            values.append(ctypes.c_int(argument))
        elif isinstance(argument, float):
            values.append(ctypes.c_float(argument))
        else:
            values.append(argument)
    return values


def uploaded(values: NDArray[Any], device: torch.device) -> Tensor:
    """Copy an array's bits to a device, as signed integers, which PyTorch has in every size."""
    bits = values.view(np.dtype(f"i{values.itemsize}"))
    return torch.from_numpy(bits if bits.flags.writeable else bits.copy()).to(device)


class CudaKernels:
    """Kernels on a CUDA device, launched through the driver API, from any thread: see ``Kernels``.

    Args:
        source: name of a file in ``splatrl/native/cuda``, or a path.
        device: a CUDA device.
        defines: values of macros, by name.

    Raises:
        ImportError: if cuda-core is not installed.
        RuntimeError: if the driver refuses the code.
    """

    def __init__(
        self, source: str | Path, device: torch.device | str, defines: Mapping[str, int] | None = None
    ) -> None:
        self.device = torch.empty(0, device=device).device  # includes the index; this also creates PyTorch's context
        major, minor = torch.cuda.get_device_capability(self.device)
        properties = torch.cuda.get_device_properties(self.device)
        self.multiprocessors, self.memory = properties.multi_processor_count, properties.total_memory
        code = compiled(source, f"sm_{major}{minor}", defines)
        from cuda.bindings import driver

        self._driver = driver
        self._kernels: dict[tuple[str, int], Any] = {}
        number = self._answer(driver.cuDeviceGet(self.device.index))
        self._context = self._answer(driver.cuDevicePrimaryCtxRetain(number))  # the context that PyTorch uses
        image = ctypes.create_string_buffer(code, len(code))
        with self._current():
            self._module = self._answer(driver.cuModuleLoadData(ctypes.addressof(image)))

    def resident(self, name: str, threads: int, shared: int = 0) -> int:
        """See ``Kernels.resident``."""
        with self._current():
            kernel = self._kernel(name, shared)
            blocks = self._answer(self._driver.cuOccupancyMaxActiveBlocksPerMultiprocessor(kernel, threads, shared))
        return max(1, int(blocks))

    def launch(self, name: str, blocks: int, threads: int, *arguments: Any, shared: int = 0) -> None:
        """See ``Kernels.launch``."""
        values = packed(arguments, self.device)
        addresses = (ctypes.c_void_p * len(values))(*(ctypes.addressof(value) for value in values))
        with self._current():
            stream = self._driver.CUstream(torch.cuda.current_stream(self.device).cuda_stream)
            kernel, where = self._kernel(name, shared), ctypes.addressof(addresses)
            self._answer(
                self._driver.cuLaunchKernel(kernel, blocks, 1, 1, threads, 1, 1, shared, stream, where, 0)
            )  # it copies the arguments before it returns

    @contextmanager
    def _current(self) -> Iterator[None]:
        """Make the device's context current in this thread.

        PyTorch binds a context only when it first needs one in a thread. Until then the thread has none, and every call
        to the driver fails.
        """
        with torch.cuda.device(self.device):
            if int(self._answer(self._driver.cuCtxGetCurrent())) == 0:
                self._answer(self._driver.cuCtxSetCurrent(self._context))
            yield

    def _kernel(self, name: str, shared: int) -> Any:
        """Return the kernel, permitted to use this much dynamic shared memory."""
        if (name, shared) not in self._kernels:
            kernel = self._answer(self._driver.cuModuleGetFunction(self._module, name.encode()))
            limit = self._driver.CUfunction_attribute.CU_FUNC_ATTRIBUTE_MAX_DYNAMIC_SHARED_SIZE_BYTES
            if shared > FREELY_SHARED:
                self._answer(self._driver.cuFuncSetAttribute(kernel, limit, shared))
            self._kernels[name, shared] = kernel
        return self._kernels[name, shared]

    def _answer(self, answer: tuple[Any, ...]) -> Any:
        """Check the status that the driver returned, and return its result."""
        error, *values = answer
        if int(error) != 0:
            raise RuntimeError(f"CUDA driver on {self.device}: {error!r}")
        return values[0] if values else None
