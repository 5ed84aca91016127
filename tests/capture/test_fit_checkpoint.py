"""A killed fit resumes from its checkpoint, with the same bytes as an uninterrupted one."""

import signal
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from torch import Tensor

from splatrl.capture.base import Reconstruction
from splatrl.capture.fitting.checkpoint import Checkpoint
from splatrl.capture.fitting.fit import FitSettings, Fitting, fit
from splatrl.scenes.gaussians import Gaussians
from tests.capture.test_fit import SETTINGS, same_bytes, tiny_capture
from tests.preloaded import start

FULL = replace(SETTINGS, views=120, views_a_step=2, sh_degree=1, poses=1e-3)
"""Settings that learn everything a fit can learn: 60 steps; Gaussians are relocated and added after steps 20 and 40."""

SHORT = replace(FULL, views=60)
"""Half as many steps: Gaussians are relocated and added once."""

KILLED = """
import os, signal, sys
from pathlib import Path
from splatrl.capture.fitting.fit import fit
from splatrl.capture.fitting.checkpoint import Checkpoint
from tests.capture.test_fit_checkpoint import FULL
from tests.capture.test_fit import tiny_capture

folder, last = Path(sys.argv[1]), int(sys.argv[2])
def told(done, total, loss):
    if done == last:
        os.kill(os.getpid(), signal.SIGKILL)
fit(tiny_capture(folder), FULL, told, None, Checkpoint(folder / "fit.npz", every=0))
"""


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Reconstruction:
    return tiny_capture(tmp_path_factory.mktemp("photos"))


@pytest.fixture(scope="module")
def whole(capture: Reconstruction) -> Gaussians:
    """Result of a full fit that was never interrupted."""
    return fit(capture, FULL)


@pytest.fixture(scope="module")
def short(capture: Reconstruction) -> Gaussians:
    """Result of a short fit that was never interrupted."""
    return fit(capture, SHORT)


@pytest.fixture(scope="module")
def begun(capture: Reconstruction, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Checkpoint of a short fit that was interrupted after 20 views."""
    path = tmp_path_factory.mktemp("begun") / "fit.npz"
    interrupted(capture, Checkpoint(path, every=0), 20, SHORT)
    return path.read_bytes()


def interrupted(capture: Reconstruction, checkpoint: Checkpoint, last: int, settings: FitSettings = FULL) -> None:
    """Run a fit that an exception interrupts after ``last`` views."""

    def told(done: int, total: int, loss: float) -> None:
        if done == last:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fit(capture, settings, told, None, checkpoint)


def resumed(capture: Reconstruction, checkpoint: Checkpoint, settings: FitSettings = FULL) -> tuple[Gaussians, int]:
    """Run the rest of a fit; return its result and the number of views at its first progress report."""
    heard: list[int] = []
    return fit(capture, settings, lambda done, total, loss: heard.append(done), None, checkpoint), heard[0]


def test_a_killed_fit_resumes_with_the_same_bytes(tmp_path: Path, whole: Gaussians) -> None:
    assert start("-c", KILLED, str(tmp_path), "70").wait() == -signal.SIGKILL
    found, first = resumed(tiny_capture(tmp_path), Checkpoint(tmp_path / "fit.npz"))
    assert first == 70  # only the step that was killed, 35 of 60, is repeated
    assert same_bytes(found, whole)


@pytest.mark.parametrize("last", [40, 118, *(pytest.param(last, marks=pytest.mark.slow) for last in (4, 42))])
def test_a_fit_resumes_from_any_step_with_the_same_bytes(
    capture: Reconstruction, whole: Gaussians, last: int, tmp_path: Path
) -> None:
    interrupted(capture, Checkpoint(tmp_path / "fit.npz", every=0), last)
    found, first = resumed(capture, Checkpoint(tmp_path / "fit.npz", every=0))
    assert first == last and same_bytes(found, whole)


def test_the_state_of_a_fit_holds_everything_that_a_step_changes(capture: Reconstruction) -> None:
    fitting, other = Fitting(capture, FULL), Fitting(capture, FULL)
    for step in range(30):
        fitting.step(step, 60)
    assert other.restore(fitting.state(30)) == 30
    for step in range(30, 60):
        assert fitting.step(step, 60) == other.step(step, 60)
    for name, value in fitting.state(60).items():
        assert value.equal(other.state(60)[name]), name


def damaged(path: Path, how: str) -> None:
    content = path.read_bytes()
    with np.load(path) as stored:
        arrays = dict(stored)
    if how == "cut":
        path.write_bytes(content[: len(content) // 2])
    elif how == "a bit":
        place = content.index(b"model.second.npy") + 5000
        path.write_bytes(content[:place] + bytes([content[place] ^ 1]) + content[place + 1 :])
    elif how == "empty":
        path.write_bytes(b"")
    else:
        changes = {
            "a shape": {"model.values": np.zeros((3, 3), np.float32)},
            "a count": {"count": np.array(1 << 40)},
            "an order": {"order": np.array([10**6])},
            "a generator": {"generator": np.zeros(9, np.uint8)},
        }
        np.savez(path, **{**arrays, **changes[how]})


@pytest.mark.parametrize("how", ["cut", "a bit", "empty", "a shape", "a count", "an order", "a generator"])
def test_a_damaged_checkpoint_is_named_and_the_fit_starts_over(
    capture: Reconstruction, short: Gaussians, begun: bytes, how: str, tmp_path: Path
) -> None:
    said: list[str] = []
    (tmp_path / "fit.npz").write_bytes(begun)
    damaged(tmp_path / "fit.npz", how)
    found, first = resumed(capture, Checkpoint(tmp_path / "fit.npz", say=said.append), SHORT)
    assert first == 2 and same_bytes(found, short)
    assert len(said) == 1 and said[0].startswith(f"{tmp_path / 'fit.npz'}: expected ")
    assert said[0].endswith("; the fit starts over") and "\n" not in said[0]


def test_a_checkpoint_is_written_whenever_the_interval_has_passed(
    capture: Reconstruction, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = iter(range(0, 10_000, 3))
    monkeypatch.setattr("splatrl.capture.fitting.checkpoint.time.monotonic", lambda: next(clock))
    write, written = Checkpoint.write, []

    def noted(self: Checkpoint, state: dict[str, Tensor]) -> None:
        written.append(int(state["step"]))
        write(self, state)

    monkeypatch.setattr(Checkpoint, "write", noted)
    fit(capture, replace(FULL, views=24), None, None, Checkpoint(tmp_path / "fit.npz", every=10.0))
    assert written == [4, 8, 12]  # a step takes 3 s
