"""How long commands end when they are interrupted or terminated."""

import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from splatrl.commands.stopping import INTERRUPTED, handled, interrupted_by, stoppable, tidy
from tests.preloaded import start

NUMBERS = (signal.SIGINT, signal.SIGTERM)


@pytest.fixture(autouse=True)
def default_handlers() -> Iterator[None]:
    """The handlers that a program starts with."""
    before = [signal.getsignal(number) for number in NUMBERS]
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    yield
    for number, handler in zip(NUMBERS, before, strict=True):
        signal.signal(number, handler)


@pytest.mark.parametrize("number", NUMBERS)
def test_a_stopped_command_says_how_to_continue(number: signal.Signals, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended, stoppable("type it again"):
        assert signal.getsignal(signal.SIGTERM) is signal.default_int_handler, "or it would end the tests"
        signal.raise_signal(number)
    assert ended.value.code == INTERRUPTED
    assert capsys.readouterr().err == "\nstopped; finished work is kept; type it again\n"
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL


def test_terminations_are_left_to_whoever_handles_them_already(capsys: pytest.CaptureFixture[str]) -> None:
    found: list[int] = []
    signal.signal(signal.SIGTERM, lambda number, frame: found.append(number))
    with stoppable("type it again"):
        signal.raise_signal(signal.SIGTERM)
    assert found == [signal.SIGTERM] and capsys.readouterr().err == ""


def test_a_closed_terminal_interrupts_only_who_asks_for_it() -> None:
    hangup = signal.SIGHUP
    before = signal.getsignal(hangup)
    try:
        signal.signal(hangup, signal.SIG_DFL)
        with pytest.raises(KeyboardInterrupt), interrupted_by(signal.SIGTERM, hangup):
            assert signal.getsignal(hangup) is signal.default_int_handler, "or it would end the tests"
            signal.raise_signal(hangup)
        assert signal.getsignal(hangup) is signal.SIG_DFL
        signal.signal(hangup, signal.SIG_IGN)  # as nohup does
        with interrupted_by(hangup):
            signal.raise_signal(hangup)
    finally:
        signal.signal(hangup, before)


def test_a_handler_that_python_did_not_set_becomes_the_usual_one(monkeypatch: pytest.MonkeyPatch) -> None:
    usual = signal.signal

    def unknown(number: signal.Signals, handler: Any) -> None:
        usual(number, handler)

    monkeypatch.setattr(signal, "signal", unknown)
    with handled(signal.SIG_IGN, signal.SIGTERM):
        signal.raise_signal(signal.SIGTERM)
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL


def test_a_terminated_command_removes_its_temporary_files_and_ends_by_the_signal(tmp_path: Path) -> None:
    code = f"""
import os, signal, time
from pathlib import Path
from splatrl.commands import entries
from splatrl.files import new_folder, replacing

def command(name, typed):
    with new_folder(Path({str(tmp_path)!r}) / "demos") as folder, replacing(folder.with_name("film.mp4")):
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(60)

entries._start = command
entries.start("record", [])
"""
    process = start("-c", code, bare=True)
    output, _ = process.communicate(timeout=900)  # seconds, for a busy machine
    assert (process.returncode, output, list(tmp_path.iterdir())) == (-signal.SIGTERM, "", [])


def test_a_long_command_takes_a_termination_for_an_interrupt(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended, tidy(), stoppable("type it again"):
        assert signal.getsignal(signal.SIGTERM) is signal.default_int_handler, "as a training expects"
        signal.raise_signal(signal.SIGTERM)
    assert ended.value.code == INTERRUPTED and "type it again" in capsys.readouterr().err
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
