"""Trainings run as processes; here they are short programs that write what a training would."""

import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from splatrl.experiments import Run, running
from splatrl.experiments.folders import status
from splatrl.experiments.running import BusyError, command, start, train
from splatrl.files import alone_in
from tests.experiments.made_up import begin, finish, made_up

PROGRAM = ["python", "-m", "a.training"]
SLEEP = [sys.executable, "-c", "import time; time.sleep(600)"]


def python(code: str) -> subprocess.Popen[bytes]:
    return subprocess.Popen([sys.executable, "-S", "-c", code])


def test_a_new_run_is_started_and_a_begun_one_is_resumed(tmp_path: Path) -> None:
    new, begun, *_ = made_up(tmp_path / "it's here").runs
    begin(begun, 40)
    assert command(new, PROGRAM) == [*PROGRAM, *new.overrides, f"hydra.run.dir={quoted(new)}"]
    assert command(begun, PROGRAM) == [*PROGRAM, f"resume={quoted(begun)}"]


def quoted(run: Run) -> str:
    return "'" + str(run.folder).replace("'", r"\'") + "'"


def test_a_training_may_use_its_share_of_the_cores(tmp_path: Path) -> None:
    run = made_up(tmp_path).runs[0]
    share = "import os, sys; assert os.environ['SPLATRL_CORES'] == '3', os.environ"
    assert start(run, 3, [sys.executable, "-c", share]).wait() == 0


def test_only_unfinished_runs_are_trained_and_no_more_at_a_time_than_allowed(tmp_path: Path) -> None:
    runs = made_up(tmp_path).runs
    finish(runs[1], 0.5)
    begun: list[Run] = []
    most = 0

    def one(run: Run, cores: int, program: Sequence[str]) -> subprocess.Popen[bytes]:
        nonlocal most
        assert (cores, program) == (2, PROGRAM)
        begun.append(run)
        most = max(most, sum(status(run.folder, run.config) != "finished" for run in begun))
        finish(run, 0.5)
        return python("pass")

    assert train(runs, 1, 2, PROGRAM, one, poll=0.01) == []
    assert begun == [run for run in runs if run is not runs[1]]
    assert most == 1


def test_a_failed_run_is_named_and_the_others_continue(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    runs = made_up(tmp_path).runs[:3]

    def one(run: Run, cores: int, program: Sequence[str]) -> subprocess.Popen[bytes]:
        return python("raise SystemExit(1)" if run is runs[1] else "pass")

    assert train(runs, 2, 1, PROGRAM, one, poll=0.01) == [runs[1]]
    assert str(runs[1].folder / "log.txt") in "".join(capsys.readouterr())


def ignores_interrupts() -> None:
    """Ignore SIGINT, as a shell's background jobs and all their children do."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def test_an_interrupt_ends_the_trainings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    children: list[subprocess.Popen[bytes]] = []

    def one(run: Run, cores: int, program: Sequence[str]) -> subprocess.Popen[bytes]:
        if children:
            raise KeyboardInterrupt
        children.append(subprocess.Popen(SLEEP, preexec_fn=ignores_interrupts))
        return children[0]

    monkeypatch.setattr(running, "PATIENCE", 5.0)
    with pytest.raises(KeyboardInterrupt):
        train(made_up(tmp_path).runs, 2, 1, PROGRAM, one)
    assert children[0].returncode == -signal.SIGTERM


def test_a_folder_that_another_process_is_training_in_is_left_alone(tmp_path: Path) -> None:
    run = made_up(tmp_path).runs[0]
    first = start(run, 1, SLEEP)
    try:
        with pytest.raises(BusyError, match=run.folder.name):
            start(run, 1, SLEEP)
    finally:
        running.stop([first])
    with alone_in(run.folder), pytest.raises(BusyError, match=run.folder.name):
        start(run, 1, SLEEP)  # as beside a training that was resumed by hand
    assert start(run, 1, [sys.executable, "-S", "-c", "print('at work')"]).wait() == 0
    assert (run.folder / "log.txt").read_text().endswith("at work\n")


@pytest.mark.parametrize("finished", [False, True])
def test_a_run_that_another_process_is_training_is_waited_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], finished: bool
) -> None:
    orphan, other = made_up(tmp_path).runs[:2]
    asked: list[Run] = []

    def one(run: Run, cores: int, program: Sequence[str]) -> subprocess.Popen[bytes]:
        asked.append(run)
        if run is orphan and asked.count(orphan) == 3 and finished:
            finish(orphan, 0.5)
        if run is orphan and asked.count(orphan) <= 3:
            raise BusyError("another process is training in it")
        return python("pass")

    assert train([orphan, other], 1, 1, PROGRAM, one, poll=0.01) == []
    assert asked == [orphan] * (3 if finished else 4) + [other]
    assert "".join(capsys.readouterr()).count("waiting: another process is training in it") == 1


def test_a_run_that_another_process_finishes_meanwhile_is_not_begun(tmp_path: Path) -> None:
    first, second = made_up(tmp_path).runs[:2]
    asked: list[Run] = []

    def one(run: Run, cores: int, program: Sequence[str]) -> subprocess.Popen[bytes]:
        asked.append(run)
        finish(second, 0.5)
        return python("pass")

    assert train([first, second], 1, 1, PROGRAM, one, poll=0.01) == []
    assert asked == [first]


def test_a_training_gets_its_overrides_and_limits_its_libraries_to_one_thread(tmp_path: Path) -> None:
    run = made_up(tmp_path).runs[0]
    says = "import os, sys; print(sys.argv[1:], os.environ['OMP_NUM_THREADS'])"
    assert start(run, 1, [sys.executable, "-S", "-c", says]).wait() == 0
    folder = f"hydra.run.dir={quoted(run)}"
    assert (run.folder / "log.txt").read_text() == f"{[*run.overrides, folder]} 1\n"
