"""benchmarks/gpu.py runs from beginning to end, and loses no results when a part of it fails."""

import json
import math
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch

from splatrl.native.cuda import compiler
from tests.native.kept import kept
from tests.preloaded import Process, start

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "benchmarks" / "results"
EVERYTHING = {
    "section",
    "first use",
    "rendering",
    "effort",
    "likeness",
    "collision",
    "agreement",
    "stepping",
    "training",
    "fit",
    "town",
    "target",
}


def test_a_dry_run_measures_everything_and_leaves_no_result(
    tmp_path: Path, benchmark: Any, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("cuda.core", reason="needs the extra cuda to compile kernels")
    before = {path: path.stat().st_mtime_ns for path in RESULTS.iterdir()}
    gpu, section = benchmark("gpu"), benchmark("gpu_sections").Section

    def measure_here(name: str, dry: bool, folder: Path, ends: float, bench: Any) -> None:
        now = time.monotonic()  # no time is left, so every call is timed in one round only
        gpu.measure(name, dry, folder, now)  # in this process, which saves seconds per section
        bench.keep(section(name, "done", 0.0))

    monkeypatch.setattr(gpu, "measure_apart", measure_here)
    monkeypatch.setattr(compiler, "translated", kept)
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


def test_the_figure_has_a_panel_for_each_kind_of_result_and_no_empty_one(
    tmp_path: Path, benchmark: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench, figure, drawn = benchmark("gpu_bench").DryRun(), benchmark("gpu_figure"), []
    canvas = figure.FigureCanvasAgg
    monkeypatch.setattr(figure, "FigureCanvasAgg", lambda each: drawn.append(each) or canvas(each))
    figure.draw(bench, benchmark("gpu_reach").targets(bench), "nothing was measured", tmp_path / "empty.png")
    assert not drawn and not (tmp_path / "empty.png").exists()
    speed = benchmark("gpu_device").Rate(1000.0, 900.0, 1100.0)
    bench.results.append(benchmark("gpu_training").Training("backyard", 0.5, 64, 512, 128, 4, speed, speed))
    figure.draw(bench, benchmark("gpu_reach").targets(bench), "PPO", tmp_path / "ppo.png")
    bench.results.append(benchmark("gpu_render").Rendering("CudaRenderer", "yard", 10, 0, 0.0, 64, speed, 0))
    figure.draw(bench, benchmark("gpu_reach").targets(bench), "PPO and rendering", tmp_path / "both.png")
    assert [[axes.get_title() for axes in one.axes] for one in drawn] == [["Targets"], ["Rendering", "Targets"]]
    assert [label.get_text() for label in drawn[0].axes[0].get_yticklabels()] == ["PPO frames/s end to end,\nFPS task"]
    assert (tmp_path / "both.png").stat().st_size > 10_000


def test_a_dry_run_refuses_to_write_into_the_folder_of_results(benchmark: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["gpu.py", "--dry-run", "--only", "gsplat", "--folder", str(RESULTS)])
    with pytest.raises(SystemExit, match="expected a folder other than that of results"):
        benchmark("gpu").main()


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_without_a_gpu_the_benchmark_says_so(
    benchmark: Any, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["gpu.py"])
    assert benchmark("gpu").main() == 1
    assert "no CUDA device: nothing was measured" in capsys.readouterr().out


RUN_FILE = """
import os, runpy, sys
os.setsid()
sys.argv.pop(0)
sys.path.insert(0, os.path.dirname(sys.argv[0]))
runpy.run_path(sys.argv[0], run_name="__main__")
"""
"""Runs a file as ``python FILE`` does, in its own session."""


def test_a_section_is_measured_in_a_process_of_its_own(
    tmp_path: Path, benchmark: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    gpu, bench = benchmark("gpu"), benchmark("gpu_bench").DryRun()

    def begun(command: list[str], env: dict[str, str], **_: object) -> Process:
        return start("-c", RUN_FILE, *command[1:], env=env)

    if sys.platform == "linux":  # elsewhere, start() is no faster than Popen
        begins = SimpleNamespace(**{**vars(subprocess), "Popen": begun})
        monkeypatch.setattr(benchmark("gpu_sections"), "subprocess", begins)
    gpu.measure_apart("machine", True, tmp_path, time.monotonic() + 900, bench)
    assert [(row.name, row.ending) for row in bench.results] == [("machine", "done")], bench.notes
    bench.read(tmp_path / "machine")
    assert gpu.machine_of(bench).name == "CPU" and gpu.machine_of(bench).flops > 0


SECTIONS = """
import os, pickle, sys, time

def find(*results):
    with open(os.path.join(folder, name), "wb") as file:
        pickle.dump((list(results), ["a note"]), file)

_, _, name, folder, ends = sys.argv
if name == "machine":
    raise RuntimeError("a kernel went wrong")
elif name == "first use":
    sys.path.insert(0, {benchmarks!r})
    from gpu_sections import Section  # any result
    find(Section("half", "done", 1.0))
    time.sleep(60)
elif name == "rendering":
    print("illegal access", flush=True)
    os.abort()
else:
    find()
"""
"""A program that stands in for gpu.py when a section is run."""


@pytest.fixture
def odd_sections(tmp_path: Path, benchmark: Any, monkeypatch: pytest.MonkeyPatch) -> Any:
    """The module gpu.py, with sections that raise, hang and crash."""
    gpu = benchmark("gpu")
    (tmp_path / "sections.py").write_text(SECTIONS.replace("{benchmarks!r}", repr(str(ROOT / "benchmarks"))))
    monkeypatch.setattr(gpu, "__file__", str(tmp_path / "sections.py"))
    monkeypatch.setattr(gpu, "bench_of", lambda dry: benchmark("gpu_bench").Bench(torch.device("cpu")))
    monkeypatch.setattr(gpu, "SECONDS", {"machine": 60, "first use": -57, "rendering": 60, "collision": 0})
    monkeypatch.setattr(gpu, "SPARE", 0)
    return gpu


def test_a_section_that_raises_hangs_or_crashes_leaves_the_others_alone(tmp_path: Path, odd_sections: Any) -> None:
    run = odd_sections.Run(False, tmp_path, "a commit")
    run.go(["first use", "rendering", "collision"])
    record = json.loads((tmp_path / f"{odd_sections.today()}-unknown-gpu-gpu.json").read_text())
    found = {row["name"]: row["ending"] for row in record["results"] if row["what"] == "section"}
    assert found.pop("half") == "done" and found.pop("first use").startswith("killed after ")
    assert found == {"machine": "failed", "rendering": "ended by SIGABRT", "collision": "done"}
    said = {note.partition(":")[0]: note for note in record["notes"]}
    assert "RuntimeError: a kernel went wrong" in said["machine"] and "illegal access" in said["rendering"]
    assert list(said) == ["machine", "first use", "a note", "rendering"]
    run.finish()
    assert not list(tmp_path.glob("*.png"))  # nothing was measured


def test_results_are_written_after_each_section_and_when_interrupted(
    tmp_path: Path, odd_sections: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    section, seen = odd_sections.Section, []

    def measure(name: str, dry: bool, folder: Path, ends: float, bench: Any) -> None:
        seen.append([json.loads(path.read_text()) for path in tmp_path.glob("*.json")])
        if name == "rendering":
            raise KeyboardInterrupt
        bench.keep(section(name, "done", 1.0))

    monkeypatch.setattr(odd_sections, "measure_apart", measure)
    odd_sections.Run(False, tmp_path, None).go(["first use", "rendering", "collision"])
    endings = [[row["name"] for row in record["results"] if row["what"] == "section"] for (record,) in seen[1:]]
    assert seen[0] == [] and endings == [["machine"], ["machine", "first use"]]
    (path,) = tmp_path.glob("*.json")
    assert json.loads(path.read_text())["notes"] == ["rendering: interrupted, and with it the run"]


@pytest.mark.parametrize("interrupted", [False, True])
def test_processes_that_a_section_started_are_killed_with_it(tmp_path: Path, benchmark: Any, interrupted: bool) -> None:
    run_section = benchmark("gpu_sections").run_section
    script = f"sleep 60 & echo $! > {tmp_path}/started; {'wait' if interrupted else 'exit 3'}"
    before = signal.signal(signal.SIGALRM, signal.default_int_handler)
    try:
        if interrupted:
            signal.setitimer(signal.ITIMER_REAL, 1.0)
            with pytest.raises(KeyboardInterrupt):
                run_section("a", ["sh", "-c", script], 60)
        else:
            assert run_section("a", ["sh", "-c", script], 60)[0].ending == "failed"
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
    assert ended(int((tmp_path / "started").read_text()))


def ended(process: int) -> bool:
    """Return whether a process ends within ten seconds; a zombie counts, as its new parent may be slow to reap it."""
    for _ in range(200):
        try:
            if Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] == "Z":
                return True
        except OSError:
            return True
        time.sleep(0.05)
    os.kill(process, signal.SIGKILL)
    return False


@pytest.mark.parametrize("step", ["load", "thread", "tiny", "frames", "twice", "launch"])
def test_each_first_step_can_be_run_as_a_dry_run(
    benchmark: Any, step: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["gpu_steps.py", step, "--dry-run"])
    benchmark("gpu_steps").main()
    assert capsys.readouterr().out


def test_a_first_step_that_finds_a_fault_reports_it(benchmark: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    steps, bench = benchmark("gpu_steps"), benchmark("gpu_bench").DryRun()
    pixels, drawn = steps.NativeRenderer.pixels, []
    monkeypatch.setattr(steps.NativeRenderer, "pixels", lambda *all: 255 - pixels(*all))
    with pytest.raises(SystemExit, match=r"expected at least 99.99% and 60 dB"):
        steps.frames(bench, 0.5)
    threads: list[str] = []
    monkeypatch.setattr(steps, "first_query", lambda bench: threads.append(threading.current_thread().name) or 1 / 0)
    with pytest.raises(ZeroDivisionError):
        steps.thread(bench, 0.5)
    assert threads != ["MainThread"]
    renderer = type(bench.renderer(bench.fitted("").scene))
    ours = renderer.pixels

    def changing(*all: Any) -> torch.Tensor:
        drawn.append(0)
        return ours(*all) + len(drawn) // 2

    monkeypatch.setattr(renderer, "pixels", changing)
    with pytest.raises(SystemExit, match="expected the same bytes"):
        steps.twice(bench, 0.5)


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_without_a_gpu_no_step_is_run(benchmark: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["gpu_steps.py", "load"])
    with pytest.raises(SystemExit, match="no CUDA device: nothing was tried"):
        benchmark("gpu_steps").main()


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
def test_targets_are_judged_by_whether_more_or_less_is_better(
    benchmark: Any, unit: str, found: float, verdict: str
) -> None:
    aim = 5.0 if unit == "s" else 50.0
    assert benchmark("gpu_reach").Target("", unit, 10.0, aim, found).verdict == verdict


def test_there_are_as_many_rounds_as_the_time_allows(benchmark: Any) -> None:
    in_turns, calls = benchmark("gpu_device").in_turns, []
    both = {"a": lambda: calls.append("a"), "b": lambda: (calls.append("b"), time.sleep(0.02))}
    found = in_turns(both, torch.device("cpu"), 0.0)
    assert calls == ["a", "b"] * 2 and [len(times) for times in found.values()] == [1, 1]
    found = in_turns(both, torch.device("cpu"), 60.0)
    assert len(found["a"]) == len(found["b"]) == 9 and min(found["b"]) >= 0.02


@pytest.mark.parametrize("arch", ["sm_80", "sm_90", "sm_120"])
def test_the_kernel_that_measures_the_rate_of_operations_compiles(benchmark: Any, arch: str) -> None:
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
    assert bound_us(machine, 0, 0, 1, 0, 0) == (8 * 22 / 1e6, 0.0)  # one cell of 8 pixels, with 22 operations each
