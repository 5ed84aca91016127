"""Fixtures that several rooms share.

PyTorch and the package are imported where they are used, because the process that hands tests to workers needs neither.
"""

from __future__ import annotations

import functools
import gc
import importlib
import itertools
import os
import signal
import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    import torch

    from splatrl.scenes import Gaussians

for library in ("OMP", "NUMBA"):  # each worker has one core, and so has each program that tests start
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")

if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:  # as a shell leaves it for what it starts in the background
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    """Set PyTorch back to one thread, since TorchRL's parallel envs and collectors leave it with more."""
    import torch

    yield
    if torch.get_num_threads() != 1:
        torch.set_num_threads(1)


@pytest.fixture(scope="session")
def shared_scenes() -> Path:
    """Folder of the real captured scenes: $SPLATRL_SCENES, or ../shared/scenes beside the checkout."""
    folder = Path(os.environ.get("SPLATRL_SCENES", Path(__file__).parents[2] / "shared" / "scenes"))
    if not folder.is_dir():
        pytest.skip(f"real scenes not found at {folder}; set SPLATRL_SCENES to test with them")
    return folder


@pytest.fixture(scope="session")
def kitchen(shared_scenes: Path) -> Gaussians:
    """A captured kitchen, z up, in metres."""
    from splatrl.scenes import read_gaussians, similarity

    return read_gaussians(shared_scenes / "kitchen" / "kitchen.spz").transformed(similarity(["x", "-z", "y"]))


@pytest.fixture
def bare_report(monkeypatch: pytest.MonkeyPatch) -> None:
    """Captures leave out of their report what takes half their time, where a test looks at none of it: the pictures,
    and the number of solid voxels that cameras saw through."""
    import numpy as np

    for name in ("check.draw_comparison", "check.draw_map", "folder.draw_cameras", "folder.draw_goals"):
        monkeypatch.setattr(f"splatrl.capture.{name}", lambda *_: None)
    monkeypatch.setattr("splatrl.capture.check.seen_through", lambda occupancy, _: np.zeros(1, bool))


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """splatrl-scene leaves the pictures out, which take most of the time, where a test looks at none; they show what is
    read. Goals are looked for in a few places."""

    def draw_scene(*arguments: object) -> list[Path]:
        Path(str(arguments[4])).mkdir(parents=True, exist_ok=True)  # as the true one does
        return []

    monkeypatch.setattr("splatrl.capture.suggestions.MOST", 8)
    monkeypatch.setattr("splatrl.commands.scene.draw_scene", draw_scene)
    for name in ("draw_goals", "draw_terrain"):
        monkeypatch.setattr(f"splatrl.commands.scene.{name}", lambda *_: None)


@pytest.fixture
def ungrounded(undrawn: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Leaves out, too, the ground and boxes that robots with physics would meet, which take most of what is left."""
    monkeypatch.setattr("splatrl.commands.scene.show_terrain", lambda *_: None)


@pytest.fixture
def unmade_yards(monkeypatch: pytest.MonkeyPatch) -> None:
    """Configs of generated yards are composed without making the yards, half a second each where none is cached."""
    monkeypatch.setattr("splatrl.configuration.scene_files.make_yards", lambda _: None)
    stated = {"goal": [0.0, 1.0, 0.0], "object": [1.0, 1.0, 0.5]}
    monkeypatch.setattr("splatrl.configuration.scene_files.yard_proposals", lambda _: stated)


@pytest.fixture
def blank_curves(monkeypatch: pytest.MonkeyPatch) -> None:
    """Reports of experiments have empty files in place of learning curves, which a test does not look at."""
    monkeypatch.setattr("splatrl.experiments.report.learning_curves", lambda _, path: path.touch())


@pytest.fixture(scope="session")
def translated_once() -> Iterator[None]:
    """PyTorch's ONNX exporter gathers its translations of operations once, and not for each file."""
    from torch.onnx._internal.exporter._registration import ONNXRegistry

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(ONNXRegistry, "from_torchlib", staticmethod(functools.cache(ONNXRegistry.from_torchlib)))
        yield


def no_gpu() -> str:
    """The reason why nothing can run on a GPU here; empty if it can."""
    import torch

    return "" if torch.cuda.is_available() else "no CUDA device"


@pytest.fixture(scope="session")
def cuda_device() -> torch.device:
    """The GPU; tests that need it are marked ``gpu``, and are skipped if there is none."""
    import torch

    if no_gpu():
        pytest.skip(no_gpu())
    pytest.importorskip("cuda.bindings", reason="needs the extra cuda")
    return torch.device("cuda", torch.cuda.current_device())


def pytest_collection(session: pytest.Session) -> None:
    """Let each worker import another part of all test files first: what one has compiled, the others only read."""
    folder, worker = Path(__file__).parent, getattr(session.config, "workerinput", None)
    if worker is None or sys.dont_write_bytecode or session.config.args != ["tests"]:
        return
    files = sorted(folder.rglob("test_*.py"))
    first = len(files) * int(worker["workerid"].removeprefix("gw")) // worker["workercount"]
    for path in files[first:] + files[:first]:
        with suppress(Exception, pytest.skip.Exception):  # raised again when it is collected
            importlib.import_module(".".join(path.relative_to(folder.parent).with_suffix("").parts))


def pytest_collection_finish() -> None:
    """Leave what is imported by now out of every later search for garbage, search less often, and do twice nothing
    that gives the same again and again: parse YAML, spread Gaussians over robots, and make the backyard."""
    from tests.gaussians_once import backyard_once, spread_once
    from tests.yaml_once import parse_once

    parse_once()
    spread_once()
    backyard_once()
    gc.collect()
    gc.freeze()
    gc.set_threshold(20_000, 20, 20)


LONG_RUN, LISTED = 60.0, 8
"""Seconds of tests from which a run ends with the files that took longest, and their number."""


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """Report which files took longest, and on which device the tests of ``-m gpu`` ran, or that they did not run."""
    seconds: Counter[str] = Counter()
    for report in itertools.chain(*terminalreporter.stats.values()):
        if isinstance(report, pytest.TestReport):
            seconds[report.nodeid.partition("::")[0]] += report.duration
    if sum(seconds.values()) > LONG_RUN:
        listed = [f"{spent:.0f} s {path}" for path, spent in seconds.most_common(LISTED)]
        terminalreporter.write_line(f"of {sum(seconds.values()):.0f} s in tests: {', '.join(listed)}")
    if "gpu" in (config.option.markexpr or "").replace("not gpu", ""):
        import torch

        where = f"{no_gpu()}: nothing that needs one was tested" if no_gpu() else ""
        terminalreporter.write_line(where or f"tested on {torch.cuda.get_device_name()}")
