"""Fixtures that the tests of several packages share.

PyTorch and splatrl are imported where they are used, because the process that hands tests to workers needs neither.
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
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import settings

if TYPE_CHECKING:
    import torch

    from splatrl.scenes import Gaussians

settings.register_profile("untimed", deadline=None)  # a busy machine may take any time
settings.load_profile("untimed")

for library in ("OMP", "NUMBA"):  # one core for each worker, and for each program that a test starts
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")

if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:  # as shells set it for background jobs
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    """Reset PyTorch to one thread after each test, since TorchRL's parallel envs and collectors leave it with more."""
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
    """Omit the slow parts of capture reports, half of a capture's time, for tests that look at none of them: the
    pictures, and the number of solid voxels that cameras saw through."""
    import numpy as np

    for name in (
        "check.comparison_line",
        "check.draw_comparison",
        "check.draw_map",
        "folder.draw_cameras",
        "folder.draw_goals",
    ):
        monkeypatch.setattr(f"splatrl.capture.{name}", lambda *_: None)
    monkeypatch.setattr("splatrl.capture.check.seen_through", lambda occupancy, _: np.zeros(1, bool))


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make splatrl-scene omit the pictures of what it reads, which take most of its time, for tests that look at none,
    and search for goals in only a few places."""
    monkeypatch.setattr("splatrl.capture.suggestions.MOST", 8)
    for kind in ("of_scene", "of_goals", "of_terrain"):
        monkeypatch.setattr(f"splatrl.capture.inspection.ScenePictures.{kind}", lambda *_: [])


@pytest.fixture
def ungrounded(undrawn: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also omit the ground and boxes that robots with physics would touch, which take most of the remaining time."""
    monkeypatch.setattr("splatrl.capture.inspection.inspect_terrain", lambda *_: [])


@pytest.fixture
def unproposed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw nothing, and propose nothing but the scene's bounds, for tests that look at none of it."""
    from splatrl.capture.inspection import Proposed

    monkeypatch.setattr("splatrl.capture.inspection.inspect_occupancy", lambda *_: (None, []))
    monkeypatch.setattr("splatrl.capture.inspection.inspect_terrain", lambda *_: [])
    monkeypatch.setattr("splatrl.capture.inspection.propose", lambda scene, *_: Proposed(scene.bounds, {}, []))


@pytest.fixture
def unmade_yards(monkeypatch: pytest.MonkeyPatch) -> None:
    """Compose configs of generated yards without making the yards, which takes half a second each unless cached."""
    monkeypatch.setattr("splatrl.configuration.scene_files.make_yards", lambda _: None)
    stated = {"goal": [0.0, 1.0, 0.0], "object": [1.0, 1.0, 0.5]}
    monkeypatch.setattr("splatrl.configuration.scene_files.yard_proposals", lambda _: stated)


@pytest.fixture
def blank_curves(monkeypatch: pytest.MonkeyPatch) -> None:
    """Write empty files in place of the learning curves of experiments, for tests that do not look at them."""
    monkeypatch.setattr("splatrl.experiments.report.learning_curves", lambda _, path: path.touch())


@pytest.fixture(scope="session", autouse=True)
def unflushed() -> Iterator[None]:
    """Leave what is written to the system's cache: waiting for the disk takes milliseconds per file, and guards only
    against power cuts."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(os, "fsync", lambda _: None)
        yield


@pytest.fixture(scope="session", autouse=True)
def quick_videos() -> Iterator[dict[str, str]]:
    """Encode videos at x264's fastest preset, in a third of the time; the value is the options that users get."""
    video: Any = sys.modules.get("splatrl.evaluation.encoding")
    own = {} if video is None else video.X264
    with pytest.MonkeyPatch.context() as patched:
        if video is not None:  # the tests to run may encode no video
            patched.setattr(video, "X264", own | {"preset": "ultrafast"})
        yield own


@pytest.fixture
def usual_videos(quick_videos: dict[str, str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Encode videos as users do, for tests of the encoder's options."""
    if quick_videos:  # else they were never changed
        monkeypatch.setattr("splatrl.evaluation.encoding.X264", quick_videos)


@pytest.fixture(scope="session")
def translated_once() -> Iterator[None]:
    """Let PyTorch's ONNX exporter collect its translations of operators once, instead of once per file."""
    from torch.onnx._internal.exporter._registration import ONNXRegistry

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(ONNXRegistry, "from_torchlib", staticmethod(functools.cache(ONNXRegistry.from_torchlib)))
        yield


def no_gpu() -> str:
    """Return the reason why nothing can run on a GPU here, or an empty string if it can."""
    import torch

    return "" if torch.cuda.is_available() else "no CUDA device"


@pytest.fixture(scope="session")
def cuda_device() -> torch.device:
    """The GPU. Tests that need one are marked ``gpu``, and are skipped if there is none."""
    import torch

    if no_gpu():
        pytest.skip(no_gpu())
    pytest.importorskip("cuda.bindings", reason="needs the extra cuda")
    return torch.device("cuda", torch.cuda.current_device())


def pytest_collection(session: pytest.Session) -> None:
    """Let each worker import a different part of the test files first, so that the others find cached bytecode."""
    folder, worker = Path(__file__).parent, getattr(session.config, "workerinput", None)
    if worker is None or sys.dont_write_bytecode or session.config.args != ["tests"]:
        return
    files = sorted(folder.rglob("test_*.py"))
    first = len(files) * int(worker["workerid"].removeprefix("gw")) // worker["workercount"]
    for path in files[first:] + files[:first]:
        with suppress(Exception, pytest.skip.Exception):  # collection will raise it again
            importlib.import_module(".".join(path.relative_to(folder.parent).with_suffix("").parts))


def pytest_collection_finish() -> None:
    """Exclude everything imported so far from garbage collection, collect less often, and cache work that would be
    repeated with the same result: parsing YAML, spreading Gaussians over robots, and making the backyard."""
    from tests.gaussians_once import backyard_once, spread_once
    from tests.yaml_once import compose_once, parse_once

    parse_once()
    compose_once()
    spread_once()
    backyard_once()
    gc.collect()
    gc.freeze()
    gc.set_threshold(20_000, 20, 20)


LONG_RUN, LISTED = 60.0, 8
"""Total seconds of tests beyond which a run ends with a list of its slowest files, and the length of that list."""


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """Report the slowest files, and which device the tests of ``-m gpu`` ran on, or that they did not run."""
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
