"""tools/gpu_first_half_hour.sh runs every step, even if earlier ones fail; here with a fake Python interpreter."""

import hashlib
import os
import subprocess
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
MARK = "mark." + "gpu"
PYTHON = """#!/bin/bash
case "$*" in
    *"-m pip install"*) while [[ $1 != --target ]]; do shift; done; mkdir -p "$2/splatrl/conf"; echo >>"$2/installed" ;;
    *get_device_name*) echo "$GPU" ;;
    *get_device_capability*) echo sm_90 ;;
    *"gpu_steps.py load"*) exit $LOAD ;;
    *"gpu_steps.py thread"*) sleep $THREAD ;;
    *) echo "it ran $*" ;;
esac
"""


@pytest.fixture
def run(tmp_path: Path) -> Any:
    """A function that runs the script with a kit, and returns its exit status and the outcome of each step."""
    (tmp_path / "kit" / "wheels").mkdir(parents=True)
    (tmp_path / "kit" / "wheels" / "splatrl-0.whl").touch()
    (tmp_path / "kit" / "commit").write_text("a-commit\n")
    digest = hashlib.sha256((ROOT / "CMakeLists.txt").read_bytes()).hexdigest()
    (tmp_path / "kit" / "sources.sha256").write_text(f"{digest}  CMakeLists.txt\n")
    (tmp_path / "python").write_text(PYTHON)
    (tmp_path / "python").chmod(0o755)

    def run(*arguments: str, gpu: str = "A GPU", load: int = 0, thread: int = 0) -> tuple[int, dict[str, str]]:
        pretended = {"PYTHON": str(tmp_path / "python"), "GPU": gpu, "LOAD": str(load), "THREAD": str(thread)}
        done = subprocess.run(
            ["bash", str(ROOT / "tools" / "gpu_first_half_hour.sh"), *arguments],
            env={**os.environ, **pretended, "WORK": str(tmp_path / "work"), "OUT": str(tmp_path / "out")},
            cwd=tmp_path,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.stderr == "", done.stderr
        lines = (tmp_path / "out" / "steps.txt").read_text().splitlines()
        return done.returncode, {line[:40].rstrip(): line[42:] for line in lines}

    return lambda *arguments, **facts: run("--kit", "kit", *arguments, **facts)


def is_ok(ending: str) -> bool:
    return ending.startswith("ok, ") or ending in ("no compute-sanitizer, not run", "no ncu, not run")


def test_every_part_is_run_with_the_contents_of_the_kit(run: Any, tmp_path: Path) -> None:
    status, endings = run()
    assert status == 0 and all(is_ok(ending) for ending in endings.values()), endings
    marked = {str(path.relative_to(ROOT)) for path in (ROOT / "tests").rglob("test_*.py") if MARK in path.read_text()}
    assert {name for name in endings if name.startswith("tests/")} == marked
    assert list(endings)[:6] == ["versions", "load", "thread", "tiny", "frames", "twice"]
    assert {"benchmark: rendering", "profile: detail", "benchmark: rest"} <= endings.keys()
    log = (tmp_path / "out" / "log.txt").read_text()
    assert log.startswith("A GPU; a-commit\n") and "it ran benchmarks/gpu_kernels.py --count --arch sm_90\n" in log
    assert "--commit a-commit --only first use collision stepping training fit gsplat" in log
    assert (tmp_path / "work" / "site" / "splatrl" / "conf" / "train.yaml").is_file()
    run("learning")
    assert (tmp_path / "work" / "site" / "installed").read_text() == "\n"  # installed only once


def test_code_that_differs_from_the_wheels_is_reported(run: Any, tmp_path: Path) -> None:
    run("--seconds", "0")
    assert "pack the kit again" not in (tmp_path / "out" / "log.txt").read_text()
    (tmp_path / "kit" / "sources.sha256").write_text(f"{64 * '0'}  CMakeLists.txt\n")
    run("--seconds", "0")
    assert "pack the kit again" in (tmp_path / "out" / "log.txt").read_text()


def test_a_step_that_fails_or_hangs_does_not_stop_the_others(run: Any) -> None:
    status, endings = run("--seconds", "8", "correct", load=3, thread=60)
    assert status == 1
    assert endings["load"].startswith("failed with status 3, ") and endings["thread"].startswith("killed after ")
    assert endings["twice"] == "no time left"
    status, endings = run("correct", load=3)
    assert status == 1 and all(is_ok(ending) for name, ending in endings.items() if name != "load")


def test_without_a_gpu_the_steps_that_need_one_say_so(run: Any) -> None:
    status, endings = run(gpu="")
    assert status == 1 and endings.pop("versions").startswith("ok, ")
    assert all(ending == "no GPU, not run" or is_ok(ending) for ending in endings.values())
    assert endings["load"] == endings["tests/training/test_gpu.py"] == endings["benchmark: rest"] == "no GPU, not run"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--kit", "nothing"], "/nothing: expected a folder packed by tools/gpu_kit.sh"),
        (["all"], "all: expected one of correct learning rendering rest"),
        (["--seconds", "ten"], "--seconds ten: expected a number"),
        (["--fast"], "--fast: expected one of --kit, --out, --seconds, --dry-run"),
    ],
)
def test_an_invalid_argument_is_refused(tmp_path: Path, arguments: list[str], said: str) -> None:
    command = ["bash", str(ROOT / "tools" / "gpu_first_half_hour.sh"), *arguments]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (
        done.returncode == 1 and done.stderr.startswith("gpu_first_half_hour: ") and done.stderr.endswith(f"{said}\n")
    )
