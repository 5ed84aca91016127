"""tools/gpu_kit.sh packs everything that is needed, and reports problems of a kit; no test here needs a network."""

import importlib.metadata
import os
import re
import subprocess
import tarfile
from pathlib import Path
from typing import Any

import pytest
from packaging.requirements import Requirement

ROOT = Path(__file__).parents[2]
SCRIPT = ROOT / "tools" / "gpu_kit.sh"
THERE = ("torch", "numpy", "scipy", "matplotlib", "pillow", "tqdm", "nvidia-cuda-nvrtc")
"""Packages that the GPU machine already has, together with their dependencies."""
NEEDLESS = {"av", "cython"}
"""Dependencies that are left out: av is only for videos, and python-fcl requires cython without importing it."""


def run(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    command = ["bash", str(SCRIPT), *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False, env={**os.environ, **environment})


def listed() -> list[str]:
    """Return the packages that the script packs."""
    found = re.search(r"^PACKAGES=\((.*?)\)", SCRIPT.read_text(), re.MULTILINE | re.DOTALL)
    assert found is not None
    return found.group(1).split()


def canonical(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def required(*roots: str) -> set[str]:
    """Return the names of some requirements and of all their dependencies in the environment of the tests."""
    found: set[str] = set()
    left = [Requirement(root) for root in roots]
    while left:
        one = left.pop()
        found.add(canonical(one.name))
        for line in importlib.metadata.requires(one.name) or []:
            need = Requirement(line)
            extras = ("", *one.extras)
            applies = need.marker is None or any(need.marker.evaluate({"extra": extra}) for extra in extras)
            if applies and (canonical(need.name) not in found or need.extras):
                left.append(need)
    return found


@pytest.fixture
def kit(tmp_path: Path) -> Path:
    """A kit of empty files."""
    (tmp_path / "kit" / "wheels").mkdir(parents=True)
    for name in ("splatrl", *listed()):
        (tmp_path / "kit" / "wheels" / f"{name.replace('-', '_')}-1.0-py3-none-any.whl").touch()
    (tmp_path / "kit" / "kernels.tar.gz").touch()
    return tmp_path / "kit"


def test_every_dependency_is_packed_or_already_on_the_machine() -> None:
    needed = required("splatrl[cuda]", "pytest", "hypothesis") - required(*THERE) - NEEDLESS - {"splatrl"}
    assert needed <= {canonical(name) for name in listed()}, "add it to PACKAGES of tools/gpu_kit.sh"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--arch", "h100"], "--arch h100: expected an architecture such as sm_90"),
        (["--limit", "many"], "--limit many: expected a number of MiB"),
        (["--limit"], "--limit: expected a value"),
        (["--where"], "--where: expected one of --python, --arch, --folder, --limit"),
        (["wheels"], "wheels: expected one of project packages kernels kitchen check"),
        (["--python", "3.0", "project"], "--python 3.0: found no working interpreter"),
        (["--python", "/no/such/python", "packages"], "--python /no/such/python: found no working interpreter"),
    ],
)
def test_an_invalid_argument_is_refused_in_one_line(tmp_path: Path, arguments: list[str], said: str) -> None:
    done = run("--folder", str(tmp_path), *arguments)
    assert done.returncode == 1 and done.stdout == ""
    assert done.stderr.startswith(f"gpu_kit: {said}") and done.stderr.count("\n") == 1


def test_help_says_what_each_option_is_for() -> None:
    said = run("--help").stdout
    assert all(option in said for option in ("--python", "--arch", "--folder", "--limit", "check"))
    assert "#" not in said and "PACKAGES" not in said


def test_a_missing_scene_is_left_out_and_reported(tmp_path: Path) -> None:
    done = run("--folder", str(tmp_path), "kitchen", SPLATRL_SCENES=str(tmp_path / "none"))
    assert done.returncode == 0 and done.stdout.startswith("kitchen: left out, found no ")
    assert not (tmp_path / "scenes").exists()


def test_a_scene_is_packed_from_the_folder_of_scenes(tmp_path: Path) -> None:
    (tmp_path / "kitchen").mkdir()
    (tmp_path / "kitchen" / "kitchen.spz").write_bytes(b"splats")
    done = run("--folder", str(tmp_path / "kit"), "kitchen", SPLATRL_SCENES=str(tmp_path))
    assert (done.returncode, done.stdout) == (0, "")
    assert (tmp_path / "kit" / "scenes" / "kitchen" / "kitchen.spz").read_bytes() == b"splats"


def test_a_complete_kit_is_listed_with_its_size(kit: Path) -> None:
    done = run("--folder", str(kit), "check")
    assert done.returncode == 0, done.stderr
    assert "torchrl-1.0-py3-none-any.whl" in done.stdout
    assert re.search(rf"0\.0 MiB  in {re.escape(str(kit))}, [0-9.]+ MiB with the checkout\n$", done.stdout)


def test_a_kit_that_is_too_large_is_refused_in_one_line(kit: Path) -> None:
    os.truncate(kit / "kernels.tar.gz", 70 * 2**20)
    done = run("--folder", str(kit), "check")
    assert done.returncode == 1 and done.stderr.count("\n") == 1
    assert re.search(r"expected at most 64 MiB with the checkout, got [7-9][0-9]\.[0-9] MiB$", done.stderr.strip())
    assert run("--folder", str(kit), "--limit", "200", "check").returncode == 0


@pytest.mark.parametrize("name", ["splatrl", "cuda-core", "kernels.tar.gz"])
def test_a_missing_part_of_a_kit_is_named(kit: Path, name: str) -> None:
    (path,) = kit.rglob(f"{name.replace('-', '_')}*")
    path.unlink()
    done = run("--folder", str(kit), "check")
    assert done.returncode == 1 and done.stderr.count("\n") == 1
    assert done.stderr.startswith(f"gpu_kit: {name.partition('.')[0]}: expected ")


def test_two_wheels_of_one_package_are_refused(kit: Path) -> None:
    (kit / "wheels" / "cuda_core-2.0-py3-none-any.whl").touch()
    assert "cuda-core: expected one wheel in " in run("--folder", str(kit), "check").stderr


@pytest.fixture
def gpu_kernels(monkeypatch: pytest.MonkeyPatch) -> Any:
    """The module benchmarks/gpu_kernels.py."""
    pytest.importorskip("cuda.core", reason="needs the extra cuda to compile kernels")
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    return importlib.import_module("gpu_kernels")


def test_every_kernel_is_packed(gpu_kernels: Any) -> None:
    from tests.native.test_compiler import SOURCES

    packed = [(str(source), defines) for source, defines in gpu_kernels.kernels()]
    assert all((name, defines) in packed for name, many in SOURCES.items() for defines in many)


def test_packed_kernels_are_found_in_another_cache(
    gpu_kernels: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    few = [("place", {}), (gpu_kernels.RATE, {"CHAINS": 1, "STEPS": 1})]
    monkeypatch.setattr(gpu_kernels, "kernels", lambda: few)
    archive, caches = tmp_path / "kernels.tar.gz", [tmp_path / "here", tmp_path / "there"]

    def kept(cache: Path, *options: str) -> str:
        monkeypatch.setenv("SPLATRL_CACHE", str(cache))
        monkeypatch.setattr("sys.argv", ["gpu_kernels.py", *options])
        gpu_kernels.main()
        return capsys.readouterr().out.partition(" for ")[0]

    assert kept(caches[0], "--archive", str(archive)) == "kernels: 2 of 2"
    assert kept(caches[1], "--count") == "kernels: 0 of 2"
    with tarfile.open(archive) as packed:
        packed.extractall(caches[1], **({"filter": "data"} if hasattr(tarfile, "data_filter") else {}))  # since 3.11.4
    assert kept(caches[1], "--count") == "kernels: 2 of 2"
