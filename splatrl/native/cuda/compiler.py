"""Compiles kernel sources to machine code with NVRTC, once for each GPU architecture, and caches the result."""

import hashlib
import importlib.metadata
import sys
import time
from collections.abc import Mapping
from pathlib import Path

from splatrl.extras import install_hint, require
from splatrl.files import cache_dir, replacing

NATIVE = Path(__file__).parents[1]
FOLDERS = (NATIVE / "cuda", NATIVE, NATIVE / "cuda" / "std", NATIVE / "kernels")
"""Folders that are searched for sources and headers, in this order."""
_MISSING = ("cuda", "CUDA kernels need cuda-core and NVRTC", ", or 'splatrl[cuda12]' for a CUDA 12 driver")


def source_path(source: str | Path) -> Path:
    """Path of a source, given as a path or as the name of a file in ``splatrl/native/cuda``, without its suffix."""
    return Path(source) if Path(source).suffix else FOLDERS[0] / f"{source}.cu"


def compiled(source: str | Path, arch: str, defines: Mapping[str, int] | None = None) -> bytes:
    """Return the machine code (cubin) of a source, from the cache if it is there.

    Compiling takes seconds, so a line on standard error announces it. If the cache cannot be written to, the source is
    compiled every time.

    Args:
        source: see ``source_path``.
        arch: GPU architecture, such as ``"sm_90"``.
        defines: values of macros, by name.

    Raises:
        ImportError: if cuda-core or NVRTC is not installed; the message says how to get them.
        RuntimeError: if the source does not compile; the message holds NVRTC's log.
    """
    path = kept_at(source, arch, defines or {})
    if path.is_file():
        return path.read_bytes()
    start = time.monotonic()
    print(f"splatrl: compiling {source_path(source).name} for {arch} (once) ...", end="", file=sys.stderr, flush=True)
    code, _ = translated(source, arch, defines or {})
    print(f" {time.monotonic() - start:.1f} s", file=sys.stderr)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as stream:
            stream.write(code)
    except OSError as error:
        print(f"splatrl: {path.parent}: cannot cache kernels here; set SPLATRL_CACHE: {error}", file=sys.stderr)
    return code


def kept_at(source: str | Path, arch: str, defines: Mapping[str, int]) -> Path:
    """Path of the file that holds a source's machine code in the cache, if it is cached. See ``compiled``."""
    return cache_dir() / f"{source_path(source).stem}-{arch}-{_digest(source, arch, defines)}.cubin"


def translated(source: str | Path, arch: str, defines: Mapping[str, int]) -> tuple[bytes, str]:
    """Compile a source to machine code, with the assembler's log of registers and memory used. See ``compiled``."""
    core = require("cuda.core", *_MISSING)
    path = source_path(source)
    options = core.ProgramOptions(
        name=path.name,
        arch=arch,
        std="c++17",
        include_path=[str(folder) for folder in FOLDERS],
        define_macro=[(name, str(value)) for name, value in sorted(defines.items())] or None,
        device_as_default_execution_space=True,
        ptxas_options=["-v"],
        lineinfo=True,
    )
    try:
        program = core.Program(path.read_text(), "c++", options)
    except RuntimeError as error:  # raised by cuda-core if it does not find the NVRTC library
        raise ImportError(install_hint(*_MISSING)) from error
    log = _Log()
    try:
        code = program.compile("cubin", logs=log).code
    except Exception as error:  # cuda-core has no public class for compiler errors
        said = f"{log.text}\n{error}".replace("\0", "").strip()
        raise RuntimeError(f"{path.name} for {arch}: expected a source that compiles, got\n{said}") from error
    return bytes(code), log.text


class _Log:
    """Collects the log that NVRTC writes."""

    def __init__(self) -> None:
        self.text = ""

    def write(self, text: str) -> None:
        self.text += text


def _digest(source: str | Path, arch: str, defines: Mapping[str, int]) -> str:
    """Digest of everything that machine code depends on; every header counts, whether included or not."""
    digest = hashlib.sha256()
    files = [path for folder in FOLDERS for path in sorted(folder.iterdir()) if path.suffix in (".h", ".cu", "")]
    for path in (*files, source_path(source)):
        if path.is_file():
            digest.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    digest.update(repr((source_path(source).name, arch, sorted(defines.items()), nvrtc_versions())).encode())
    return digest.hexdigest()[:24]


def nvrtc_versions() -> list[str]:
    """Versions of the NVRTC packages for CUDA 13 and 12; empty for one that is not installed."""
    return [_version(name) for name in ("nvidia-cuda-nvrtc", "nvidia-cuda-nvrtc-cu12")]


def _version(package: str) -> str:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return ""
