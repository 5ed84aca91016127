"""Runs trainings as subprocesses, a few at a time."""

import os
import subprocess
import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from typing import BinaryIO

from splatrl.configuration import quoted
from splatrl.experiments.experiment import Run
from splatrl.experiments.folders import finished, frames_done, status
from splatrl.files import alone_in, lock
from splatrl.native.threads import CORES
from splatrl.waits import Bar

LOG = "log.txt"
POLL = 0.5
"""Interval between polls of the trainings, seconds."""
PATIENCE = 15.0
"""Time within which an interrupted training must end before it is killed, seconds."""


class BusyError(RuntimeError):
    """Another process is training in the run folder."""


def command(run: Run, program: Sequence[str]) -> list[str]:
    """Return the command line that starts or resumes a training.

    Args:
        run: the training.
        program: the training command, which takes Hydra overrides as arguments, such as ``splatrl-train``.
    """
    if status(run.folder, run.config) == "new":
        return [*program, *run.overrides, f"hydra.run.dir={quoted(run.folder)}"]
    return [*program, f"resume={quoted(run.folder)}"]


def start(run: Run, cores: int, program: Sequence[str]) -> subprocess.Popen[bytes]:
    """Start a training as a subprocess that writes its output to a log and locks its folder until it ends.

    Args:
        run: the training.
        cores: maximum number of cores that it may use.
        program: the training command.

    Raises:
        BusyError: if another process is training in the folder, such as one that outlived the command that began it.
    """
    run.folder.mkdir(parents=True, exist_ok=True)
    settings = os.environ | {"OMP_NUM_THREADS": "1", "TQDM_DISABLE": "1", CORES: str(cores)}
    with (run.folder / LOG).open("ab") as log:
        _hold(run, log)
        return subprocess.Popen(
            command(run, program),
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
            env=settings,
            start_new_session=True,  # Ctrl-C in a terminal reaches only this process, which then ends its trainings
        )


def _hold(run: Run, log: BinaryIO) -> None:
    """Lock an open log; the subprocess that inherits it holds the lock until it ends.

    Raises:
        BusyError: if another process holds it, or has locked the folder, as a training started by hand does.
    """
    try:
        lock(log.fileno(), run.folder)
        with alone_in(run.folder):
            pass
    except ValueError as error:
        raise BusyError(f"{run.folder}: another process is training in it") from error


def train(
    runs: Sequence[Run],
    jobs: int,
    cores: int,
    program: Sequence[str],
    begin: Callable[[Run, int, Sequence[str]], subprocess.Popen[bytes]] = start,
    poll: float = POLL,
) -> list[Run]:
    """Train all unfinished runs under one progress bar; a run that fails does not stop the others.

    A run in whose folder another process is training takes its turn when that process has ended, if it is not finished
    by then. Meanwhile it counts as one of the trainings that run.

    Args:
        runs: the trainings.
        jobs: number of trainings that run at a time.
        cores: number of cores per training.
        program: the training command.
        begin: starts a training, given the run, its cores and the command.
        poll: seconds between polls.

    Returns:
        The runs that failed.

    Raises:
        KeyboardInterrupt: on Ctrl-C, once all trainings have ended.
    """
    trainings = _Trainings(runs)
    total, initial = sum(run.frames for run in runs), sum(trainings.frames.values())
    with Bar(total=total, initial=initial, unit="frame", unit_scale=True, smoothing=0) as bar:
        try:
            while trainings.left:
                trainings.begin(jobs, lambda run: begin(run, cores, program), bar.write)
                trainings.look(bar.write)
                bar.set_description(f"{trainings.done} of {len(runs)} trained", refresh=False)
                bar.update(max(sum(trainings.frames.values()) - bar.n, 0))
                bar.refresh()
                if trainings.left:
                    time.sleep(poll)
        finally:
            stop(process for process in trainings.running.values() if process)
    return trainings.failed


class _Trainings:
    """What has become of the trainings: those that wait, that run, and that failed; and the frames of each."""

    def __init__(self, runs: Sequence[Run]):
        self.runs = runs
        self.waiting = deque(run for run in runs if not finished(run))
        self.running: dict[Run, subprocess.Popen[bytes] | None] = {}  # None stands for another process
        self.failed: list[Run] = []
        todo = set(self.waiting)
        self.frames = {run: frames_done(run.folder) if run in todo else run.frames for run in runs}
        self._told: set[Run] = set()

    @property
    def left(self) -> bool:
        """Whether any waits or runs."""
        return bool(self.waiting or self.running)

    @property
    def done(self) -> int:
        """Number of trainings that are finished."""
        return len(self.runs) - len(self.waiting) - len(self.running) - len(self.failed)

    def begin(self, jobs: int, begin: Callable[[Run], subprocess.Popen[bytes]], say: Callable[[str], object]) -> None:
        """Begin waiting trainings until ``jobs`` run."""
        while self.waiting and len(self.running) < jobs:
            run = self.waiting.popleft()
            if finished(run):  # in the meantime, by another process
                self.frames[run] = run.frames
                continue
            try:
                self.running[run] = begin(run)
            except BusyError as error:
                self.running[run] = None
                if run not in self._told:
                    say(f"waiting: {error}")
                self._told.add(run)

    def look(self, say: Callable[[str], object]) -> None:
        """Look which trainings have ended and how far the others are; one that another process does waits again."""
        for run, process in list(self.running.items()):
            code = process.poll() if process else None
            if process is None:
                self.waiting.appendleft(run)
            if process is None or code is not None:
                del self.running[run]
            if code:
                self.failed.append(run)
                say(f"failed: {run.folder.name}, see {run.folder / LOG}")
            self.frames[run] = run.frames if code == 0 else frames_done(run.folder)


def stop(processes: Iterable[subprocess.Popen[bytes]]) -> None:
    """End trainings: terminate them, which they treat as an interrupt, and kill any that take too long to end.

    An interrupt itself (SIGINT) would be ignored by the children of a shell's background job.
    """
    alive = [process for process in processes if process.poll() is None]
    for process in alive:
        process.terminate()
    until = time.monotonic() + PATIENCE
    for process in alive:
        try:
            process.wait(max(until - time.monotonic(), 0.1))
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
