"""Run tests with a core that is built with the compiler's address and undefined-behaviour sanitizers.

    python -m tests.sanitized                       # the C++ core's tests and damaged files of every format
    python -m tests.sanitized tests/collision -x    # some tests, with any arguments of pytest

The build stays in the temporary folder and is recompiled where sources have changed. Any finding aborts the process
with a report. Needs GCC; leaks are not detected, since Python and torch leave much memory unfreed at exit.
"""

import hashlib
import os
import subprocess
import sys
import tempfile
import venv
from pathlib import Path

import torch

ROOT = Path(__file__).parents[1]
FLAGS = "-fsanitize=address,undefined -fno-sanitize=vptr -fno-sanitize-recover=undefined -fno-omit-frame-pointer -g1"
TESTS = ["tests/native", "tests/collision", "tests/renderers", "tests/capture/test_fit.py", "tests/test_fuzzing.py"]
ALONE = ["-n", "0", "--capture=sys", "-p", "no:cacheprovider", "-m", "not slow and not gpu"]
LEFT_OUT = "emulated or test_compiler or threads_that_cannot_start or png-60 or sprite-60 or depth-60"
"""Excluded tests: CUDA sources are compiled by other tools, the sanitizer's shadow memory does not fit under a limit on
the address space, and large images, which the core does not read, take more memory with it than the tests allow."""


def environment() -> tuple[Path, Path]:
    """Return the Python of an environment with this one's packages and a sanitized splatrl, and the build's folder."""
    folder = Path(tempfile.gettempdir()) / f"splatrl-sanitized-{hashlib.sha256(str(ROOT).encode()).hexdigest()[:12]}"
    python = folder / "env" / "bin" / "python"
    if not python.exists():
        venv.create(folder / "env", with_pip=False, symlinks=True)
    packages = next((folder / "env" / "lib").glob("python*")) / "site-packages"
    (packages / "others.pth").write_text(f"{Path(torch.__file__).parents[1]}\n")
    install = [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--no-build-isolation", "--upgrade"]
    settings = {"build-dir": folder / "build", "cmake.define.CMAKE_CXX_FLAGS": FLAGS, "install.strip": "false"}
    chosen = [f"-C{key}={value}" for key, value in settings.items()]
    subprocess.run([*install, "--target", str(packages), *chosen, str(ROOT)], check=True)
    return python, packages


def preloaded() -> str:
    """Return the sanitizers' libraries, which must be loaded before anything else."""
    names = ("libasan.so", "libubsan.so")
    found = [subprocess.check_output(["gcc", f"-print-file-name={name}"], text=True).strip() for name in names]
    return ":".join(found)


def main() -> int:
    """Build splatrl, run pytest, and return its exit status."""
    python, packages = environment()
    watching = {
        "LD_PRELOAD": preloaded(),
        "ASAN_OPTIONS": "detect_leaks=0:abort_on_error=1",
        "UBSAN_OPTIONS": "print_stacktrace=1",
        "PYTHONSAFEPATH": "1",  # import the build, not the sources
        "PYTHONPATH": f"{packages}:{ROOT}",  # the root last, only for the tests
    }
    asked = sys.argv[1:] or TESTS
    command = [str(python), "-c", RUN, *ALONE, "-k", f"not ({LEFT_OUT})", *asked]
    return subprocess.run(command, cwd=ROOT, env={**os.environ, **watching}).returncode


RUN = """
import sys, pytest, splatrl
print("splatrl from", splatrl.__path__[0])
sys.exit(pytest.main(sys.argv[1:]))
"""

if __name__ == "__main__":
    sys.exit(main())
