"""benchmarks/gpu.py runs from beginning to end, and loses nothing when a part of it fails."""

import importlib
import json
import math
import sys
import time
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import torch

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "benchmarks" / "results"
EVERYTHING = {
    "first use",
    "rendering",
    "effort",
    "likeness",
    "collision",
    "agreement",
    "stepping",
    "training",
    "fit",
    "target",
}


@pytest.fixture
def benchmark(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Imports modules of benchmarks/."""
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    return importlib.import_module


def test_a_dry_run_measures_everything_and_leaves_no_result(
    tmp_path: Path, benchmark: Any, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("cuda.core", reason="needs the extra cuda to compile kernels")
    before = {path: path.stat().st_mtime_ns for path in RESULTS.iterdir()}
    gpu = benchmark("gpu")
    monkeypatch.setattr(gpu, "SPARE", 900)  # a machine that does other things as well may be as slow as it likes
    monkeypatch.setattr(sys, "argv", ["gpu.py", "--dry-run", "--folder", str(tmp_path)])
    code, said = gpu.main(), capsys.readouterr().out
    assert code == 0, said
    assert "no number here is a measurement" in said
    assert "reach (H200)" in said
    (path,) = tmp_path.glob("*.json")
    record = json.loads(path.read_text())
    assert {row["what"] for row in record["results"]} == EVERYTHING | {"target"}
    assert all(math.isfinite(row["found"]) for row in record["results"] if row["what"] == "target")
    assert not any(row["different"] for row in record["results"] if row["what"] == "agreement")
    assert all(row["cosine"] > 0.9999 for row in record["results"] if row["what"] == "fit")
    likenesses = [row for row in record["results"] if row["what"] == "likeness"]
    assert all(row["mean_db"] > (50 if row["against"] == "exact" else 60) for row in likenesses)
    assert record["machine"]["name"] == "CPU" and path.name.endswith("-cpu-gpu.json")
    assert path.with_suffix(".png").stat().st_size > 10_000
    assert {path: path.stat().st_mtime_ns for path in RESULTS.iterdir()} == before


def test_the_picture_of_a_run_of_few_sections_has_empty_panels(tmp_path: Path, benchmark: Any) -> None:
    bench = benchmark("gpu_bench").DryRun()
    reach = benchmark("gpu_reach").targets(bench)
    benchmark("gpu_figure").draw(bench, reach, "nothing was measured", tmp_path / "empty.png")
    assert (tmp_path / "empty.png").stat().st_size > 10_000


def test_a_dry_run_keeps_out_of_the_results(benchmark: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["gpu.py", "--dry-run", "--only", "gsplat", "--folder", str(RESULTS)])
    with pytest.raises(SystemExit, match="expected a folder other than that of results"):
        benchmark("gpu").main()


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_without_a_gpu_it_says_so(
    benchmark: Any, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["gpu.py"])
    assert benchmark("gpu").main() == 1
    assert "no CUDA device: nothing was measured" in capsys.readouterr().out


def test_a_section_that_fails_or_hangs_leaves_the_others_alone(
    benchmark: Any, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    gpu: ModuleType = benchmark("gpu")
    bench, ran = benchmark("gpu_bench").DryRun(), []

    def broken(_: object) -> None:
        bench.results.append("half")
        raise RuntimeError("a kernel went wrong")

    def sleepy(_: object) -> None:
        time.sleep(30)

    for name, section in (("first_use", broken), ("collision", sleepy), ("training", ran.append)):
        monkeypatch.setattr(gpu, name, section)
    monkeypatch.setattr(gpu, "SECONDS", dict.fromkeys(gpu.SECONDS, 0.1))
    monkeypatch.setattr(gpu, "SPARE", 0.2)
    failed = gpu.run(bench, None, ["first use", "collision", "training"])
    assert failed == ["first use", "collision"] and ran == [bench] and bench.results == ["half"]
    assert "a kernel went wrong" in bench.notes[0] and "TimeoutError: took longer than" in bench.notes[1]
    assert "a kernel went wrong" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("name", "slug"),
    [("NVIDIA H200", "h200"), ("NVIDIA GeForce RTX 4090", "rtx-4090"), ("NVIDIA H100 80GB HBM3", "h100-80gb-hbm3")],
)
def test_results_are_named_after_the_device(benchmark: Any, name: str, slug: str) -> None:
    machine = benchmark("gpu_device").Machine(name, "sm_90", 1, 1, "", "", "", 1.0, 1.0)
    assert machine.slug == slug


@pytest.mark.parametrize(
    ("unit", "found", "verdict"),
    [
        ("/s", 9.0, "missed"),
        ("/s", 10.0, "reached"),
        ("/s", 50.0, "aim reached"),
        ("s", 11.0, "missed"),
        ("s", 10.0, "reached"),
        ("s", 5.0, "aim reached"),
        ("s", math.nan, "not measured"),
    ],
)
def test_targets_are_judged_by_what_is_better(benchmark: Any, unit: str, found: float, verdict: str) -> None:
    aim = 5.0 if unit == "s" else 50.0
    assert benchmark("gpu_reach").Target("", unit, 10.0, aim, found).verdict == verdict


def test_rounds_are_as_many_as_there_is_time_for(benchmark: Any) -> None:
    in_turns, calls = benchmark("gpu_device").in_turns, []
    both = {"a": lambda: calls.append("a"), "b": lambda: (calls.append("b"), time.sleep(0.02))}
    found = in_turns(both, torch.device("cpu"), 0.0)
    assert calls == ["a", "b"] * 2 and [len(times) for times in found.values()] == [1, 1]
    found = in_turns(both, torch.device("cpu"), 60.0)
    assert len(found["a"]) == len(found["b"]) == 9 and min(found["b"]) >= 0.02


@pytest.mark.parametrize("arch", ["sm_80", "sm_90", "sm_120"])
def test_the_kernel_of_the_rate_compiles(benchmark: Any, arch: str) -> None:
    pytest.importorskip("cuda.core")
    from splatrl.native.cuda.compiler import translated

    device = benchmark("gpu_device")
    code, log = translated(device.RATE, arch, {"CHAINS": device.CHAINS, "STEPS": device.STEPS})
    assert code[:4] == b"\x7fELF" and "0 bytes spill stores" in log


def test_the_bound_grows_with_every_count(benchmark: Any) -> None:
    machine = benchmark("gpu_device").Machine("", "", 1, 1, "", "", "", 1e12, 1e12)
    bound_us = benchmark("gpu_bound").bound_us
    counts = [100.0, 40.0, 300.0]
    base = bound_us(machine, *counts, 3, 64 * 64)
    for place in range(3):
        more = [count * (1 + (place == other)) for other, count in enumerate(counts)]
        assert bound_us(machine, *more, 3, 64 * 64)[0] > base[0]
    assert bound_us(machine, 0, 0, 1, 0, 0) == (32 * 22 / 1e6, 0.0)  # a patch: 22 operations a pixel
