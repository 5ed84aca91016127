"""Kernels on a CPU: their own source, compiled by the C++ compiler with an emulation of CUDA's execution model."""

import ctypes
import functools
import hashlib
import os
import re
import shutil
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch

from splatrl.native.cuda import compiler
from splatrl.native.cuda.compiler import NATIVE, source_path
from splatrl.native.cuda.kernels import packed
from tests.builds import built

HERE = Path(__file__).parent
_FLAGS = [
    "-std=c++17",
    "-Og",  # the renderer compiles in half the time of -O1, and each kernel runs only briefly
    "-g1",
    "-fno-var-tracking",  # describes variables, which -g1 leaves out anyway, in a seventh of the compile time
    "-fPIC",
    "-shared",
    "-Wall",
    "-Wextra",
    "-Wno-unknown-pragmas",
    "-ffp-contract=fast",
    "-U_FORTIFY_SOURCE",
]
PASSES = tuple(re.findall(r"^    (\w+),  +//", (NATIVE / "passes.h").read_text(), re.MULTILINE))
"""Names of the members of ``Pass``, in order."""
_KERNEL = re.compile(r"__global__\s+void\s+(?:__launch_bounds__\([^)]*\)\s*)?(\w+)\s*\(")


class EmulatedKernels:
    """Runs kernels like ``Kernels``, but on tensors in main memory, and returns only when they are done.

    Args:
        source: name of a file in ``splatrl/native/cuda``, or a path.
        defines: macros and their values.

    Attributes:
        seed: determines the order in which threads run; 0 runs them in the order of their indices.
    """

    device = torch.device("cpu")
    multiprocessors, memory = 2, 2**30

    def __init__(self, source: str | Path, defines: Mapping[str, int]) -> None:
        self._source, self._defines = source_path(source), tuple(sorted(defines.items()))
        self._folders = compiler.FOLDERS
        self.seed = 0
        self.counts = "COUNT_PASSES" in defines

    @functools.cached_property
    def _library(self) -> ctypes.CDLL:
        """The compiled source, built on first use: renderers also load kernels that they may never launch."""
        library = ctypes.CDLL(str(_library(self._source, self._defines, self._folders)))
        library.launch.argtypes = [ctypes.c_char_p, ctypes.c_uint, ctypes.c_uint, ctypes.c_void_p, ctypes.c_uint64]
        return library

    def passes(self) -> dict[str, tuple[int, int]]:
        """Return how often warps, and how often lanes, passed each ``Pass`` (passes.h) since the last call."""
        assert self.counts, "expected kernels that were loaded by `counted`"
        row = ctypes.c_uint64 * len(PASSES)
        warps, lanes = (row.in_dll(self._library, f"passes_of_{what}") for what in ("warps", "lanes"))
        found = dict(zip(PASSES, zip(warps, lanes, strict=True), strict=True))
        for counts in (warps, lanes):
            ctypes.memset(counts, 0, ctypes.sizeof(row))
        return found

    def resident(self, name: str, threads: int, shared: int = 0) -> int:
        """Return 1: one block per multiprocessor at a time."""
        return 1

    def launch(self, name: str, blocks: int, threads: int, *arguments: Any, shared: int = 0) -> None:
        """See ``Kernels.launch``."""
        values = packed(arguments, self.device)
        addresses = (ctypes.c_void_p * len(values))(*(ctypes.addressof(value) for value in values))
        known = self._library.launch(name.encode(), blocks, threads, ctypes.addressof(addresses), self.seed)
        assert known, f"{name}: no such kernel"


def emulated(source: str | Path, defines: Mapping[str, int] | None = None) -> EmulatedKernels:
    """Load the kernels of a source to run on the CPU."""
    return EmulatedKernels(source, defines or {})


def counted(source: str | Path, defines: Mapping[str, int] | None = None) -> EmulatedKernels:
    """Load the kernels of a source to run on the CPU and count: see ``EmulatedKernels.passes``."""
    return EmulatedKernels(source, {**(defines or {}), "COUNT_PASSES": len(PASSES)})


@functools.cache
def _library(path: Path, defines: tuple[tuple[str, int], ...], headers: tuple[Path, ...]) -> Path:
    """Return the library of a source, compiled again only if it or a header changed, not for another checkout."""
    text = path.read_text()
    names, at_once = _KERNEL.findall(text), 1 if "__shared__" in text else "emulator::MOST_AT_ONCE"
    cases = "\n".join(
        f'    if (!strcmp(name, "{n}")) return emulator::launch({n}, blocks, threads, a, {at_once}, seed), 1;'
        for n in names
    )
    program = f"""#include "cuda.h"
#include "{path}"
extern "C" int launch(const char* name, unsigned blocks, unsigned threads, void** a, uint64_t seed) {{
{cases}
    return 0;
}}
"""
    folders = [HERE, *(folder for folder in headers if folder.name != "std")]  # g++ has its own standard headers
    macros = [f"-D{name}={value}" for name, value in defines]
    flags = [*_FLAGS, *macros]
    digest = hashlib.sha256(repr([program.replace(str(path), path.name), flags]).encode())
    files = {path, *(f for folder in folders for f in folder.glob("*.*")), *headers[0].glob("*.cu")}
    for file in sorted(files, key=lambda file: (file.name, file.parent.name)):
        if file.is_file():
            digest.update(file.read_bytes())
    flags += [part for folder in folders for part in ("-I", str(folder))]
    return built(f"{path.stem}-{digest.hexdigest()[:20]}.so", lambda made: _compile(program, flags, made))


def _compile(program: str, flags: list[str], made: Path) -> None:
    """Compile a program into a shared library."""
    cxx = os.environ.get("CXX") or shutil.which("c++") or shutil.which("g++")
    assert cxx, "expected the C++ compiler that builds the package"
    command = [cxx, *flags, "-x", "c++", "-", "-o", str(made)]
    done = subprocess.run(command, input=program, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
