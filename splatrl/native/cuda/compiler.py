"""From a kernel's source to machine code for one GPU, by NVRTC: once for each architecture, kept in a cache."""

import hashlib
import importlib.metadata
import sys
import time
from collections.abc import Mapping
from pathlib import Path

from splatrl.files import cache_dir, replacing

NATIVE = Path(__file__).parents[1]
FOLDERS = (NATIVE / "cuda", NATIVE, NATIVE / "cuda" / "std", NATIVE / "kernels")
"""Where sources and headers are found, in this order."""
_MISSING = (
    "CUDA kernels need cuda-core and NVRTC: pip install 'splatrl[cuda]', or 'splatrl[cuda12]' for a driver of CUDA 12"
)


def source_path(source: str | Path) -> Path:
    """The file of a source: a name, without its ending, in ``splatrl/native/cuda``; or a path."""
    return Path(source) if Path(source).suffix else FOLDERS[0] / f"{source}.cu"


def compiled(source: str | Path, arch: str, defines: Mapping[str, int] | None = None) -> bytes:
    """Machine code (cubin) of a source, from the cache if it is there.

    The first time, a line on standard error says what is compiled, because it takes seconds. Where the cache cannot be
    written to, the source is compiled every time.

    Args:
        source: as for ``source_path``.
        arch: ``"sm_90"`` and so on.
        defines: macros, by name.

    Raises:
        ImportError: where cuda-core or NVRTC is not installed; says how to get them.
        RuntimeError: where the source does not compile; holds NVRTC's log.
    """
    path = kept_at(source, arch, defines or {})
    if path.is_file():
        return path.read_bytes()
    start = time.monotonic()
    print(f"splatrl: compiling {source_path(source).name} for {arch}, once ...", end="", file=sys.stderr, flush=True)
    code, _ = translated(source, arch, defines or {})
    print(f" {time.monotonic() - start:.1f} s", file=sys.stderr)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as stream:
            stream.write(code)
    except OSError as error:
        print(f"splatrl: {path.parent}: cannot keep kernels here, set SPLATRL_CACHE: {error}", file=sys.stderr)
    return code


def kept_at(source: str | Path, arch: str, defines: Mapping[str, int]) -> Path:
    """The file in the cache that holds a source's machine code, if it is there. See ``compiled``."""
    return cache_dir() / f"{source_path(source).stem}-{arch}-{_digest(source, arch, defines)}.cubin"


def translated(source: str | Path, arch: str, defines: Mapping[str, int]) -> tuple[bytes, str]:
    """Compile a source into machine code, with what the assembler says about registers and memory. See ``compiled``."""
    try:
        from cuda.core import Program, ProgramOptions
    except ImportError as error:
        raise ImportError(_MISSING) from error
    path = source_path(source)
    options = ProgramOptions(
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
        program = Program(path.read_text(), "c++", options)
    except RuntimeError as error:  # raised by cuda-core where the NVRTC library is not found
        raise ImportError(_MISSING) from error
    log = _Log()
    try:
        code = program.compile("cubin", logs=log).code
    except Exception as error:  # cuda-core has no public class for a compiler's error
        said = f"{log.text}\n{error}".replace("\0", "").strip()
        raise RuntimeError(f"{path.name} for {arch}: expected a source that compiles\n{said}") from error
    return bytes(code), log.text


class _Log:
    """Where NVRTC writes."""

    def __init__(self) -> None:
        self.text = ""

    def write(self, text: str) -> None:
        self.text += text


def _digest(source: str | Path, arch: str, defines: Mapping[str, int]) -> str:
    """Digest of everything that machine code is made from; every header counts, whether included or not."""
    digest = hashlib.sha256()
    files = [path for folder in FOLDERS for path in sorted(folder.iterdir()) if path.suffix in (".h", ".cu", "")]
    for path in (*files, source_path(source)):
        if path.is_file():
            digest.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    digest.update(repr((source_path(source).name, arch, sorted(defines.items()), nvrtc_versions())).encode())
    return digest.hexdigest()[:24]


def nvrtc_versions() -> list[str]:
    """The versions of NVRTC's packages, for CUDA 13 and 12; empty where one is not installed."""
    return [_version(name) for name in ("nvidia-cuda-nvrtc", "nvidia-cuda-nvrtc-cu12")]


def _version(package: str) -> str:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return ""
